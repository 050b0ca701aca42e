"""A surface joined with the static walls around it, and which of their parts are near.

The growing membrane may meet itself, the opposite wall, and every other part of the
organ. All of them are one set of triangles here, the *sheet*: the surface's vertices
first, then the walls' that it does not have already.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from jaxgrow import kernels
from jaxgrow.mesh.intersection import intersecting_pairs
from jaxgrow.mesh.proximity import closest_on_segments, closest_on_triangles
from jaxgrow.mesh.quality import lengths
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.topology import build_topology


@dataclass(frozen=True, eq=False)
class Walls:
    """The rest of an organ around a patch, which does not move.

    Attributes:
        vertices: Positions, in the unit and frame of the surface.
        faces: Triangles, oriented as the surface's.
        names: A number for each vertex that it has for the whole organ.
    """

    vertices: Float[np.ndarray, "w 3"]
    faces: Int[np.ndarray, "g 3"]
    names: Int[np.ndarray, " w"]

    def near(
        self, points: Float[np.ndarray, "n 3"], distance: float
    ) -> Int[np.ndarray, " k"]:
        """Faces that may be within a distance of some point."""
        if not len(self.faces) or not len(points):
            return np.zeros(0, dtype=np.int64)
        loops = kernels.loops("walls", points)
        if loops is not None:
            return loops.near(*self._bounds, points, distance)
        lowest, highest, centre, radius = self._bounds
        low, high = points.min(axis=0) - distance, points.max(axis=0) + distance
        box = np.all(highest >= low, axis=1) & np.all(lowest <= high, axis=1)
        candidates = np.flatnonzero(box)
        nearest, _ = KDTree(points).query(centre[candidates])
        return candidates[nearest <= distance + radius[candidates]]

    @cached_property
    def _bounds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Corners of each face's box, its centre, and the radius of its sphere there.

        Made once, as walls do not move.
        """
        corners = self.vertices[self.faces]
        centre = corners.mean(axis=1)
        radius = lengths(corners - centre[:, None]).max(axis=1)
        return corners.min(axis=1), corners.max(axis=1), centre, radius


@dataclass(frozen=True, eq=False)
class Sheet:
    """A surface with walls.

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
        """Pairs of faces, one of them of the surface, that meet where they must not."""
        return np.concatenate(
            intersecting_pairs(self.vertices, self.faces, self.n_faces)
        )


def join(
    surface: Surface,
    names: Int[np.ndarray, " m"],
    walls: Walls | None,
    distance: float,
) -> Sheet:
    """The surface and the walls within a distance of it.

    Args:
        surface: The live surface.
        names: For each of its vertices its number in the organ, -1 for none.
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
    """Parts of a sheet that are near each other and share no vertex.

    Attributes:
        vertex: Of each pair of a vertex and a triangle, ascending.
        corners: The triangle's vertices.
        vertex_distance: Exact distance.
        vertex_apart: Whether the two are far from each other along the sheet.
        edges: Four ends of each pair of edges.
        edge_distance: Exact distance.
        edge_apart: Likewise.
    """

    vertex: Int[np.ndarray, " p"]
    corners: Int[np.ndarray, "p 3"]
    vertex_distance: Float[np.ndarray, " p"]
    vertex_apart: Bool[np.ndarray, " p"]
    edges: Int[np.ndarray, "q 4"]
    edge_distance: Float[np.ndarray, " q"]
    edge_apart: Bool[np.ndarray, " q"]


