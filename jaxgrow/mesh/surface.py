"""Live surface on the host, and its remeshing as data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int


@runtime_checkable
class Indexable(Protocol):
    """Array that is indexed by integer arrays, of NumPy or JAX."""

    def __getitem__(self, index: Any, /) -> Any:
        """Rows of the array."""


Positions = TypeVar("Positions", bound=Indexable)


@dataclass(frozen=True, eq=False)
class Surface:
    """Oriented triangle mesh, open at its pinned rim.

    Attributes:
        vertices: Positions, any one unit of length (r0 in the simulation).
        faces: Vertex indices, counter-clockwise seen from where the normals
            point (into the lumen).
        fixed: Vertices that every operation keeps, index changes aside, with the
            same coordinates to the last bit.
        source: Index of the polyp's source vertex (paper section 4), -1 for none.
            Kept like a fixed vertex by every mesh operation.

    Raises:
        ValueError: A face or the source names a vertex that does not exist, or the
            arrays do not fit together.
    """

    vertices: Float[np.ndarray, "m 3"]
    faces: Int[np.ndarray, "f 3"]
    fixed: Bool[np.ndarray, " m"]
    source: int = -1

    def __post_init__(self) -> None:
        """Refuse indices out of range here, where the message can still help."""
        count = len(self.vertices)
        if self.fixed.shape != (count,):
            raise ValueError(
                f"fixed has shape {self.fixed.shape} for {count} vertices; "
                "give one flag a vertex."
            )
        if self.faces.size and not (self.faces.min() >= 0 and self.faces.max() < count):
            raise ValueError(
                f"faces name vertices {self.faces.min()} to {self.faces.max()} "
                f"of {count}; indices run from 0 to {count - 1}."
            )
        if not -1 <= self.source < count:
            raise ValueError(
                f"source is {self.source} of {count} vertices; give an index, or -1 "
                "for a surface without a source."
            )

    @property
    def kept(self) -> Bool[np.ndarray, " m"]:
        """Vertices that may neither vanish nor move: fixed ones and the source."""
        kept = self.fixed.copy()
        if self.source >= 0:
            kept[self.source] = True
        return kept


def average_parents(vertices: Positions, parents: Indexable) -> Positions:
    """Return positions after one map: the middle of each vertex's parents.

    ``new[i] = (old[p[i, 0]] + old[p[i, 1]]) / 2``.

    A vertex that is its own two parents keeps its coordinates exactly, since
    (x + x) / 2 is x in binary floating point.

    Args:
        vertices: Any array with indexing and arithmetic (numpy, jax), (m, 3).
        parents: For each new vertex the two old ones that it is the middle of,
            (k, 2) integers.

    Returns:
        An array of the same kind, (k, 3).
    """
    return (vertices[parents[:, 0]] + vertices[parents[:, 1]]) / 2


@dataclass(frozen=True, eq=False)
class Remeshing:
    """Record of mesh operations, which can be replayed on other positions.

    Fairing acts linearly on positions: a new vertex is the middle of two old ones, or
    one old one. So a recorded remeshing carries derivatives too.

    Attributes:
        parents: Consecutive maps, see `average_parents`.
        faces: Faces of the resulting surface.
        fixed: Its fixed vertices.
        source: Its source vertex, -1 for none.
        counts: Number of operations done, by kind, and of those refused, by reason.
    """

    parents: tuple[Int[np.ndarray, "_ 2"], ...]
    faces: Int[np.ndarray, "f 3"]
    fixed: Bool[np.ndarray, " m"]
    source: int = -1
    counts: dict[str, int] = field(default_factory=dict)

    @classmethod
    def unchanged(
        cls, surface: Surface, counts: dict[str, int] | None = None
    ) -> Remeshing:
        """Return the remeshing to this surface's connectivity without a move."""
        return cls((), surface.faces, surface.fixed, surface.source, counts or {})

    def apply(self, vertices: Positions) -> Positions:
        """Compute positions of the new vertices from those of the old ones.

        Args:
            vertices: (m_old, 3), of any array type with indexing and arithmetic.

        Returns:
            (m_new, 3), of the same type. For the positions that the remeshing was
            made from these are the new surface's, bit for bit.
        """
        for parents in self.parents:
            vertices = average_parents(vertices, parents)
        return vertices

    def origin(self) -> Int[np.ndarray, " m"]:
        """Return the index of the old vertex that each new one is, or -1."""
        index = np.arange(len(self.fixed))
        same = np.ones(len(index), dtype=bool)
        for parents in reversed(self.parents):
            first, second = parents[index].T
            same &= first == second
            index = first
        return np.where(same, index, -1)

    def then(self, later: Remeshing) -> Remeshing:
        """Compose this remeshing with a later one; counts add up."""
        names = [*self.counts, *(n for n in later.counts if n not in self.counts)]
        return Remeshing(
            parents=self.parents + later.parents,
            faces=later.faces,
            fixed=later.fixed,
            source=later.source,
            counts={n: self.counts.get(n, 0) + later.counts.get(n, 0) for n in names},
        )
