"""Which part of the surface is the lesion, and how large it is, on the host."""

from contextlib import suppress

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree, QhullError
from scipy.spatial.distance import pdist

from jaxgrow.mesh.proximity import nearest_on_mesh
from jaxgrow.mesh.quality import area_vectors
from jaxgrow.mesh.topology import build_topology
from jaxgrow.scene import Myoma, Scene
from jaxgrow.state import Species, State
from jaxgrow.transfer import get, get_particles, get_surface


RAISED = 0.5
"""Surface higher than this (r0) above the former one belongs to the lesion."""

COVERING = 1.0
"""Surface closer than this (r0) to a tumour particle belongs to the lesion."""

BELONGING = 2.5
"""Raised surface that comes this close (r0) to the tumour was raised by it: tissue may
lie between a myoma and the surface."""


def height_above(
    points: Float[np.ndarray, "n 3"],
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
) -> Float[np.ndarray, " n"]:
    """Distance to a surface, positive on the side that its normals point to."""
    distance, face, closest = nearest_on_mesh(points, vertices, faces)
    normal = area_vectors(vertices[faces[face]])
    above = np.einsum("ni,ni->n", points - closest, normal) > 0
    return np.where(above, distance, -distance)


def raised(state: State) -> Bool[np.ndarray, " m"]:
    """Living membrane vertices that the tumour raised half an r0 over the former ones.

    Surface of that height counts where it is connected with a vertex near the tumour:
    tissue elsewhere may push its surface up as well.
    """
    assert state.membrane is not None
    assert state.frame.former is not None
    surface, former = get_surface(state.membrane), state.frame.former
    height = height_above(surface.vertices, get(former.vertices), get(former.faces))
    high = height > RAISED
    edges = build_topology(surface.faces, len(high)).edges
    first, second = edges[high[edges].all(axis=1)].T
    graph = coo_array(
        (np.ones(len(first)), (first, second)), shape=(len(high), len(high))
    )
    _, component = connected_components(graph, directed=False)
    near = _to_tumour(state, surface.vertices) < BELONGING
    mine = np.isin(component, component[high & near])
    return high & mine


def _to_tumour(
    state: State, points: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "m"]:
    """Distance of each point to the nearest tumour particle; infinite without any."""
    position, species = get_particles(state.particles)
    tumour = position[species == Species.TUMOUR]
    if len(tumour) == 0:
        return np.full(len(points), np.inf)
    distance, _ = KDTree(tumour).query(points)
    return np.asarray(distance)


def lesion_vertices(state: State) -> Bool[np.ndarray, " m"]:
    """Living membrane vertices of the lesion: raised by it, or close to its tumour."""
    assert state.membrane is not None
    points = get(state.membrane.vertices)[get(state.membrane.vertex_alive)]
    return raised(state) | (_to_tumour(state, points) < COVERING)


def diameter(points: Float[np.ndarray, "n 3"]) -> float:
    """Largest distance of two points; 0 for fewer than two."""
    if len(points) < 2:
        return 0.0
    if len(points) > 50:
        with suppress(QhullError):  # points in a plane have no hull of volume
            points = points[ConvexHull(points).vertices]
    return float(pdist(points).max())


def size_of(scene: Scene, state: State) -> float:
    """Largest diameter of the lesion, in r0.

    Of a polyp: of the raised surface, which is what is seen of it. Of a myoma: of its
    body, the tumour particles with their own diameter r0, part of which stays under
    the surface.
    """
    if isinstance(scene.lesion, Myoma):
        position, species = get_particles(state.particles)
        return diameter(position[species == Species.TUMOUR]) + 1.0
    assert state.membrane is not None
    points = get(state.membrane.vertices)[get(state.membrane.vertex_alive)]
    return diameter(points[raised(state)])
