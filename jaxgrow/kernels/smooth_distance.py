"""Smooth distances of points to triangles, with their derivatives.

This is the geometry common to contact and collision; their laws are printed.
"""

from typing import no_type_check

import numpy as np

from jaxgrow.kernels.closest import LENGTH, measure, OF_B, OF_C
from jaxgrow.kernels.regrouped import regrouped
from jaxgrow.kernels.smooth_minimum import smooth_minima


@regrouped
@no_type_check
def smooth_distances(
    points: np.ndarray,
    owner: np.ndarray,
    vertices: np.ndarray,
    corners: np.ndarray,
    counts: np.ndarray,
    scale: float,
    half: float,
    reach: float,
) -> tuple:
    """Compute the smooth distance of each point to its triangles.

    Args:
        points: in r0.
        owner: the point of each pair, ascending.
        vertices: of the triangles.
        corners: of each pair's triangle, corner by corner.
        counts: mask of the pairs that enter the smooth minimum.
        scale: range of the interaction, in r0.
        half: half of the sharpness.
        reach: distance, in ranges, beyond which a triangle is ignored.

    Returns:
        Closest points of the pairs (see `jaxgrow.kernels.closest`), their distances in
        ranges, and the results of `jaxgrow.kernels.smooth_minimum.smooth_minima`: the
        smooth distance of the owner of each pair, its derivatives, and powers.
    """
    pairs = len(owner)
    found, value = np.zeros((6, pairs)), np.zeros(pairs)
    measure(points, owner, vertices, corners, found)
    for pair in range(pairs):
        value[pair] = found[LENGTH, pair] / scale if counts[pair] else reach
    u, slope, power = np.zeros(pairs), np.zeros(pairs), np.zeros(pairs)
    smooth_minima(owner, value, half, reach, u, slope, power)
    return found, value, u, slope, power


@regrouped
@no_type_check
def approach(
    found: np.ndarray,
    pair: int,
    of_point: np.ndarray,
    i: int,
    of_vertices: np.ndarray,
    a: int,
    b: int,
    c: int,
) -> float:
    """Compute the derivative of a pair's distance along a displacement."""
    v, w = found[OF_B, pair], found[OF_C, pair]
    total = 0.0
    for axis in range(3):
        way = of_point[i, axis] - (1.0 - v - w) * of_vertices[a, axis]
        way -= v * of_vertices[b, axis] + w * of_vertices[c, axis]
        total += found[axis, pair] * way
    return total / found[LENGTH, pair]


@regrouped
@no_type_check
def _turned(
    weight: tuple,
    offset: tuple,
    corners: tuple,
    ways: tuple,
    along: tuple,
) -> tuple[float, float]:
    """Compute the changes of two barycentric weights of the closest point.

    If all weights are positive, the offset stays normal to both sides; if two are, it
    stays normal to the side between them; at a corner the weights do not change.

    Args:
        weight: of the three corners.
        offset: from the closest point to the point.
        corners: coordinates of all three.
        ways: their displacements.
        along: displacement of the point relative to the closest point of fixed weights.
    """
    wa, wb, wc = weight
    a, b, c = corners
    da, db, dc = ways
    first, second = 0.0, 0.0
    bb, bc, cc, on_b, on_c, dd, on_d = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        side_b, side_c, side_d = b[k] - a[k], c[k] - a[k], c[k] - b[k]
        bb += side_b * side_b
        bc += side_b * side_c
        cc += side_c * side_c
        dd += side_d * side_d
        on_b += along[k] * side_b + offset[k] * (db[k] - da[k])
        on_c += along[k] * side_c + offset[k] * (dc[k] - da[k])
        on_d += along[k] * side_d + offset[k] * (dc[k] - db[k])
    if wa > 0.0 and wb > 0.0 and wc > 0.0:
        determinant = bb * cc - bc * bc
        first = (on_b * cc - on_c * bc) / determinant
        second = (on_c * bb - on_b * bc) / determinant
    elif wa > 0.0 and wb > 0.0:
        first = on_b / bb
    elif wa > 0.0 and wc > 0.0:
        second = on_c / cc
    elif wb > 0.0 and wc > 0.0:
        second = on_d / dd
        first = -second
    return first, second


