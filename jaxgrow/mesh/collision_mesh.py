"""Collision mesh: a surface joined with static walls, and its near pairs.

The growing membrane may meet itself, the opposite wall, and every other part of the
organ. All of them are one set of triangles here, the *sheet*: the surface's vertices
first, then the walls' that it does not have already.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrow import kernels
from jaxgrow.mesh.intersection import intersecting_pairs
from jaxgrow.mesh.quality import lengths
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.topology import build_topology


@dataclass(frozen=True, eq=False)
class Walls:
    """Static rest of an organ around a patch.

    Attributes:
        vertices: Positions, in the unit and frame of the surface.
        faces: Triangles, oriented as the surface's.
        names: Index of each vertex in the whole organ.
    """

    vertices: Float[np.ndarray, "w 3"]
    faces: Int[np.ndarray, "g 3"]
    names: Int[np.ndarray, " w"]

    def near(
        self, points: Float[np.ndarray, "n 3"], distance: float
    ) -> Int[np.ndarray, " k"]:
        """Find the faces that may be within a distance of some point."""
        if not len(self.faces) or not len(points):
            return np.zeros(0, dtype=np.int64)
        return kernels.loops("walls").near(*self._bounds, points, distance)

    @cached_property
    def _bounds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Bounds of each face: corners of its box, centre and radius of a sphere.

        Computed once, as walls do not move.
        """
        corners = self.vertices[self.faces]
        centre = corners.mean(axis=1)
        radius = lengths(corners - centre[:, None]).max(axis=1)
        return corners.min(axis=1), corners.max(axis=1), centre, radius


@dataclass(frozen=True, eq=False)
class Sheet:
    """Surface joined with walls.

    Attributes:
        vertices: The surface's first.
        faces: The surface's first.
        moving: Vertices that may move.
        n_surface: Number of vertices of the surface.
        n_faces: Number of its faces.
    """

    vertices: Float[np.ndarray, "m 3"]
    faces: Int[np.ndarray, "f 3"]
    moving: Bool[np.ndarray, " m"]
    n_surface: int
    n_faces: int

    def self_intersections(self) -> Int[np.ndarray, "p 2"]:
        """Find the intersecting pairs of faces, one of them of the surface."""
        return np.concatenate(
            intersecting_pairs(self.vertices, self.faces, self.n_faces)
        )


def join(
    surface: Surface,
    names: Int[np.ndarray, " m"],
    walls: Walls | None,
    distance: float,
) -> Sheet:
    """Join a surface with the walls within a distance of it.

    Args:
        surface: The live surface.
        names: For each of its vertices its index in the organ, -1 for none.
        walls: The rest of the organ, or None.
        distance: Walls farther away are left out.
    """
    count = len(surface.vertices)
    if walls is None:
        return Sheet(
            surface.vertices, surface.faces, ~surface.fixed, count, len(surface.faces)
        )
    chosen = walls.near(surface.vertices, distance)
    used, flat = np.unique(walls.faces[chosen], return_inverse=True)
    named = np.flatnonzero(names >= 0)
    order = named[np.argsort(names[named])]
    place = np.searchsorted(names[order], walls.names[used])
    place = np.minimum(place, max(len(order) - 1, 0))
    known = np.zeros(len(used), dtype=bool)
    if len(order):
        known = names[order[place]] == walls.names[used]
    index = count + np.cumsum(~known) - 1
    if len(order):
        index = np.where(known, order[place], index)
    added = walls.vertices[used[~known]]
    return Sheet(
        vertices=np.concatenate([surface.vertices, added]),
        faces=np.concatenate([surface.faces, index[flat].reshape(-1, 3)]),
        moving=np.concatenate([~surface.fixed, np.zeros(len(added), dtype=bool)]),
        n_surface=count,
        n_faces=len(surface.faces),
    )


@dataclass(frozen=True, eq=False)
class Encounters:
    """Near pairs of a sheet's parts that share no vertex.

    Attributes:
        vertex: Of each pair of a vertex and a triangle, ascending.
        corners: The triangle's vertices.
        vertex_distance: Exact distance.
        vertex_apart: Whether the two are far from each other along the sheet.
        edges: Four ends of each pair of edges.
        edge_distance: Exact distance.
        edge_apart: Whether the two edges are far from each other along the sheet.
    """

    vertex: Int[np.ndarray, " p"]
    corners: Int[np.ndarray, "p 3"]
    vertex_distance: Float[np.ndarray, " p"]
    vertex_apart: Bool[np.ndarray, " p"]
    edges: Int[np.ndarray, "q 4"]
    edge_distance: Float[np.ndarray, " q"]
    edge_apart: Bool[np.ndarray, " q"]


def encounters(sheet: Sheet, *, apart: float, local: float, along: float) -> Encounters:
    """Find the near vertex-triangle and edge-edge pairs of a sheet.

    Two parts are *apart* if every path over edges from one to the other is longer than
    ``along``. At least one vertex of every pair is one that moves.

    Args:
        sheet: Surface and walls.
        apart: Distance up to which parts that are apart are listed.
        local: Distance up to which others are.
        along: Length along the sheet up to which parts are not apart.

    Returns:
        All pairs, by exact distance.
    """
    edges, length = _edges(sheet)
    loops = kernels.loops("encounters")
    vertices, moving = sheet.vertices, sheet.moving
    first, reached = loops.joined(edges, length, len(vertices), along)
    vertex, face, distance, far = loops.vertices_and_faces(
        vertices, sheet.faces, moving, first, reached, apart, local
    )
    rank = np.zeros(len(edges), dtype=np.int64)
    rank[np.argsort(length, kind="stable")] = np.arange(len(edges))
    one, other, between, edge_far = loops.pairs_of_edges(
        vertices, edges, rank, moving, first, reached, apart, local
    )
    order = np.argsort(rank[one] * len(rank) + rank[other])
    return Encounters(
        vertex=vertex,
        corners=sheet.faces[face],
        vertex_distance=distance,
        vertex_apart=far,
        edges=np.concatenate([edges[one[order]], edges[other[order]]], axis=1),
        edge_distance=between[order],
        edge_apart=edge_far[order],
    )


def distances_of(
    vertices: Float[np.ndarray, "m 3"], found: Encounters
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " q"]]:
    """Compute exact distances of the pairs at other vertex positions.

    Args:
        vertices: Positions.
        found: Pairs of vertices with triangles, and of edges.
    """
    loops = kernels.loops("distances")
    return loops.of_pairs(vertices, found.vertex, found.corners, found.edges)


def nearest_apart(sheet: Sheet, *, within: float, along: float) -> float:
    """Return the least vertex-triangle distance of parts that are apart.

    Args:
        sheet: Surface and walls.
        within: Distances up to this are found.
        along: See `encounters`.

    Returns:
        The distance, infinite if there is none up to ``within``.
    """
    edges, length = _edges(sheet)
    loops = kernels.loops("encounters")
    joined = loops.joined(edges, length, len(sheet.vertices), along)
    _, _, distance, _ = loops.vertices_and_faces(
        sheet.vertices, sheet.faces, sheet.moving, *joined, within, -1.0
    )
    return float(distance.min(initial=np.inf))


def _edges(
    sheet: Sheet,
) -> tuple[Int[np.ndarray, "e 2"], Float[np.ndarray, " e"]]:
    """Return all edges, and their lengths."""
    edges = build_topology(sheet.faces, len(sheet.vertices)).edges
    return edges, lengths(sheet.vertices[edges[:, 1]] - sheet.vertices[edges[:, 0]])
