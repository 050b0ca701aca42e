"""Iso-lines of a scalar on a triangle mesh, as closed polylines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxgrow.mesh.quality import lengths


@dataclass(frozen=True, eq=False)
class IsoLine:
    """Closed iso-line: the points where it crosses edges, in order.

    Seen from where the normals point it runs counter-clockwise round the part of the
    surface whose values are not below the level. Where it passes through a vertex that
    has the level itself, that vertex is one point of it.

    Attributes:
        points: on the edges; the last one is joined to the first.
        within: the end of each crossed edge whose value is not below the level.
        beyond: its other end.
        share: of the edge from `within` to `beyond`, from 0 to 1.
    """

    points: Float[np.ndarray, "k 3"]
    within: Int[np.ndarray, " k"]
    beyond: Int[np.ndarray, " k"]
    share: Float[np.ndarray, " k"]

    @property
    def length(self) -> float:
        """Length, in the vertices' unit."""
        return polygon_length(self.points)


def polygon_length(points: Float[np.ndarray, "k 3"]) -> float:
    """Compute the length of a closed polygon; 0 for fewer than two points."""
    return float(lengths(np.roll(points, -1, axis=0) - points).sum())


def trace_isolines(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    values: Float[np.ndarray, " m"],
    level: float,
) -> tuple[IsoLine, ...]:
    """Trace the closed lines on which a piecewise linear scalar has a level.

    The scalar is linear on each triangle. A line that ends at the mesh's rim is left
    out; on a closed mesh there is none.

    Args:
        vertices: Positions, any one unit of length.
        faces: Oriented manifold.
        values: The scalar, finite.
        level: Its value on the lines.

    Returns:
        The lines, the longest first.
    """
    lines = []
    for loop in _loops(faces, values >= level):
        within, beyond = np.array(loop).T
        share = (values[within] - level) / (values[within] - values[beyond])
        points = vertices[within] + share[:, None] * (
            vertices[beyond] - vertices[within]
        )
        fresh = (points != np.roll(points, 1, axis=0)).any(axis=1)
        if fresh.any():
            lines.append(
                IsoLine(points[fresh], within[fresh], beyond[fresh], share[fresh])
            )
    return tuple(sorted(lines, key=lambda line: -line.length))


def _loops(
    faces: Int[np.ndarray, "f 3"], within: np.ndarray
) -> list[list[tuple[int, int]]]:
    """Sort the crossed edges (end within, end beyond) along each closed line.

    In a triangle that a line crosses one side leaves the part within, and one enters
    it. With the part within on its left the line runs from the former to the latter.
    """
    tail, head = faces, np.roll(faces, -1, axis=1)
    leaves = within[tail] & ~within[head]
    enters = ~within[tail] & within[head]
    start = np.stack([tail[leaves], head[leaves]], axis=1)
    end = np.stack([head[enters], tail[enters]], axis=1)
    follow = dict(
        zip(map(tuple, start.tolist()), map(tuple, end.tolist()), strict=True)
    )
    loops = []
    while follow:
        first, edge = follow.popitem()
        loop = [first]
        while edge in follow:
            loop.append(edge)
            edge = follow.pop(edge)
        if edge == first:
            loops.append(loop)
    return loops
