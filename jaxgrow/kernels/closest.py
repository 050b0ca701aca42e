"""Closest points of points and triangles, and of pairs of segments.

The definitions are those of `jaxgrow.energy.distance`, where they are explained. Pairs
of a point and a triangle are processed in blocks: a block is gathered first, and the
loop over it has no branches, so that it is vectorised over eight pairs. Pairs of
segments are processed one by one, by the host too: their sums are not regrouped.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from jaxgrow.kernels.regrouped import regrouped


_EPSILON = float(np.finfo(np.float64).eps)

_THIN = 1e-6
"""Squared ratio of height to length of a triangle below which the foot of the
perpendicular is compared with the sides, as rounding may have moved it."""

_BLOCK = 128
"""Pairs per block; the gathered data stay in the first-level cache."""

X, Y, Z, LENGTH, OF_B, OF_C = 0, 1, 2, 3, 4, 5
"""Rows of the result for pairs of a point and a triangle: vector to the point from the
closest one, its length, and the barycentric weights of two corners (the three weights
sum to 1)."""


@regrouped
@no_type_check
def measure(
    points: np.ndarray,
    owner: np.ndarray,
    vertices: np.ndarray,
    corners: np.ndarray,
    found: np.ndarray,
) -> None:
    """Compute the closest points of pairs of a point and a triangle.

    Args:
        points: in r0.
        owner: the point of each pair.
        vertices: of the triangles.
        corners: of each pair's triangle, corner by corner.
        found: six rows, see `X` to `OF_C`; written.
    """
    at = np.zeros((9, _BLOCK))
    for first in range(0, len(owner), _BLOCK):
        count = min(_BLOCK, len(owner) - first)
        for k in range(count):
            i, a = owner[first + k], corners[0, first + k]
            b, c = corners[1, first + k], corners[2, first + k]
            for axis in range(3):
                origin = vertices[a, axis]
                at[axis, k] = points[i, axis] - origin
                at[3 + axis, k] = vertices[b, axis] - origin
                at[6 + axis, k] = vertices[c, axis] - origin
        last = first + count
        _measure_block(
            at[0, :count],
            at[1, :count],
            at[2, :count],
            at[3, :count],
            at[4, :count],
            at[5, :count],
            at[6, :count],
            at[7, :count],
            at[8, :count],
            found[X, first:last],
            found[Y, first:last],
            found[Z, first:last],
            found[LENGTH, first:last],
            found[OF_B, first:last],
            found[OF_C, first:last],
        )


@regrouped
@no_type_check
def _measure_block(
    point_x: np.ndarray,
    point_y: np.ndarray,
    point_z: np.ndarray,
    b_x: np.ndarray,
    b_y: np.ndarray,
    b_z: np.ndarray,
    c_x: np.ndarray,
    c_y: np.ndarray,
    c_z: np.ndarray,
    x_found: np.ndarray,
    y_found: np.ndarray,
    z_found: np.ndarray,
    length: np.ndarray,
    of_b: np.ndarray,
    of_c: np.ndarray,
) -> None:
    """Compute the closest points of a block, without branches.

    Coordinates of points and of two corners are relative to the first corner, one array
    for each.
    """
    for k in range(len(length)):
        px, py, pz = point_x[k], point_y[k], point_z[k]
        bx, by, bz = b_x[k], b_y[k], b_z[k]
        cx, cy, cz = c_x[k], c_y[k], c_z[k]
        dx, dy, dz = cx - bx, cy - by, cz - bz
        bb, cc = bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz
        dd = dx * dx + dy * dy + dz * dz
        nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        square = nx * nx + ny * ny + nz * nz
        longest = bb if bb > cc else cc
        longest = longest if longest > dd else dd
        least = 64.0 * _EPSILON * longest
        # the foot of the perpendicular, if it is inside
        fv = (py * cz - pz * cy) * nx + (pz * cx - px * cz) * ny
        fv = (fv + (px * cy - py * cx) * nz) / square
        fw = (by * pz - bz * py) * nx + (bz * px - bx * pz) * ny
        fw = (fw + (bx * py - by * px) * nz) / square
        inside = (square > least * least) & (fv > 0.0) & (fw > 0.0)
        inside &= 1.0 - fv - fw > 0.0
        sure = inside & (square > _THIN * longest * longest)
        x, y, z = px - fv * bx - fw * cx, py - fv * by - fw * cy, pz - fv * bz - fw * cz
        best = x * x + y * y + z * z if inside else np.inf
        v, w = fv if inside else 0.0, fw if inside else 0.0
        # the closest points of the sides bc, ac and ab
        share = ((px - bx) * dx + (py - by) * dy + (pz - bz) * dz) / dd
        share = share if share > 0.0 else 0.0
        share = share if share < 1.0 else 1.0
        share = share if dd > 0.0 else 0.0
        x, y, z = px - bx - share * dx, py - by - share * dy, pz - bz - share * dz
        near = x * x + y * y + z * z
        nearer = (near < best) & (not sure)
        best = near if nearer else best
        v, w = 1.0 - share if nearer else v, share if nearer else w
        share = (px * cx + py * cy + pz * cz) / cc
        share = share if share > 0.0 else 0.0
        share = share if share < 1.0 else 1.0
        share = share if cc > 0.0 else 0.0
        x, y, z = px - share * cx, py - share * cy, pz - share * cz
        near = x * x + y * y + z * z
        nearer = (near < best) & (not sure)
        best = near if nearer else best
        v, w = 0.0 if nearer else v, share if nearer else w
        share = (px * bx + py * by + pz * bz) / bb
        share = share if share > 0.0 else 0.0
        share = share if share < 1.0 else 1.0
        share = share if bb > 0.0 else 0.0
        x, y, z = px - share * bx, py - share * by, pz - share * bz
        near = x * x + y * y + z * z
        nearer = (near < best) & (not sure)
        v, w = share if nearer else v, 0.0 if nearer else w
        x, y, z = px - v * bx - w * cx, py - v * by - w * cy, pz - v * bz - w * cz
        x_found[k], y_found[k], z_found[k] = x, y, z
        length[k] = math.sqrt(x * x + y * y + z * z)
        of_b[k], of_c[k] = v, w


@njit(cache=True, error_model="numpy")
@no_type_check
def _share(along: float, square: float) -> float:
    """Compute the closest parameter on a segment, 0 to 1; 0 for length 0."""
    return min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0


@njit(cache=True, error_model="numpy")
@no_type_check
def _dot(a: tuple, b: tuple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, error_model="numpy")
@no_type_check
def closest_of_segments(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray
) -> tuple[float, float, float, float, float, float]:
    """Compute the closest points of two segments.

    As `jaxgrow.energy.distance.closest_shares`.

    Args:
        a: one end of the first.
        b: its other end.
        c: one end of the second.
        d: its other end.

    Returns:
        Vector from the second to the first, square of its length (infinite for
        non-finite ones), and the parameters (0 to 1) from a to b and from c to d.
    """
    one = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    other = d[0] - c[0], d[1] - c[1], d[2] - c[2]
    gap = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    square, along, square_other = _dot(one, one), _dot(one, other), _dot(other, other)
    on_one, on_other = _dot(one, gap), _dot(other, gap)
    determinant = square * square_other - along * along
    found = 0.0, 0.0, 0.0, np.inf, 0.0, 0.0
    for candidate in range(5):
        if candidate == 0:
            if not determinant > 64.0 * _EPSILON * square * square_other:
                continue
            s = (on_one * square_other - on_other * along) / determinant
            t = (on_one * along - on_other * square) / determinant
            if not (0.0 < s < 1.0 and 0.0 < t < 1.0):
                continue
        elif candidate == 1:
            s, t = 0.0, _share(-on_other, square_other)
        elif candidate == 2:
            s, t = 1.0, _share(along - on_other, square_other)
        elif candidate == 3:
            s, t = _share(on_one, square), 0.0
        else:
            s, t = _share(on_one + along, square), 1.0
        x = s * one[0] - t * other[0] - gap[0]
        y = s * one[1] - t * other[1] - gap[1]
        z = s * one[2] - t * other[2] - gap[2]
        near = x * x + y * y + z * z
        if near < found[3]:
            found = x, y, z, near, s, t
    return found