def encounters(sheet: Sheet, *, apart: float, local: float, along: float) -> Encounters:
    """Find what is near, and which of it is one sheet.

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
    loops = kernels.loops("encounters", sheet.vertices)
    if loops is not None:
        return _by_loops(loops, sheet, edges, length, apart, local, along)
    joined = _joined(sheet, edges, length, along)
    reach = max(apart, local)

    # what is too far is left out as soon as that is known: most candidates are
    vertex, face = _vertex_face_candidates(sheet, reach)
    corners = sheet.faces[face]
    near = sheet.moving[vertex] | sheet.moving[corners].any(axis=1)
    near &= ~(corners == vertex[:, None]).any(axis=1)
    vertex, corners = vertex[near], corners[near]
    distance, _ = closest_on_triangles(sheet.vertices[vertex], sheet.vertices[corners])
    near = distance < reach
    vertex, corners, distance = vertex[near], corners[near], distance[near]
    far = np.logical_not(joined[vertex[:, None], corners].any(axis=1))
    order = np.flatnonzero(distance < np.where(far, apart, local))
    order = order[np.argsort(vertex[order], kind="stable")]

    first, second = _edge_candidates(sheet.vertices[edges], length, reach)
    moving = np.asarray(sheet.moving[edges].any(axis=1))
    (a, b), (c, d) = edges[first].T, edges[second].T
    near = (moving[first] | moving[second]) & (a != c) & (a != d) & (b != c) & (b != d)
    four = np.stack([a[near], b[near], c[near], d[near]], axis=1)
    between, _, _ = closest_on_segments(
        sheet.vertices[four[:, :2]], sheet.vertices[four[:, 2:]]
    )
    near = between < reach
    four, between = four[near], between[near]
    paths = joined[four[:, :2, None], four[:, None, 2:]]
    edge_far = np.logical_not(paths.any(axis=(1, 2)))
    kept = between < np.where(edge_far, apart, local)
    return Encounters(
        vertex=vertex[order],
        corners=corners[order],
        vertex_distance=distance[order],
        vertex_apart=far[order],
        edges=four[kept],
        edge_distance=between[kept],
        edge_apart=edge_far[kept],
    )


def _by_loops(
    loops: Any,
    sheet: Sheet,
    edges: Int[np.ndarray, "e 2"],
    length: Float[np.ndarray, " e"],
    apart: float,
    local: float,
    along: float,
) -> Encounters:
    """The same as `encounters` by loops."""
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
    """Exact distances of the pairs where the sheet's vertices are elsewhere.

    Args:
        vertices: Positions.
        found: Pairs of vertices with triangles, and of edges.
    """
    loops = kernels.loops("distances", vertices)
    if loops is not None:
        return loops.of_pairs(vertices, found.vertex, found.corners, found.edges)
    corners, ends = vertices[found.corners], vertices[found.edges]
    to_triangle, _ = closest_on_triangles(vertices[found.vertex], corners)
    between, _, _ = closest_on_segments(ends[:, :2], ends[:, 2:])
    return to_triangle, between


def nearest_apart(sheet: Sheet, *, within: float, along: float) -> float:
    """Smallest distance of a vertex to a triangle that is apart from it.

    Args:
        sheet: Surface and walls.
        within: Distances up to this are found.
        along: See `encounters`.

    Returns:
        The distance, infinite if there is none up to ``within``.
    """
    edges, length = _edges(sheet)
    loops = kernels.loops("encounters", sheet.vertices)
    if loops is not None:
        joined = loops.joined(edges, length, len(sheet.vertices), along)
        _, _, distance, _ = loops.vertices_and_faces(
            sheet.vertices, sheet.faces, sheet.moving, *joined, within, -1.0
        )
        return float(distance.min(initial=np.inf))
    vertex, face = _vertex_face_candidates(sheet, within)
    corners = sheet.faces[face]
    near = sheet.moving[vertex] | sheet.moving[corners].any(axis=1)
    joined = _joined(sheet, edges, length, along)
    near &= ~joined[vertex[:, None], corners].any(axis=1)
    vertex, corners = vertex[near], corners[near]
    distance, _ = closest_on_triangles(sheet.vertices[vertex], sheet.vertices[corners])
    least = float(distance.min(initial=np.inf))
    return least if least < within else float("inf")


def _edges(
    sheet: Sheet,
) -> tuple[Int[np.ndarray, "e 2"], Float[np.ndarray, " e"]]:
    """All edges, and their lengths."""
    edges = build_topology(sheet.faces, len(sheet.vertices)).edges
    return edges, lengths(sheet.vertices[edges[:, 1]] - sheet.vertices[edges[:, 0]])


def _joined(
    sheet: Sheet,
    edges: Int[np.ndarray, "e 2"],
    length: Float[np.ndarray, " e"],
    along: float,
) -> Bool[np.ndarray, "m m"]:
    """Which vertices a path over edges joins that is not longer than a bound."""
    graph = coo_array(
        (length, (edges[:, 0], edges[:, 1])), shape=(len(sheet.vertices),) * 2
    ).tocsr()
    return np.isfinite(dijkstra(graph, directed=False, limit=along))


def _vertex_face_candidates(
    sheet: Sheet, reach: float
) -> tuple[Int[np.ndarray, " c"], Int[np.ndarray, " c"]]:
    """Vertices and faces whose distance may be below a bound."""
    corners = sheet.vertices[sheet.faces]
    centre = corners.mean(axis=1)
    radius = lengths(corners - centre[:, None]).max(axis=1)
    found = KDTree(sheet.vertices).query_ball_point(centre, reach + radius)
    count = np.fromiter(map(len, found), dtype=np.int64, count=len(found))
    face = np.repeat(np.arange(len(sheet.faces)), count)
    return _chained(found), face


def _edge_candidates(
    ends: Float[np.ndarray, "e 2 3"], length: Float[np.ndarray, " e"], reach: float
) -> tuple[Int[np.ndarray, " c"], Int[np.ndarray, " c"]]:
    """Pairs of edges whose distance may be below a bound, by their middles.

    Each edge is asked for those that are not longer, so a few long ones (of a coarse
    wall) do not widen the search for all.
    """
    order = np.argsort(length, kind="stable")
    middle = 0.5 * (ends[order, 0] + ends[order, 1])
    found = KDTree(middle).query_ball_point(middle, reach + length[order])
    count = np.fromiter(map(len, found), dtype=np.int64, count=len(found))
    first = np.repeat(np.arange(len(found)), count)
    second = _chained(found)
    below = second < first
    return order[first[below]], order[second[below]]


def _chained(lists: Iterable[list[int]]) -> Int[np.ndarray, " c"]:
    """All of some lists, one after the other."""
    return np.fromiter(itertools.chain.from_iterable(lists), np.int64)
