"""Guard of mesh operations against crossing the surface or a wall.

A flip or a collapse replaces a disc of old triangles by a new one with the same
boundary. Two conditions are checked for every triangle T near the new disc, of the
surface (except the old disc) or of the static walls:

- *Crossing*: T may meet a new triangle only in the corners that they share: with no
  shared corner the two are disjoint; with one, the side opposite to it of each misses
  the other; with two, they are not folded onto each other (within the audit's
  `FOLD_DEGREES`). The same holds between the new triangles of an operation.
- *Gap*: the exact distance of T to the new triangles that it faces (opposed normals,
  n · n' < 0) must be at least the smaller of its distance to the old disc and the
  stated gap. That is the rule of the particles' clearance. It does not apply to
  triangles beside each other in a sheet, which do not face each other, nor to those
  that have a corner on the disc, whose distance from it is 0 before and after.

Corners are shared if their coordinates are equal to the last bit, so the surface and
the walls, which share its rim, need no common numbering.

A surface that is free of crossings stays so. Where there are some already, an operation
may have as many as its old triangles had, so that it is not blocked by them.

Walls must be parts of surfaces that do not end near the patch: a loose triangle
inside the volume between the old and the new disc would cross neither.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrow.mesh.intersection import TOUCH
from jaxgrow.mesh.particle_guard import Patches
from jaxgrow.mesh.topology import expand, greedy_independent, group, Incidence
from jaxgrow.mesh.triangle_pair import distances, facing, overlapping, same_corners


@dataclass(frozen=True, eq=False)
class Crossing:
    """Guard against operations that make the surface cross itself or a wall.

    Attributes:
        surface: All triangles of the surface as it is.
        walls: Static triangles around it, oriented as the surface is.
        gap: Distance between triangles that face each other below which no operation
            may go, unless they were nearer before (length).
    """

    surface: Float[np.ndarray, "f 3 3"]
    walls: Float[np.ndarray, "w 3 3"]
    gap: float

    @classmethod
    def of(
        cls,
        vertices: Float[np.ndarray, "m 3"],
        faces: Int[np.ndarray, "f 3"],
        walls: Float[np.ndarray, "w 3 3"] | None,
        gap: float,
    ) -> Crossing:
        """Build the crossing test of a mesh, with walls or without."""
        none = np.zeros((0, 3, 3))
        return cls(vertices[faces], none if walls is None else walls, gap)

    @cached_property
    def obstacles(self) -> Float[np.ndarray, "o 3 3"]:
        """The triangles of the surface, then the walls."""
        return np.concatenate([self.surface, self.walls])

    @cached_property
    def boxes(self) -> tuple[Float[np.ndarray, "o 3"], Float[np.ndarray, "o 3"]]:
        """Lower and upper corners of the boxes around the obstacles."""
        return _boxes(self.obstacles)

    def walls_have_edge(
        self, ends: Float[np.ndarray, "k 2 3"]
    ) -> Bool[np.ndarray, " k"]:
        """Return whether a wall already has an edge between two points.

        A second one, of the surface, would be an edge of four triangles once surface
        and walls are joined.
        """
        sides = self.walls[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 3)
        found = np.zeros(len(ends), dtype=bool)
        for way in (ends, ends[:, ::-1]):
            same = np.all(way[:, None] == sides[None], axis=(2, 3))
            found |= same.any(axis=1)
        return found

    def admits(self, patches: Patches) -> Bool[np.ndarray, " k"]:
        """Return whether each operation alone leaves the surface clear.

        Args:
            patches: Operations on the surface as it is.

        Returns:
            Whether it may be done.
        """
        n_operations = len(patches.apex)
        if not n_operations:
            return np.ones(0, dtype=bool)
        near = self._near(patches.new, patches.new_owner, patches)
        after = _count_crossings(patches.new, patches.new_owner, near, n_operations)
        refused = after > 0
        if refused.any():
            refused &= after > self._crossings_before(patches, refused)

        # Obstacles with a corner on the disc are skipped: they stay at distance zero.
        pair = near.pair
        beside = np.zeros(len(near.operation), dtype=bool)
        beside[pair[near.same.any(axis=(1, 2))]] = True
        asked = ~beside[pair] & facing(near.one, near.other)
        distance = np.full(len(near.operation), np.inf)
        apart = distances(near.one[asked], near.other[asked])
        np.minimum.at(distance, pair[asked], apart)
        low = np.flatnonzero(distance < self.gap)
        if len(low):
            operation, obstacle = near.operation[low], near.obstacle[low]
            old = group(patches.old_owner, np.arange(len(patches.old)), n_operations)
            row, piece = old.rows(operation)
            before = np.full(len(low), np.inf)
            apart = distances(patches.old[piece], self.obstacles[obstacle[row]])
            np.minimum.at(before, row, apart)
            refused[operation[self._nearer(distance[low], before)]] = True
        return ~refused

    def compatible(self, patches: Patches) -> Bool[np.ndarray, " k"]:
        """Select operations that can be done together, in order of rank.

        Args:
            patches: Operations that share no vertex and are admitted each, the best
                first.

        Returns:
            Those that a serial pass in this order would choose.
        """
        n_operations = len(patches.apex)
        low, high = _boxes_by_owner(patches.new, patches.new_owner, n_operations)
        reach = self._reach(low, high)
        first, second = _overlapping_boxes(low - reach, high + reach, low, high)
        first, second = first[first < second], second[first < second]
        if not len(first):
            return np.ones(n_operations, dtype=bool)
        new = group(patches.new_owner, np.arange(len(patches.new)), n_operations)
        pair, a, b = _products(new, first, second)
        one, other = patches.new[a], patches.new[b]
        barred = np.zeros(len(first), dtype=bool)
        barred[pair[overlapping(one, other, same_corners(one, other))]] = True

        asked = facing(one, other)
        distance = np.full(len(first), np.inf)
        np.minimum.at(distance, pair[asked], distances(one[asked], other[asked]))
        near = np.flatnonzero(distance < self.gap)
        old = group(patches.old_owner, np.arange(len(patches.old)), n_operations)
        pair, a, b = _products(old, first[near], second[near])
        before = np.full(len(near), np.inf)
        np.minimum.at(before, pair, distances(patches.old[a], patches.old[b]))
        barred[near[self._nearer(distance[near], before)]] = True
        conflict = np.arange(np.count_nonzero(barred))
        return greedy_independent(
            np.concatenate([first[barred], second[barred]]),
            np.concatenate([conflict, conflict]),
            n_operations,
        )

    def _nearer(
        self, after: Float[np.ndarray, " p"], before: Float[np.ndarray, " p"]
    ) -> Bool[np.ndarray, " p"]:
        """Return whether a distance under the gap has fallen beyond rounding."""
        return after < np.minimum(before, self.gap) - 1e-12 * (1.0 + self.gap)

    def _reach(
        self, low: Float[np.ndarray, "n 3"], high: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 1"]:
        """Return the margin around a box within which obstacles matter."""
        return self.gap + TOUCH * (high - low).max(axis=1, initial=0.0)[:, None]

    def _near(
        self,
        triangles: Float[np.ndarray, "t 3 3"],
        owner: Int[np.ndarray, " t"],
        patches: Patches,
    ) -> _Near:
        """Find near pairs of these triangles and obstacles, except old faces."""
        low, high = _boxes_by_owner(triangles, owner, len(patches.apex))
        reach = self._reach(low, high)
        operation, obstacle = _overlapping_boxes(low - reach, high + reach, *self.boxes)
        count = len(self.obstacles)
        own = np.isin(
            operation * count + obstacle, patches.old_owner * count + patches.old_face
        )
        operation, obstacle = operation[~own], obstacle[~own]

        lists = group(owner, np.arange(len(owner)), len(patches.apex))
        pair, piece = lists.rows(operation)
        other = obstacle[pair]
        low, high = _boxes(triangles)
        reach = self._reach(low, high)
        low, high = low - reach, high + reach
        for axis in range(3):
            close = low[piece, axis] <= self.boxes[1][other, axis]
            close &= high[piece, axis] >= self.boxes[0][other, axis]
            pair, piece, other = pair[close], piece[close], other[close]
        one, other = triangles[piece], self.obstacles[other]
        return _Near(operation, obstacle, pair, one, other, same_corners(one, other))

    def _crossings_before(
        self, patches: Patches, chosen: Bool[np.ndarray, " k"]
    ) -> Float[np.ndarray, " k"]:
        """Count the crossings of the old triangles of chosen operations."""
        part = chosen[patches.old_owner]
        triangles, owner = patches.old[part], patches.old_owner[part]
        near = self._near(triangles, owner, patches)
        return _count_crossings(triangles, owner, near, len(patches.apex))


@dataclass(frozen=True, eq=False)
class _Near:
    """Near pairs of operation and obstacle, and of their triangles.

    Attributes:
        operation: The operation of each pair.
        obstacle: The obstacle of each pair.
        pair: Index of the above pair that each pair of triangles belongs to.
        one: The triangle of the operation.
        other: The obstacle.
        same: Whether corner i of the one is corner j of the other.
    """

    operation: Int[np.ndarray, " q"]
    obstacle: Int[np.ndarray, " q"]
    pair: Int[np.ndarray, " p"]
    one: Float[np.ndarray, "p 3 3"]
    other: Float[np.ndarray, "p 3 3"]
    same: Bool[np.ndarray, "p 3 3"]


def _count_crossings(
    triangles: Float[np.ndarray, "t 3 3"],
    owner: Int[np.ndarray, " t"],
    near: _Near,
    n_operations: int,
) -> Float[np.ndarray, " k"]:
    """Count each operation's crossings, with obstacles and within itself."""
    lists = group(owner, np.arange(len(owner)), n_operations)
    first, second = lists.rows(owner)
    once = first < second
    first, second = first[once], second[once]
    one, other = triangles[first], triangles[second]
    crossing = overlapping(
        np.concatenate([near.one, one]),
        np.concatenate([near.other, other]),
        np.concatenate([near.same, same_corners(one, other)]),
    )
    operation = np.concatenate([near.operation[near.pair], owner[first]])
    return np.bincount(operation, crossing, minlength=n_operations)


