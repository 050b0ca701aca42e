"""Extent of the lesion on the surface, and its diameter, on the host."""

from contextlib import suppress

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import ConvexHull, KDTree, QhullError
from scipy.spatial.distance import pdist

from jaxgrow.equilibrium.transformations import is_differentiated
from jaxgrow.mesh.proximity import nearest_on_mesh
from jaxgrow.mesh.quality import area_vectors
from jaxgrow.mesh.topology import connected_parts
from jaxgrow.numerics.guards import safe_norm
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Species, State
from jaxgrow.transfer.device import get, get_particles, get_surface, put


RAISED = 0.5
"""Height (r0) over the former surface above which a vertex belongs to the lesion."""

COVERING = 1.0
"""Distance (r0) to a tumour particle below which a vertex belongs to the lesion."""

BELONGING = 2.5
"""Distance (r0) to the tumour below which a raised surface was raised by it: tissue may
lie between a myoma and the surface."""


def height_above(
    points: Float[np.ndarray, "n 3"],
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
) -> Float[np.ndarray, " n"]:
    """Compute the signed distance to a surface, positive along its normals."""
    distance, face, closest = nearest_on_mesh(points, vertices, faces)
    normal = area_vectors(vertices[faces[face]])
    above = np.einsum("ni,ni->n", points - closest, normal) > 0
    return np.where(above, distance, -distance)


def raised(state: State) -> Bool[np.ndarray, " m"]:
    """Mark membrane vertices that the tumour raised by more than `RAISED`.

    The height is that over the former surface, of vertices alive. A raised part of the
    surface counts if it is connected with a vertex near the tumour: tissue elsewhere
    may raise its surface as well.
    """
    assert state.membrane is not None
    surface = get_surface(state.membrane)
    high = heights(state) > RAISED
    component = connected_parts(surface.faces, high)
    near = _to_tumour(state, surface.vertices) < BELONGING
    mine = np.isin(component, component[high & near])
    return high & mine


def height_of(state: State) -> float:
    """Compute the largest height of the lesion over the former surface, in r0.

    It is 0 where nothing is raised.
    """
    mine = raised(state)
    if not mine.any():
        return 0.0
    return float(heights(state)[mine].max())


def heights(state: State) -> Float[np.ndarray, " m"]:
    """Compute the heights of vertices alive over the former surface, in r0."""
    assert state.membrane is not None
    assert state.frame.former is not None
    points, former = get_surface(state.membrane).vertices, state.frame.former
    return height_above(points, get(former.vertices), get(former.faces))


def _to_tumour(
    state: State, points: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "m"]:
    """Compute each point's distance to the nearest tumour particle.

    It is infinite without any.
    """
    position, species = get_particles(state.particles)
    tumour = position[species == Species.TUMOUR]
    if len(tumour) == 0:
        return np.full(len(points), np.inf)
    distance, _ = KDTree(tumour).query(points)
    return np.asarray(distance)


def lesion_vertices(state: State) -> Bool[np.ndarray, " m"]:
    """Mark membrane vertices of the lesion: raised, or near the tumour.

    There is one entry per vertex alive.
    """
    assert state.membrane is not None
    points = get(state.membrane.vertices)[get(state.membrane.vertex_alive)]
    return raised(state) | (_to_tumour(state, points) < COVERING)


def farthest(points: Float[np.ndarray, "n 3"]) -> tuple[int, int]:
    """Find the two points that are farthest apart; 0, 0 for fewer than two."""
    if len(points) < 2:
        return 0, 0
    some = np.arange(len(points))
    if len(points) > 50:
        with suppress(QhullError):  # coplanar points have no hull in three dimensions
            some = ConvexHull(points).vertices
    first, second = np.triu_indices(len(some), 1)
    most = int(pdist(points[some]).argmax())
    return int(some[first[most]]), int(some[second[most]])


def diameter(points: Float[np.ndarray, "n 3"]) -> float:
    """Compute the largest distance of two points; 0 for fewer than two."""
    if len(points) < 2:
        return 0.0
    return float(pdist(points[list(farthest(points))])[0])


def diameter_of(
    positions: Float[Array, "n 3"], chosen: Int[np.ndarray, " k"]
) -> Scalar:
    """Compute the largest distance among some rows, in r0.

    It is a number; under differentiation of the positions, a scalar with the same value
    and the derivative of the distance between the two farthest rows.

    Args:
        positions: in r0.
        chosen: rows.
    """
    points = get(positions)[chosen]
    number = diameter(points)
    if number == 0 or not is_differentiated(positions):
        return number
    length = _distance(positions, put(chosen[list(farthest(points))]))
    return number + (length - jax.lax.stop_gradient(length))  # with the number's bits


@jax.jit
def _distance(
    positions: Float[Array, "n 3"], pair: Int[Array, "2"]
) -> Float[Array, ""]:
    return safe_norm(positions[pair[0]] - positions[pair[1]])
