"""Guard of mesh operations against sweeping over a particle.

A flip or a collapse replaces a disc of old triangles by new ones with the same
boundary. If the new triangles are the cone from an apex p over that boundary (a
collapse to p; a flip, with p an opposite vertex), the volume between old and new is, as
a chain, the sum of the tetrahedra cone(p, t) over the old triangles t. A particle in
none of them keeps its winding number. That is the test; it is conservative.

In addition, no particle may lose clearance: its distance to the new triangles must be
at least the smaller of its distance to the old ones and the stated clearance.

Vertices of the surface itself are obstacles as well (strictly inside a swept
tetrahedron only), so that no sheet of a fold is swept over a vertex of another one.
Crossings of sheets, including edge through edge, are tested by
`jaxgrow.mesh.intersection_guard`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from jaxgrow.mesh.proximity import closest_on_triangles
from jaxgrow.mesh.topology import group, Incidence


@dataclass(frozen=True, eq=False)
class Patches:
    """Pieces of surface before and after proposed operations.

    Attributes:
        old: Old triangles of all operations.
        old_owner: The operation of each, ascending, every operation at least one.
        old_face: Index of each in the surface's faces.
        new: New triangles.
        new_owner: The operation of each, ascending, every operation at least one.
        apex: The point over which the new triangles form a cone.
    """

    old: Float[np.ndarray, "o 3 3"]
    old_owner: Int[np.ndarray, " o"]
    old_face: Int[np.ndarray, " o"]
    new: Float[np.ndarray, "n 3 3"]
    new_owner: Int[np.ndarray, " n"]
    apex: Float[np.ndarray, "k 3"]


@dataclass(frozen=True, eq=False)
class Guard:
    """Guard against operations that harm a particle.

    Attributes:
        particles: Live particles.
        vertices: Vertices of the surface.
        clearance: Distance that no operation may go below, unless the particle was
            nearer before (length).
    """

    particles: Float[np.ndarray, "n 3"]
    vertices: Float[np.ndarray, "m 3"]
    clearance: float

    @cached_property
    def tree(self) -> KDTree:
        """Tree of all obstacles, particles first; built at the first query."""
        return KDTree(np.concatenate([self.particles, self.vertices]))

    def admits(self, patches: Patches) -> Bool[np.ndarray, " k"]:
        """Return whether each operation spares all particles."""
        n_operations = len(patches.apex)
        if not n_operations:
            return np.ones(0, dtype=bool)
        points = self.tree.data
        low, high = patches.apex.copy(), patches.apex.copy()
        for triangles, owner in (
            (patches.old, patches.old_owner),
            (patches.new, patches.new_owner),
        ):
            np.minimum.at(low, owner, triangles.min(axis=1))
            np.maximum.at(high, owner, triangles.max(axis=1))
        radius = 0.5 * np.linalg.norm(high - low, axis=1) + self.clearance
        found = self.tree.query_ball_point(0.5 * (low + high), radius)
        count = np.fromiter(map(len, found), dtype=np.int64, count=len(found))
        owner = np.repeat(np.arange(n_operations), count)
        point = np.concatenate([*found, []]).astype(np.int64)
        inside = np.all(
            (points[point] >= low[owner] - self.clearance)
            & (points[point] <= high[owner] + self.clearance),
            axis=1,
        )
        owner, point = owner[inside], point[inside]

        is_particle = point < len(self.particles)
        old = group(patches.old_owner, np.arange(len(patches.old)), n_operations)
        new = group(patches.new_owner, np.arange(len(patches.new)), n_operations)
        harmed = _swept(points[point], is_particle, owner, patches, old)
        owner, position = owner[is_particle], points[point[is_particle]]
        after = _nearest(position, owner, patches.new, new)
        near = after < self.clearance
        before = _nearest(position[near], owner[near], patches.old, old)
        # Rounding of the distance itself, too small to accumulate over any realistic
        # number of operations.
        lost = after[near] < before - 1e-12 * (1.0 + self.clearance)
        refused = np.zeros(n_operations, dtype=bool)
        refused[harmed] = True
        refused[owner[near][lost]] = True
        return ~refused


def _nearest(
    points: Float[np.ndarray, "p 3"],
    owner: Int[np.ndarray, " p"],
    triangles: Float[np.ndarray, "t 3 3"],
    lists: Incidence,
) -> Float[np.ndarray, " p"]:
    """Return the distance of each point to the triangles of its operation."""
    if not len(points):
        return np.zeros(0)
    row, triangle = lists.rows(owner)
    distance, _ = closest_on_triangles(points[row], triangles[triangle])
    count = lists.count[owner]
    return np.minimum.reduceat(distance, np.cumsum(count) - count)


def _swept(
    points: Float[np.ndarray, "p 3"],
    closed: Bool[np.ndarray, " p"],
    owner: Int[np.ndarray, " p"],
    patches: Patches,
    lists: Incidence,
) -> Int[np.ndarray, " h"]:
    """Find operations whose swept volume holds one of their points.

    Args:
        points: Positions.
        closed: Whether the boundary of the volume counts too for this point.
        owner: The operation of each point.
        patches: The operations.
        lists: Old triangles by operation.
    """
    row, triangle = lists.rows(owner)
    corner = np.concatenate(
        [patches.old[triangle], patches.apex[owner[row]][:, None]], axis=1
    )
    corner = corner - points[row][:, None]
    part = np.stack(
        [
            _determinant(corner[:, 1], corner[:, 2], corner[:, 3]),
            -_determinant(corner[:, 0], corner[:, 2], corner[:, 3]),
            _determinant(corner[:, 0], corner[:, 1], corner[:, 3]),
            -_determinant(corner[:, 0], corner[:, 1], corner[:, 2]),
        ],
        axis=1,
    )
    volume = part.sum(axis=1)
    rounding = 1e-13 * np.abs(corner).max(axis=(1, 2), initial=0.0) ** 3
    least = (part * np.sign(volume)[:, None]).min(axis=1, initial=np.inf)
    within = np.where(closed[row], least >= -rounding, least > rounding)
    return owner[row[within & (np.abs(volume) > rounding)]]


def _determinant(
    a: Float[np.ndarray, "n 3"],
    b: Float[np.ndarray, "n 3"],
    c: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, " n"]:
    """Return the triple product a · (b × c)."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = a.T, b.T, c.T
    return (
        ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    )