@regrouped
@no_type_check
def add_bent(
    first: float,
    second: float,
    found: np.ndarray,
    pair: int,
    i: int,
    vertices: np.ndarray,
    a: int,
    b: int,
    c: int,
    of_point: np.ndarray,
    of_vertices: np.ndarray,
    on_point: np.ndarray,
    on_vertices: np.ndarray,
) -> None:
    """Add multiples of a distance's gradient and of its Hessian product.

    With the direction n from the closest point, whose weights are w, the gradient is n
    for the point and -w n for the corners; so the product is the change δn for the
    point, and -w δn - δw n for the corners. Printed from the second derivative of
    `jaxgrow.energy.distance.triangle_distance`, it takes five times as long.

    Args:
        first: factor of the gradient.
        second: factor of the product.
        found: closest points.
        pair: the pair.
        i: the point.
        vertices: with those of the triangle.
        a: its first corner.
        b: its second.
        c: its third.
        of_point: displacement of points.
        of_vertices: displacement of vertices.
        on_point: added to.
        on_vertices: added to.
    """
    length, v, w = found[LENGTH, pair], found[OF_B, pair], found[OF_C, pair]
    u = 1.0 - v - w
    offset = found[0, pair], found[1, pair], found[2, pair]
    at_a = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    at_b = vertices[b, 0], vertices[b, 1], vertices[b, 2]
    at_c = vertices[c, 0], vertices[c, 1], vertices[c, 2]
    of_a = of_vertices[a, 0], of_vertices[a, 1], of_vertices[a, 2]
    of_b = of_vertices[b, 0], of_vertices[b, 1], of_vertices[b, 2]
    of_c = of_vertices[c, 0], of_vertices[c, 1], of_vertices[c, 2]
    x = of_point[i, 0] - u * of_a[0] - v * of_b[0] - w * of_c[0]
    y = of_point[i, 1] - u * of_a[1] - v * of_b[1] - w * of_c[1]
    z = of_point[i, 2] - u * of_a[2] - v * of_b[2] - w * of_c[2]
    corners, ways = (at_a, at_b, at_c), (of_a, of_b, of_c)
    dv, dw = _turned((u, v, w), offset, corners, ways, (x, y, z))
    x -= dv * (at_b[0] - at_a[0]) + dw * (at_c[0] - at_a[0])
    y -= dv * (at_b[1] - at_a[1]) + dw * (at_c[1] - at_a[1])
    z -= dv * (at_b[2] - at_a[2]) + dw * (at_c[2] - at_a[2])
    inward = (x * offset[0] + y * offset[1] + z * offset[2]) / (length * length)
    for axis in range(3):
        normal = offset[axis] / length
        change = (x, y, z)[axis] / length - inward * normal
        part = first * normal + second * change
        slide = second * normal
        on_point[i, axis] += part
        on_vertices[a, axis] += slide * (dv + dw) - part * u
        on_vertices[b, axis] -= slide * dv + part * v
        on_vertices[c, axis] -= slide * dw + part * w


@regrouped
@no_type_check
def add_squares(
    stiffness: float,
    found: np.ndarray,
    pair: int,
    i: int,
    a: int,
    b: int,
    c: int,
    of_point: np.ndarray,
    of_vertices: np.ndarray,
) -> None:
    """Add stiffness n nᵀ, times squared weights, to the blocks of a pair.

    Args:
        stiffness: along the direction n from the closest point to the point.
        found: closest points.
        pair: the pair.
        i: the point, of weight 1.
        a: first corner of the triangle.
        b: its second.
        c: its third.
        of_point: blocks of points in rows; added to.
        of_vertices: likewise.
    """
    length, v, w = found[LENGTH, pair], found[OF_B, pair], found[OF_C, pair]
    u = 1.0 - v - w
    for row in range(3):
        size = stiffness * found[row, pair] / (length * length)
        for column in range(3):
            part, place = size * found[column, pair], 3 * row + column
            of_point[i, place] += part
            of_vertices[a, place] += part * u * u
            of_vertices[b, place] += part * v * v
            of_vertices[c, place] += part * w * w
