"""Preconditioned conjugate gradients for the linear response, as one loop.

The method is that of `jaxgrow.equilibrium.hessian_solve`, with Hessian products of the
terms' roots (see `jaxgrow.kernels.roots`). If some nodes are pinned or held, as in
every patch, the preconditioner is the inverse of the Hessian's diagonal blocks (block
Jacobi), 3 × 3 for each node; it reduces the products to half to two thirds. If rigid
modes must be projected out, there is none.

Arguments: addresses of the roots, their wiring, mask of particles alive, nodes, mask of
free nodes, whether the whole may translate and rotate, the force, limits (relative
residual at the end, largest number of products, and least curvature over the largest
met), a force without symmetry, the blocks or approximate ones, and the buffers.
Results: the displacement; its residual and the smallest curvature met; numbers of
products and of null modes, and the code of the `Result`.
"""

import math
from typing import no_type_check

import numpy as np
from numba import cfunc, njit

from jaxgrow.kernels import frames
from jaxgrow.kernels.arguments import Argument, codes_of
from jaxgrow.kernels.regrouped import regrouped
from jaxgrow.kernels.tables import make_tables, run
from jaxgrow.runtime.results import Result


CONVERGED, SINGULAR = Result.CONVERGED.code, Result.SINGULAR.code
NOT_SOLVED = Result.NOT_SOLVED.code

_LEAST = 0.02
"""Least stiffness, over the mean of all nodes, of nodes whose block is singular."""

_THIN = 1e-12
"""Determinant of a block, over the cube of its mean stiffness, below which it counts as
singular."""


@regrouped
@no_type_check
def _dot(a: np.ndarray, b: np.ndarray) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i, 0] * b[i, 0] + a[i, 1] * b[i, 1] + a[i, 2] * b[i, 2]
    return total


@njit(cache=True)
@no_type_check
def _multiply(
    addresses: np.ndarray,
    tables: np.ndarray,
    free: np.ndarray,
    vector: np.ndarray,
    way: np.ndarray,
    product: np.ndarray,
) -> None:
    """Compute the Hessian product with a vector, on free nodes, in `product`."""
    for i in range(len(free)):
        for axis in range(3):
            way[i, axis] = vector[i, axis] if free[i] else 0.0
    product[:] = 0.0
    run(addresses, tables)
    for i in range(len(free)):
        if not free[i]:
            product[i] = 0.0


@njit(cache=True)
@no_type_check
def _rigid_modes(
    nodes: np.ndarray, touching: np.ndarray, shifts: bool, turns: bool
) -> np.ndarray:
    """Build an orthonormal basis of the rigid motions."""
    count, centre = 0, np.zeros(3)
    for i in range(len(touching)):
        if touching[i]:
            centre += nodes[i]
            count += 1
    centre /= max(count, 1)
    modes, found = np.zeros((6, len(touching), 3)), 0
    for number in range(6):
        if not (shifts and (number < 3 or turns)):
            continue
        mode = modes[found]
        mode[:] = 0.0
        for i in range(len(touching)):
            if touching[i]:
                if number < 3:
                    mode[i, number] = 1.0
                else:
                    # the axis × the vector from the centre
                    y, z = (number - 2) % 3, (number - 1) % 3
                    mode[i, y] = -(nodes[i, z] - centre[z])
                    mode[i, z] = nodes[i, y] - centre[y]
        size = math.sqrt(_dot(mode, mode))
        for _ in range(2):  # twice is enough
            _project(modes[:found], mode)
        length = math.sqrt(_dot(mode, mode))
        if length > math.sqrt(np.finfo(np.float64).eps) * max(size, 1.0):
            mode /= length
            found += 1
    return modes[:found]


@njit(cache=True)
@no_type_check
def _project(modes: np.ndarray, vector: np.ndarray) -> None:
    """Project orthonormal modes out of a vector."""
    for mode in range(len(modes)):
        part = _dot(modes[mode], vector)
        for i in range(len(vector)):
            for axis in range(3):
                vector[i, axis] -= part * modes[mode, i, axis]