def _boxes(
    triangles: Float[np.ndarray, "n 3 3"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return lower and upper corners of the boxes around triangles."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _boxes_by_owner(
    triangles: Float[np.ndarray, "t 3 3"], owner: Int[np.ndarray, " t"], count: int
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """Return the box around the triangles of each owner; empty for none."""
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    least, most = _boxes(triangles)
    np.minimum.at(low, owner, least)
    np.maximum.at(high, owner, most)
    return low, high


def _overlapping_boxes(
    low: Float[np.ndarray, "k 3"],
    high: Float[np.ndarray, "k 3"],
    other_low: Float[np.ndarray, "o 3"],
    other_high: Float[np.ndarray, "o 3"],
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Find all overlapping pairs of boxes of two lists (sweep along an axis).

    For few operations and a few thousand triangles a sweep along one axis costs less
    than building a tree. Triangles near no operation are left out first.
    """
    least, most = low.min(axis=0, initial=np.inf), high.max(axis=0, initial=-np.inf)
    some = np.flatnonzero(((other_low <= most) & (other_high >= least)).all(axis=1))
    some = some[np.argsort(other_low[some, 0])]
    start = other_low[some, 0]
    widest = (other_high[some, 0] - start).max(initial=0.0)
    first = np.searchsorted(start, low[:, 0] - widest)
    last = np.searchsorted(start, high[:, 0], side="right")
    a, place = expand(first, np.maximum(last - first, 0))
    b = some[place]
    for axis in range(3):
        keep = low[a, axis] <= other_high[b, axis]
        keep &= high[a, axis] >= other_low[b, axis]
        a, b = a[keep], b[keep]
    return a, b


def _products(
    lists: Incidence, first: Int[np.ndarray, " k"], second: Int[np.ndarray, " k"]
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """List all pairs of an item of one row and one of another, with row pair."""
    row, a = lists.rows(first)
    again, b = lists.rows(second[row])
    return row[again], a[again], b
