"""Loop subdivision of a part of a surface, joined to the rest.

C. Loop, *Smooth Subdivision Surfaces Based on Triangles*, 1987, with his weights. Every
level splits all triangles of a region into four: a new vertex on an edge is 3/8 of each
end and 1/8 of each opposite vertex, and an old vertex of k neighbours keeps 1 - k b and
takes b of each, b = (5/8 - (3/8 + cos(2 π / k) / 4)²) / k.

What the rule leaves open, and our choice:

- *The region's border.* Its vertices stay, and new ones on its edges are their middles,
  so the surface outside does not move at all.
- *The transition.* Triangles outside that share an edge with the region are split there
  (T-shape, A-shape), and by every further level the region is one ring narrower, so no
  such triangle is split twice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrow.mesh.quality import lengths
from jaxgrow.mesh.subdivide import split_edges
from jaxgrow.mesh.surface import Remeshing, Surface
from jaxgrow.mesh.topology import build_topology, Topology


BAND = 2
"""Rings round the chosen vertices that are subdivided as often as they are."""


LEVELS = 4
"""Most levels that are asked for: each makes four triangles of one."""


@dataclass(frozen=True, eq=False)
class Refined:
    """Surface of which a part was subdivided.

    Attributes:
        vertices: First the old ones, in their order; then the new ones.
        faces: First the old faces that were not split, in their order.
        remeshing: The map to them; it interpolates scalars linearly, by
            `Remeshing.apply`. Its positions are those before any vertex moved.
        displacement: How far each old vertex was moved.
    """

    vertices: Float[np.ndarray, "m 3"]
    faces: Int[np.ndarray, "f 3"]
    remeshing: Remeshing
    displacement: Float[np.ndarray, " o"]


def subdivide_loop(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    chosen: Bool[np.ndarray, " m"],
    levels: int,
) -> Refined:
    """Refine the surface at chosen vertices, and leave the rest as it is.

    Vertices more than `BAND` + ``levels`` edges away from all chosen ones keep their
    coordinates to the last bit, and so do the faces among them. With all vertices
    chosen it is Loop's subdivision of a closed surface.

    Args:
        vertices: Positions, any one unit of length.
        faces: Closed oriented manifold.
        chosen: The vertices at which the surface is subdivided as often as asked.
        levels: How often; each level makes four triangles of one.

    Returns:
        The surface; closed and oriented. Whether it meets itself is not checked.

    Raises:
        ValueError: The number of levels is not from 1 to `LEVELS`.
    """
    if not 1 <= levels <= LEVELS:
        raise ValueError(
            f"{levels} levels of subdivision were asked for; ask for 1 to {LEVELS}."
        )
    ring = _rings(faces, chosen, BAND + levels)
    surface = Surface(vertices, faces, np.zeros(len(vertices), dtype=bool))
    done = Remeshing.unchanged(surface)
    for level in range(levels):
        reach = done.apply(ring[:, None])[:, 0]
        region = reach[surface.faces].max(axis=1) <= BAND + levels - 1 - level
        surface, step = _level(surface, region)
        done = done.then(step)
    return Refined(
        vertices=surface.vertices,
        faces=surface.faces,
        remeshing=done,
        displacement=lengths(surface.vertices[: len(vertices)] - vertices),
    )


def _rings(
    faces: Int[np.ndarray, "f 3"], chosen: Bool[np.ndarray, " m"], most: int
) -> Float[np.ndarray, " m"]:
    """Count the edges from each vertex to a chosen one, up to a number."""
    ring = np.where(chosen, 0.0, most)
    for count in range(1, most):
        reached = faces[(ring[faces] < count).any(axis=1)]
        ring[reached] = np.minimum(ring[reached], count)
    return ring


def _level(
    surface: Surface, region: Bool[np.ndarray, " f"]
) -> tuple[Surface, Remeshing]:
    """Split the faces of a region into four, and place its vertices."""
    topology = build_topology(surface.faces, len(surface.vertices))
    one, other = region[topology.edge_faces.T]
    finer, step = split_edges(surface, topology, one | other)
    border = np.zeros(len(surface.vertices), dtype=bool)
    border[surface.faces[~region]] = True
    moving = np.zeros(len(surface.vertices), dtype=bool)
    moving[surface.faces[region]] = True
    moving &= ~border

    vertices = finer.vertices.copy()
    vertices[: len(border)][moving] = _old(surface.vertices, topology)[moving]
    inner = one & other
    new = len(border) + np.flatnonzero(inner[one | other])
    vertices[new] = _new(surface.vertices, topology, inner)
    return Surface(vertices, finer.faces, finer.fixed, finer.source), step


def _old(
    vertices: Float[np.ndarray, "m 3"], topology: Topology
) -> Float[np.ndarray, "m 3"]:
    """Place all old vertices by Loop's rule."""
    sums = np.zeros_like(vertices)
    for one, other in (topology.edges.T, topology.edges[:, ::-1].T):
        np.add.at(sums, one, vertices[other])
    k = np.maximum(topology.valence, 1)
    weight = (5 / 8 - (3 / 8 + np.cos(2 * np.pi / k) / 4) ** 2) / k
    return (1 - k * weight)[:, None] * vertices + weight[:, None] * sums


def _new(
    vertices: Float[np.ndarray, "m 3"], topology: Topology, inner: np.ndarray
) -> Float[np.ndarray, "k 3"]:
    """Place the vertices on inner edges by Loop's rule."""
    ends = vertices[topology.edges[inner]].sum(axis=1)
    return (3 * ends + vertices[topology.opposite[inner]].sum(axis=1)) / 8