@njit(cache=True)
@no_type_check
def _invert(block: np.ndarray, least: float, inverse: np.ndarray) -> None:
    """Compute the inverse of a symmetric block.

    If it is not positive definite, that of its mean stiffness, `least` at least.
    """
    a, b, c, d, e, f = block[0], block[1], block[2], block[4], block[5], block[8]
    of_a, of_b, of_c = d * f - e * e, c * e - b * f, b * e - c * d
    of_f = a * d - b * b
    determinant = a * of_a + b * of_b + c * of_c
    size = (a + d + f) / 3.0
    if a > 0.0 and of_f > 0.0 and determinant > _THIN * max(size, least) ** 3:
        inverse[0, 0], inverse[1, 1], inverse[2, 2] = of_a, a * f - c * c, of_f
        inverse[0, 1], inverse[0, 2], inverse[1, 2] = of_b, of_c, b * c - a * e
        inverse[1, 0], inverse[2, 0] = inverse[0, 1], inverse[0, 2]
        inverse[2, 1] = inverse[1, 2]
        inverse /= determinant
        return
    for axis in range(3):
        inverse[axis, axis] = 1.0
        if 0.0 < least < np.inf:
            inverse[axis, axis] /= max(size, least)


@njit(cache=True)
@no_type_check
def _scales(blocks: np.ndarray, touching: np.ndarray) -> np.ndarray:
    """Compute the inverse of each node's block; 0 without interactions."""
    mean, count = 0.0, 0
    for i in range(len(touching)):
        if touching[i]:
            mean += abs(blocks[i, 0] + blocks[i, 4] + blocks[i, 8]) / 3.0
            count += 1
    scales = np.zeros((len(touching), 3, 3))
    for i in range(len(touching)):
        if touching[i]:
            _invert(blocks[i], _LEAST * mean / count, scales[i])
    return scales


