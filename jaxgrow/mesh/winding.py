"""Generalised winding number, to tell the inside of a closed mesh."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrow import kernels


ON_SURFACE = 1e-13
"""Triple product over the lengths' product, below which a point is on the surface."""


def winding_number(
    points: Float[np.ndarray, "n 3"],
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
) -> Float[np.ndarray, " n"]:
    """Compute the winding number: signed solid angles of all faces over 4 pi.

    For a closed surface with outward normals: 1 inside, 0 outside, whole numbers up to
    rounding; on the surface itself, a fraction.
    The solid angle Ω of a triangle seen from the origin is
    tan(Ω / 2) = a·(b × c) / (|a||b||c| + (a·b)|c| + (b·c)|a| + (c·a)|b|)
    (Van Oosterom and Strackee 1983). Neither distances nor nearest faces are used.

    Args:
        points: Query points.
        vertices: Mesh vertices, in the same unit.
        faces: Mesh faces.

    Returns:
        The winding number at each point, dimensionless.
    """
    corners = np.asarray(vertices, float)[faces].reshape(-1, 9).T.copy()
    # a copy: numba would compile a second signature for read-only arrays
    return kernels.loops("winding").numbers(
        np.array(points, float), corners, ON_SURFACE
    )


def particles_outside(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    points: Float[np.ndarray, "n 3"],
    tissue: str,
) -> Bool[np.ndarray, " n"]:
    """Mark the particles that are not in the tissue.

    Args:
        vertices: The closed organ surface with outward normals.
        faces: Its faces.
        points: Particles, in the same unit.
        tissue: "outside": the surface bounds a lumen, particles must have winding
            number 0; "inside": a solid organ, they must have 1.

    Returns:
        True where a particle is on the wrong side, on the surface, or not finite.

    Raises:
        ValueError: `tissue` is neither of the two.
    """
    if tissue not in ("outside", "inside"):
        raise ValueError(
            f'tissue is {tissue!r}; it must be "outside" (a lumen) or "inside".'
        )
    wanted = 0.0 if tissue == "outside" else 1.0
    finite = np.all(np.isfinite(points), axis=1)
    wrong = ~finite
    number = winding_number(points[finite], vertices, faces)
    wrong[finite] = np.abs(number - wanted) > 1e-3
    return wrong
