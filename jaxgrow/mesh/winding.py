"""Generalised winding number: on which side of a closed mesh a point is."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrow import kernels


ON_SURFACE = 1e-13
"""Triple product over the lengths' product, below which a point is on the surface."""

_CHUNK = 20_000
"""Pairs of point and face at a time: what stays in the cache."""


def winding_number(
    points: Float[np.ndarray, "n 3"],
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
) -> Float[np.ndarray, " n"]:
    """Sum of the signed solid angles of all faces over 4 pi.

    For a closed surface with outward normals: 1 inside, 0 outside, whole numbers up to
    rounding; on the surface itself, a fraction.
    The solid angle Ω of a triangle seen from the origin is
    tan(Ω / 2) = a·(b × c) / (|a||b||c| + (a·b)|c| + (b·c)|a| + (c·a)|b|)
    (Van Oosterom and Strackee 1983). No distance, no sign of a distance and no nearest
    face enters.

    Args:
        points: Where to ask.
        vertices: Mesh vertices, in the same unit.
        faces: Mesh faces.

    Returns:
        The winding number at each point, dimensionless.
    """
    loops = kernels.loops("winding", points)
    if loops is not None:
        corners = vertices[faces].reshape(-1, 9).T.astype(float, order="C")
        return loops.numbers(np.array(points), corners, ON_SURFACE)
    used, index = np.unique(faces, return_inverse=True)
    index = index.reshape(-1, 3)
    result = np.zeros(len(points))
    step = max(1, _CHUNK // max(len(faces), 1))
    for start in range(0, len(points), step):
        part = slice(start, start + step)
        ray = vertices[used][None] - points[part, None]
        length = np.sqrt(np.einsum("pvi,pvi->pv", ray, ray))
        x, y, z = (np.ascontiguousarray(ray[..., k])[:, index] for k in range(3))
        size = length[:, index]
        ax, bx, cx = x[..., 0], x[..., 1], x[..., 2]
        ay, by, cy = y[..., 0], y[..., 1], y[..., 2]
        az, bz, cz = z[..., 0], z[..., 1], z[..., 2]
        a, b, c = size[..., 0], size[..., 1], size[..., 2]
        top = (
            ax * (by * cz - bz * cy)
            + ay * (bz * cx - bx * cz)
            + az * (bx * cy - by * cx)
        )
        bottom = (
            a * b * c
            + (ax * bx + ay * by + az * bz) * c
            + (bx * cx + by * cy + bz * cz) * a
            + (cx * ax + cy * ay + cz * az) * b
        )
        # In a face, an edge or a vertex the angle is undefined: rounding would choose a
        # side. Left out, it makes the sum a fraction, which is neither in nor out.
        size = ON_SURFACE * a * b * c
        on = (np.abs(top) <= size) & (bottom <= size)
        angle = np.where(on, 0.0, np.arctan2(top, bottom))
        result[part] = angle.sum(axis=1) / (2.0 * np.pi)
    return result


def particles_outside(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    points: Float[np.ndarray, "n 3"],
    tissue: str,
) -> Bool[np.ndarray, " n"]:
    """Particles that are not in the tissue.

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