@njit(cache=True)
@no_type_check
def solve(
    addresses: np.ndarray,
    tables: np.ndarray,
    nodes: np.ndarray,
    free: np.ndarray,
    loose: np.ndarray,
    force: np.ndarray,
    limits: np.ndarray,
    uneven: np.ndarray,
    blocks: np.ndarray,
    way: np.ndarray,
    product: np.ndarray,
    x: np.ndarray,
    numbers: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Solve for the response to a force; see the module."""
    rows = len(free)
    relative, most, least = limits[0], limits[1], limits[2]
    hp = product[:rows]
    _multiply(addresses, tables, free, uneven, way, product)
    touching, null_modes = np.zeros(rows, np.bool_), 0
    for i in range(rows):
        touching[i] = bool(free[i]) and (hp[i] != 0.0).any()
        null_modes += 3 * (bool(free[i]) and not touching[i])
    modes = _rigid_modes(nodes, touching, bool(loose[0]), bool(loose[1]))
    counts[0], counts[1] = 0, null_modes + len(modes)
    if len(modes) > 0:
        blocks = np.zeros_like(blocks)  # whose inverses are 1
    scales = _scales(blocks, touching)
    b = np.zeros((rows, 3))
    for i in range(rows):
        for axis in range(3):
            b[i, axis] = force[i, axis] if touching[i] else 0.0
    whole = _dot(b, b)
    _project(modes, b)
    # a force that only translates or rotates leaves rounding, which has no solution
    if _dot(b, b) <= (100 * np.finfo(np.float64).eps) ** 2 * whole:
        b[:] = 0.0
    size = _dot(b, b)
    r, p, z = b.copy(), np.zeros((rows, 3)), np.zeros((rows, 3))
    x[:] = 0.0
    square, before, goal = size, 1.0, relative * relative * size
    stiffest, softest, flat, first, scaled = 0.0, np.inf, False, True, 0.0
    while counts[0] < most and not flat:
        for i in range(rows):
            for axis in range(3):
                row = scales[i, axis]
                z[i, axis] = row[0] * r[i, 0] + row[1] * r[i, 1] + row[2] * r[i, 2]
        now = _dot(r, z)
        if first:
            scaled = relative * relative * now
        if not (square > goal or now > scaled):
            break
        ratio = 0.0 if first else now / before
        for i in range(rows):
            for axis in range(3):
                p[i, axis] = z[i, axis] + ratio * p[i, axis]
        first, before = False, now
        _multiply(addresses, tables, free, p, way, product)
        _project(modes, hp)
        counts[0] += 1
        length, along = _dot(p, p), _dot(p, hp)
        curvature = along / length
        stiffest = max(stiffest, abs(curvature))
        flat = not curvature > least * stiffest
        softest = min(softest, curvature)
        if flat:
            break
        rate = now / along
        for i in range(rows):
            for axis in range(3):
                x[i, axis] += rate * p[i, axis]
                r[i, axis] -= rate * hp[i, axis]
        _project(modes, r)
        square = _dot(r, r)
    _project(modes, x)
    _multiply(addresses, tables, free, x, way, product)
    _project(modes, hp)
    left = 0.0
    for i in range(rows):
        for axis in range(3):
            left += (hp[i, axis] - b[i, axis]) ** 2
    residual = math.sqrt(left / size) if size > 0.0 else math.sqrt(left)
    residual = residual if math.isfinite(size) else np.nan
    length = _dot(x, x)
    if length > 0.0:
        softest = min(softest, _dot(x, hp) / length)
    counts[2] = CONVERGED if residual <= 10.0 * relative else NOT_SOLVED
    if flat:
        counts[2] = SINGULAR
    numbers[0], numbers[1] = residual, softest
    if counts[2] != CONVERGED:
        x[:] = np.nan


ARGUMENTS = (
    Argument("addresses", np.int64, 1),
    Argument("wiring", np.int64, 2),
    Argument("alive", np.bool_, 1),
    Argument("nodes", np.float64, 2),
    Argument("free", np.bool_, 1),
    Argument("loose", np.bool_, 1),
    Argument("force", np.float64, 2),
    Argument("limits", np.float64, 1),
    Argument("uneven", np.float64, 2),
    Argument("blocks", np.float64, 2),
)
RESULTS = (
    Argument("displacement", np.float64, 2),
    Argument("numbers", np.float64, 1),
    Argument("counts", np.int64, 1),
)

_CODES = codes_of(ARGUMENTS, RESULTS, more=True)


@cfunc(frames.HANDLER, cache=True)
@no_type_check
def handler(frame: int) -> int:
    """Call `solve` from XLA; see the module for arguments and results."""
    if frames.answers_version(frame):
        return 0
    bad = frames.mismatch(frame, _CODES)
    if bad:
        return frames.refuse(frame, bad)
    roots, most = frames.size(frame, 0, 0), frames.size(frame, 1, 1)
    total, rows = frames.size(frame, 3, 0), frames.size(frame, 4, 0)
    addresses = frames.long_indices(frames.argument(frame, 0), (roots,))
    wiring = frames.long_indices(frames.argument(frame, 1), (roots, most))
    nodes = frames.reals(frames.argument(frame, 3), (total, 3))
    way, product = np.zeros((total, 3)), np.zeros((total, 3))
    count, last = frames.size(frame, 2, 0), frames.count_arguments(frame)
    given = last, count, nodes, way, product, np.zeros(total)
    solve(
        addresses,
        make_tables(frame, wiring, *given),
        nodes,
        frames.booleans(frames.argument(frame, 4), (rows,)),
        frames.booleans(frames.argument(frame, 5), (2,)),
        frames.reals(frames.argument(frame, 6), (rows, 3)),
        frames.reals(frames.argument(frame, 7), (3,)),
        frames.reals(frames.argument(frame, 8), (rows, 3)),
        frames.reals(frames.argument(frame, 9), (total, 9)),
        way,
        product,
        frames.reals(frames.result(frame, 0), (rows, 3)),
        frames.reals(frames.result(frame, 1), (2,)),
        frames.long_indices(frames.result(frame, 2), (3,)),
    )
    return 0
