"""Exact distance from points to triangles and to a mesh."""

from __future__ import annotations

from functools import cached_property
from itertools import chain
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from jaxgrow import kernels
from jaxgrow.mesh.quality import area_vectors, lengths, unit


_AT_ONCE = 4096
"""Points whose candidates are in memory at a time."""

_ROUNDING = 1e-12
"""Of squared distances relative to that of the centre, generously."""


def closest_on_triangles(
    points: Float[np.ndarray, "n 3"], triangles: Float[np.ndarray, "n 3 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Distance of point i to triangle i, and where on the triangle it is reached.

    The foot of the perpendicular, where it falls inside; otherwise the nearest of
    the three sides. So every Voronoi region is covered, and degenerate triangles
    (segments, points) are too: their interior is never asked.

    Args:
        points: Positions.
        triangles: Corners, in the same unit of length.

    Returns:
        Distances, and barycentric weights (non-negative, sum 1) of the closest point.
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    best = np.full(len(points), np.inf)
    weights = np.zeros((len(points), 3))
    rows = np.arange(len(points))
    for i, (p, q) in enumerate(((a, b), (b, c), (c, a))):
        side = q - p
        square = np.einsum("ni,ni->n", side, side)
        along = np.einsum("ni,ni->n", points - p, side)
        t = np.clip(along / np.where(square > 0, square, 1.0), 0.0, 1.0)
        gap = points - p - t[:, None] * side
        square = np.einsum("ni,ni->n", gap, gap)
        nearer = square < best
        best = np.where(nearer, square, best)
        hit = rows[nearer]
        weights[hit] = 0.0
        weights[hit, i] = 1.0 - t[hit]
        weights[hit, (i + 1) % 3] = t[hit]

    normal = area_vectors(triangles)
    square = np.einsum("ni,ni->n", normal, normal)
    area = np.where(square > 0, square, 1.0)
    foot = []
    for p, q in ((b, c), (c, a), (a, b)):
        part = area_vectors(np.stack([points, p, q], axis=1))
        foot.append(np.einsum("ni,ni->n", part, normal) / area)
    inner = np.stack(foot, axis=1)
    height = np.einsum("ni,ni->n", points - a, normal) / np.sqrt(area)
    inside = (square > 0) & (inner > 0).all(axis=1) & (height**2 <= best)
    inner = inner / np.where(inside, inner.sum(axis=1), 1.0)[:, None]
    distance = np.where(inside, np.abs(height), np.sqrt(best))
    return distance, np.where(inside[:, None], inner, weights)


class _Discs(NamedTuple):
    """The disc around each triangle's centre, in its plane, that holds it.

    Attributes:
        centre: Of the triangles.
        radius: Of the spheres and discs around them.
        normal: Unit normals; zero without an area, so that the disc is the sphere.
        thickness: How far a corner is off the plane: by rounding.
    """

    centre: Float[np.ndarray, "f 3"]
    radius: Float[np.ndarray, " f"]
    normal: Float[np.ndarray, "f 3"]
    thickness: Float[np.ndarray, " f"]

    def within(
        self,
        points: Float[np.ndarray, "n 3"],
        which: Int[np.ndarray, " n"],
        distance: Float[np.ndarray, " n"],
    ) -> Bool[np.ndarray, " n"]:
        """Whether the sphere and the disc of a triangle are within a distance."""
        offset = points - self.centre[which]
        away, radius = lengths(offset), self.radius[which]
        near = np.flatnonzero(away - radius < distance)
        offset, away, radius, which = (
            offset[near],
            away[near],
            radius[near],
            which[near],
        )
        height = np.abs(np.einsum("ni,ni->n", offset, self.normal[which]))
        beside = np.sqrt(np.maximum(away**2 - height**2, 0.0))
        square = np.maximum(height - self.thickness[which], 0.0) ** 2
        square += np.maximum(beside - radius, 0.0) ** 2
        within = np.zeros(len(points), dtype=bool)
        within[near] = square < distance[near] ** 2 + _ROUNDING * away**2
        return within


def _discs(triangles: Float[np.ndarray, "f 3 3"]) -> _Discs:
    centre = triangles.mean(axis=1)
    arms = triangles - centre[:, None]
    normal = unit(area_vectors(triangles))
    off = np.abs(np.einsum("fki,fi->fk", arms, normal)).max(axis=1)
    return _Discs(centre, lengths(arms).max(axis=1), normal, off)


class Nearest(NamedTuple):
    """Where each point is nearest to a mesh.

    Attributes:
        distance: Exact distance.
        face: The face where it is reached; of equally near ones (a closest point on an
            edge) any one.
        closest: The closest point.
    """

    distance: Float[np.ndarray, " n"]
    face: Int[np.ndarray, " n"]
    closest: Float[np.ndarray, "n 3"]


class Proximity:
    """A mesh made ready to be asked for its nearest points again and again.

    Loops ask a tree of boxes, see `jaxgrow.kernels.nearest`. Without them triangles are
    sorted into classes of like size. In each class the triangles with the nearest
    centres give an upper bound d, and of those whose centre is within d plus the
    class's radius every one is measured whose disc is within d: from a point far away
    many spheres around triangles are as near as the nearest triangle, but few discs
    are. Nothing nearer can be missed.
    """

    def __init__(
        self, vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
    ) -> None:
        """Sort the triangles.

        Args:
            vertices: Mesh vertices.
            faces: Mesh faces, at least one.

        Raises:
            ValueError: The mesh has no face.
        """
        if not len(faces):
            raise ValueError(
                "the mesh has no face; a distance to nothing is undefined."
            )
        self._vertices, self._faces, self._tree = vertices, faces, None
        loops = kernels.loops("nearest", vertices)
        if loops is not None:
            self._tree = loops.plant(vertices, faces)

    @cached_property
    def _triangles(self) -> Float[np.ndarray, "f 3 3"]:
        return self._vertices[self._faces]

    @cached_property
    def _discs(self) -> _Discs:
        return _discs(self._triangles)

    @cached_property
    def _classes(self) -> list[tuple[Int[np.ndarray, " c"], KDTree, float]]:
        """Triangles of like size, a tree of their centres, and their largest radius."""
        radius = self._discs.radius
        sizes = np.ceil(np.log2(np.maximum(radius, radius.max() * 1e-6 + 1e-300)))
        return [
            (members, KDTree(self._discs.centre[members]), radius[members].max())
            for members in (np.flatnonzero(sizes == size) for size in np.unique(sizes))
        ]

    def nearest(self, points: Float[np.ndarray, "n 3"]) -> Nearest:
        """Distances, faces and closest points, in the mesh's unit of length."""
        distance, face, weights = self.feet(points)
        return Nearest(distance, face, self.at(face, weights))

    def at(
        self, face: Int[np.ndarray, " n"], weights: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Points on faces, by the weights of the corners."""
        return np.einsum("nk,nki->ni", weights, self._vertices[self._faces[face]])

    def feet(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[
        Float[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]
    ]:
        """Distances, faces, and the weights of their corners in the closest points."""
        loops = kernels.loops("nearest", points)
        if loops is not None and self._tree is not None:
            return loops.find(points, self._vertices, self._faces, *self._tree)
        parts = [
            self._feet(points[begin : begin + _AT_ONCE])
            for begin in range(0, max(len(points), 1), _AT_ONCE)
        ]
        distance, face, weights = map(np.concatenate, zip(*parts, strict=True))
        return distance, face, weights

    def _feet(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[
        Float[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]
    ]:
        """The same of some points without loops."""
        best = np.full(len(points), np.inf)
        face = np.zeros(len(points), dtype=np.int64)
        weights = np.zeros((len(points), 3))

        def measure(rows: Int[np.ndarray, " p"], tried: Int[np.ndarray, " p"]) -> None:
            """Measure pairs and keep what is nearer; pairs come sorted by row."""
            triangles = self._triangles[tried]
            distance, weight = closest_on_triangles(points[rows], triangles)
            order = np.lexsort((distance, rows))
            first = order[np.unique(rows[order], return_index=True)[1]]
            first = first[distance[first] < best[rows[first]]]
            best[rows[first]] = distance[first]
            face[rows[first]] = tried[first]
            weights[rows[first]] = weight[first]

        everyone = np.arange(len(points))
        for members, tree, radius in self._classes:
            k = min(3, len(members))
            _, near = tree.query(points, k=k)
            measure(np.repeat(everyone, k), members[near.ravel()])
            found = tree.query_ball_point(points, best + radius)
            count = np.fromiter(map(len, found), dtype=np.int64, count=len(found))
            rows = np.repeat(everyone, count)
            flat = np.fromiter(chain.from_iterable(found), np.int64, count.sum())
            tried = members[flat]
            keep = self._discs.within(points[rows], tried, best[rows])
            measure(rows[keep], tried[keep])
        return best, face, weights


def nearest_on_mesh(
    points: Float[np.ndarray, "n 3"],
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
) -> Nearest:
    """Exact distance to a mesh, the face where it is reached, and the closest point.

    For a mesh that is asked again, keep a `Proximity`.

    Args:
        points: Positions.
        vertices: Mesh vertices, in the same unit.
        faces: Mesh faces, at least one.

    Returns:
        Distances, face indices, closest points.

    Raises:
        ValueError: The mesh has no face.
    """
    return Proximity(vertices, faces).nearest(points)


def closest_on_segments(
    first: Float[np.ndarray, "n 2 3"], second: Float[np.ndarray, "n 2 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Distance of segment i of one list to segment i of the other.

    The common perpendicular, where both of its feet fall inside; otherwise the nearest
    of the four distances of an end to the other segment.

    Args:
        first: Ends.
        second: Ends, in the same unit of length.

    Returns:
        Distances, and where on each segment they are reached, from 0 to 1.
    """
    a, c = first[:, 0], second[:, 0]
    one, other = first[:, 1] - a, second[:, 1] - c
    gap = c - a

    def dot(
        p: Float[np.ndarray, "n 3"], q: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, " n"]:
        return np.einsum("ni,ni->n", p, q)

    square, along, square_other = dot(one, one), dot(one, other), dot(other, other)
    on_one, on_other = dot(one, gap), dot(other, gap)
    determinant = square * square_other - along**2
    skew = determinant > 64 * np.finfo(float).eps * square * square_other
    scale = np.where(skew, determinant, 1.0)
    safe_one = np.where(square > 0, square, 1.0)
    safe_other = np.where(square_other > 0, square_other, 1.0)
    s = (on_one * square_other - on_other * along) / scale
    t = (on_one * along - on_other * square) / scale
    inside = skew & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    zero, one_ = np.zeros(len(a)), np.ones(len(a))
    tries = (
        (zero, np.clip(-on_other / safe_other, 0.0, 1.0)),
        (one_, np.clip((along - on_other) / safe_other, 0.0, 1.0)),
        (np.clip(on_one / safe_one, 0.0, 1.0), zero),
        (np.clip((on_one + along) / safe_one, 0.0, 1.0), one_),
    )
    best, shares = np.full(len(a), np.inf), (zero, zero)
    for usable, (p, q) in ((inside, (s, t)), *((True, pair) for pair in tries)):
        offset = gap + q[:, None] * other - p[:, None] * one
        tried = np.where(usable, dot(offset, offset), np.inf)
        nearer = tried < best
        best = np.where(nearer, tried, best)
        shares = np.where(nearer, p, shares[0]), np.where(nearer, q, shares[1])
    return np.sqrt(best), shares[0], shares[1]
