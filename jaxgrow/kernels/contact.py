"""The loop over pairs of `jaxgrow.energy.contact.contact_force`."""

import math
from typing import no_type_check

import numpy as np
from numba import cfunc, njit

from jaxgrow.kernels import frames
from jaxgrow.kernels.laws import a2, branches, EXACT


_EPSILON = float(np.finfo(np.float64).eps)

_LEAST = 1e-30
"""Distance that stands for 0, see `jaxgrow.numerics.smallest_distance`."""


_THIN = 1e-6
"""Squared height over length of a triangle below which the foot of the perpendicular
is compared with the sides: rounding may have put it elsewhere."""


@njit(cache=True, fastmath=EXACT, error_model="numpy")
@no_type_check
def _share(along: float, square: float) -> float:
    """Share of a side at which it is closest to a point; 0 for length 0."""
    return min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0


@njit(cache=True, fastmath=EXACT, error_model="numpy")
@no_type_check
def closest(
    point: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, found: np.ndarray
) -> None:
    """The closest point of a triangle, as `jaxgrow.energy.distance.closest_weights`.

    Args:
        point: of whose distance it is.
        a: a corner.
        b: another one.
        c: the third one.
        found: vector to the point from its closest point, square of its length, and
            weights of the three corners; written.
    """
    px, py, pz = point[0] - a[0], point[1] - a[1], point[2] - a[2]
    bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    cx, cy, cz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    bb, cc = bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz
    dx, dy, dz = cx - bx, cy - by, cz - bz
    dd = dx * dx + dy * dy + dz * dz
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    square, longest = nx * nx + ny * ny + nz * nz, max(bb, cc, dd)
    best, v, w = np.inf, 0.0, 0.0
    if square > (64.0 * _EPSILON * longest) ** 2:
        fv = (py * cz - pz * cy) * nx + (pz * cx - px * cz) * ny
        fv = (fv + (px * cy - py * cx) * nz) / square
        fw = (by * pz - bz * py) * nx + (bz * px - bx * pz) * ny
        fw = (fw + (bx * py - by * px) * nz) / square
        if fv > 0.0 and fw > 0.0 and 1.0 - fv - fw > 0.0:
            x = px - fv * bx - fw * cx
            y = py - fv * by - fw * cy
            z = pz - fv * bz - fw * cz
            best, v, w = x * x + y * y + z * z, fv, fw
    if not (best < np.inf and square > _THIN * longest * longest):
        # the closest points of the sides bc, ac and ab
        share = _share((px - bx) * dx + (py - by) * dy + (pz - bz) * dz, dd)
        x, y, z = px - bx - share * dx, py - by - share * dy, pz - bz - share * dz
        near = x * x + y * y + z * z
        if near < best:
            best, v, w = near, 1.0 - share, share
        share = _share(px * cx + py * cy + pz * cz, cc)
        x, y, z = px - share * cx, py - share * cy, pz - share * cz
        near = x * x + y * y + z * z
        if near < best:
            best, v, w = near, 0.0, share
        share = _share(px * bx + py * by + pz * bz, bb)
        x, y, z = px - share * bx, py - share * by, pz - share * bz
        near = x * x + y * y + z * z
        if near < best:
            best, v, w = near, share, 0.0
    found[0] = px - v * bx - w * cx
    found[1] = py - v * by - w * cy
    found[2] = pz - v * bz - w * cz
    found[3] = found[0] ** 2 + found[1] ** 2 + found[2] ** 2
    found[4], found[5], found[6] = 1.0 - v - w, v, w


@njit(cache=True, fastmath=EXACT, error_model="numpy")
@no_type_check
def _power(base: float, exponent: float) -> float:
    """A positive base to a power, by products where that is a whole one."""
    if exponent != math.floor(exponent) or exponent > 64.0:
        return base**exponent
    left, value = np.int64(exponent), 1.0
    while left > 0:
        if left & 1:
            value *= base
        base *= base
        left >>= 1
    return value


