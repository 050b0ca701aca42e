"""Area, normal and shape of triangles."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


SLIVER = 0.15
"""Radius ratio below which a triangle is a sliver: none is made by subdivision, and
those that arise are repaired."""


def area_vectors(triangles: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return half the cross product of two sides: unit normal times area."""
    a, b, c = triangles[:, 0].T, triangles[:, 1].T, triangles[:, 2].T
    ux, uy, uz = b - a
    vx, vy, vz = c - a
    return 0.5 * np.stack(
        [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx], axis=1
    )


def areas(triangles: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, " n"]:
    """Return the triangle areas (length²)."""
    return lengths(area_vectors(triangles))


def lengths(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
    """Return the Euclidean lengths."""
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


def unit(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Normalise vectors to length 1; the zero vector stays zero."""
    length = lengths(vectors)
    return vectors / np.where(length > 0, length, 1.0)[:, None]


def side_lengths(triangles: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the length of the side from corner k to corner k + 1."""
    return lengths(triangles[:, [1, 2, 0]] - triangles)


def radius_ratio(triangles: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, " n"]:
    """Return the shape quality 2 r_in / r_circ, dimensionless.

    It is 16 A² / (abc (a + b + c)): 1 for the equilateral triangle, its only stationary
    value, and 0 for a degenerate one. The paper (section 4, after Pébay and Baker) uses
    r_in / r_circ, half of this; no comparison changes.
    """
    side = side_lengths(triangles)
    vector = area_vectors(triangles)
    scale = side.prod(axis=1) * side.sum(axis=1)
    return 16.0 * np.einsum("ni,ni->n", vector, vector) / np.where(scale > 0, scale, 1)