@njit(cache=True, fastmath=EXACT, error_model="numpy")
@no_type_check
def add_up(
    position: np.ndarray,
    alive: np.ndarray,
    vertices: np.ndarray,
    particle: np.ndarray,
    corners: np.ndarray,
    real: np.ndarray,
    law: np.ndarray,
    on_particles: np.ndarray,
    on_vertices: np.ndarray,
    of_particles: np.ndarray,
    of_vertices: np.ndarray,
) -> None:
    """Write the forces of contact and the distance of every node to what it may meet.

    Args:
        position: of the particles, in r0.
        alive: which of them feel a force.
        vertices: of the membrane.
        particle: of each pair, ascending.
        corners: the vertices of its triangle, corner by corner.
        real: which pairs are none of the padding.
        law: contact range, stiffness, adhesion, smoothing and sharpness, stiffness and
            range of the barrier, and distance beyond which there is no contact, in
            contact ranges.
        on_particles: forces in F(0); written, as what follows.
        on_vertices: likewise.
        of_particles: distances in r0, infinite where no pair is listed.
        of_vertices: likewise.
    """
    scale, stiffness, adhesion = law[0], law[1], law[2]
    half, barrier, margin, reach = 0.5 * law[4], law[5], law[6], law[7]
    low, blend, edge, tail = branches(law[3], reach)
    on_particles[:], on_vertices[:] = 0.0, 0.0
    of_particles[:], of_vertices[:] = np.inf, np.inf
    pairs = len(particle)
    found, distance = np.zeros((pairs, 7)), np.zeros(pairs)
    start = 0
    while start < pairs:
        i, stop, nearest = particle[start], start, reach
        while stop < pairs and particle[stop] == i:
            if real[stop]:
                a, b, c = corners[0, stop], corners[1, stop], corners[2, stop]
                at = found[stop]
                closest(position[i], vertices[a], vertices[b], vertices[c], at)
                length = math.sqrt(at[3])
                of_particles[i] = min(of_particles[i], length)
                for corner in (a, b, c):
                    of_vertices[corner] = min(of_vertices[corner], length)
                distance[stop] = length / scale
                nearest = min(nearest, distance[stop])
            else:
                distance[stop] = reach
            stop += 1
        if nearest < reach and alive[i]:
            unit = max(nearest, _LEAST)
            far = _power(unit / reach, half)
            total = 0.0
            for pair in range(start, stop):
                if distance[pair] < reach:
                    power = _power(unit / max(distance[pair], _LEAST), half)
                    # kept for the forces: the square of the distance is needed no more
                    found[pair, 3] = power
                    total += (power - far) ** 2
            norm = math.sqrt(total)
            if norm > 0.0:
                u = unit * (norm + far) ** (-1.0 / half)
                push = stiffness * a2(u, adhesion, low, blend, edge, tail)
                if u < margin:
                    inside = u - margin
                    steep = 2.0 * inside * math.log(u / margin) + inside * inside / u
                    push += barrier * steep
                push *= u / (norm + far) / norm
                for pair in range(start, stop):
                    if _LEAST < distance[pair] < reach:
                        power, away = found[pair, 3], distance[pair]
                        size = push * (power - far) * power / (away * away * scale)
                        for axis in range(3):
                            part = size * found[pair, axis]
                            on_particles[i, axis] += part
                            for k in range(3):
                                corner = corners[k, pair]
                                on_vertices[corner, axis] -= part * found[pair, 4 + k]
        start = stop


@cfunc(frames.HANDLER, cache=True)
@no_type_check
def handler(frame: int) -> int:
    """For XLA: arguments and results as of `add_up`."""
    if frames.answers_version(frame):
        return 0
    count, corners = frames.size(frame, 0, 0), frames.size(frame, 2, 0)
    pairs = frames.size(frame, 3, 0)
    add_up(
        frames.reals(frames.argument(frame, 0), (count, 3)),
        frames.booleans(frames.argument(frame, 1), (count,)),
        frames.reals(frames.argument(frame, 2), (corners, 3)),
        frames.indices(frames.argument(frame, 3), (pairs,)),
        frames.long_indices(frames.argument(frame, 4), (3, pairs)),
        frames.booleans(frames.argument(frame, 5), (pairs,)),
        frames.reals(frames.argument(frame, 6), (8,)),
        frames.reals(frames.result(frame, 0), (count, 3)),
        frames.reals(frames.result(frame, 1), (corners, 3)),
        frames.reals(frames.result(frame, 2), (count,)),
        frames.reals(frames.result(frame, 3), (corners,)),
    )
    return 0
