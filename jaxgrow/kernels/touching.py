"""Contact pairs of particles and triangles, found by a cell list.

The loop of `jaxgrow.energy.contact.list_contacts`.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from jaxgrow.kernels.closest import LENGTH, measure
from jaxgrow.kernels.layout import Touching
from jaxgrow.kernels.regrouped import regrouped


_MOST_CELLS = 64
"""Largest number of cells along an axis; cells are enlarged if there would be more."""


@regrouped
@no_type_check
def _spheres(
    vertices: np.ndarray, faces: np.ndarray, alive: np.ndarray, radius: float
) -> np.ndarray:
    """Compute a sphere for each triangle, with all points near the triangle.

    It holds the points within `radius` of the triangle.
    Each row is its centre and its radius; 0 for dead triangles.
    """
    found = np.zeros((len(faces), 4))
    for face in range(len(faces)):
        if not alive[face]:
            continue
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        for axis in range(3):
            total = vertices[a, axis] + vertices[b, axis] + vertices[c, axis]
            found[face, axis] = total / 3.0
        size = 0.0
        for corner in (a, b, c):
            square = 0.0
            for axis in range(3):
                square += (vertices[corner, axis] - found[face, axis]) ** 2
            size = max(size, square)
        # so that rounding omits no pair
        whole = (radius + math.sqrt(size)) * (1.0 + 1e-12)
        found[face, 3] = whole if whole < np.inf else 0.0
    return found


@njit(cache=True)
@no_type_check
def _cell(place: float, low: float, size: float, side: int) -> int:
    return min(max(int((place - low) / size), 0), side - 1)


@njit(cache=True)
@no_type_check
def _in_spheres(
    position: np.ndarray, alive: np.ndarray, spheres: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """List the pairs of a particle and a sphere around it.

    They are sorted by particle, then by sphere.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for face in range(len(spheres)):
        for axis in range(3):
            if spheres[face, 3] > 0.0:
                at, size = spheres[face, axis], spheres[face, 3]
                low[axis], high[axis] = (
                    min(low[axis], at - size),
                    max(high[axis], at + size),
                )
    none = np.zeros(0, np.int64)
    if not low[0] < np.inf:
        return none, none
    size = max(0.5 * radius, (high - low).max() / _MOST_CELLS)
    side = np.zeros(3, np.int64)
    for axis in range(3):
        side[axis] = min(int((high[axis] - low[axis]) / size) + 1, _MOST_CELLS)
    # particles in the order of their cells
    count = len(position)
    number = np.full(count, -1)
    first = np.zeros(side[0] * side[1] * side[2] + 1, np.int64)
    for i in range(count):
        within = alive[i] != 0
        for axis in range(3):
            within &= low[axis] <= position[i, axis] <= high[axis]
        if within:
            cell = 0
            for axis in range(3):
                at = _cell(position[i, axis], low[axis], size, side[axis])
                cell = cell * side[axis] + at
            number[i] = cell
            first[cell + 1] += 1
    for cell in range(len(first) - 1):
        first[cell + 1] += first[cell]
    order, free = np.zeros(first[-1], np.int64), first[:-1].copy()
    for i in range(count):
        if number[i] >= 0:
            order[free[number[i]]] = i
            free[number[i]] += 1
    # by sphere first, without a branch, which would be mispredicted for each second
    found, room = 0, 4 * len(order) + 64
    owner, face_of = np.zeros(room, np.int64), np.zeros(room, np.int64)
    for face in range(len(spheres)):
        if spheres[face, 3] == 0.0:
            continue
        x, y, z = spheres[face, 0], spheres[face, 1], spheres[face, 2]
        far = spheres[face, 3]
        for a in range(
            _cell(x - far, low[0], size, side[0]),
            _cell(x + far, low[0], size, side[0]) + 1,
        ):
            for b in range(
                _cell(y - far, low[1], size, side[1]),
                _cell(y + far, low[1], size, side[1]) + 1,
            ):
                row = (a * side[1] + b) * side[2]
                start = first[row + _cell(z - far, low[2], size, side[2])]
                stop = first[row + _cell(z + far, low[2], size, side[2]) + 1]
                if found + stop - start >= len(owner):
                    more = np.zeros(len(owner) + stop - start, np.int64)
                    owner, face_of = np.append(owner, more), np.append(face_of, more)
                for place in range(start, stop):
                    i = order[place]
                    dx, dy = position[i, 0] - x, position[i, 1] - y
                    dz = position[i, 2] - z
                    owner[found], face_of[found] = i, face
                    found += dx * dx + dy * dy + dz * dz < far * far
    return _by_owner(owner[:found], face_of[:found], count)


@njit(cache=True)
@no_type_check
def _by_owner(
    owner: np.ndarray, face_of: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sort pairs by their owner; the sort is stable."""
    begin = np.zeros(count + 1, np.int64)
    for i in owner:
        begin[i + 1] += 1
    for i in range(count):
        begin[i + 1] += begin[i]
    owner_after, face_after = np.zeros_like(owner), np.zeros_like(face_of)
    for pair in range(len(owner)):
        place = begin[owner[pair]]
        owner_after[place], face_after[place] = owner[pair], face_of[pair]
        begin[owner[pair]] += 1
    return owner_after, face_after


@njit(cache=True)
@no_type_check
def list_all(
    position: np.ndarray,
    alive: np.ndarray,
    vertices: np.ndarray,
    faces: np.ndarray,
    face_alive: np.ndarray,
    radius: float,
    listed: Touching,
) -> int:
    """List all pairs closer than a radius, by particle, then by triangle.

    Spheres around the triangles select candidates, which are filtered by exact
    distances.

    Args:
        position: of the particles, in r0.
        alive: mask of the particles that are not padding.
        vertices: of the membrane.
        faces: its triangles.
        face_alive: mask of the triangles that are not padding.
        radius: in r0.
        listed: the list; written, with padding at the end.

    Returns:
        Number of pairs, listed or not.
    """
    spheres = _spheres(vertices, faces, face_alive, radius)
    owner, face_of = _in_spheres(position, alive, spheres, radius)
    corners = np.zeros((3, len(owner)), np.int64)
    for pair in range(len(owner)):
        for corner in range(3):
            corners[corner, pair] = faces[face_of[pair], corner]
    found = np.zeros((6, len(owner)))
    measure(position, owner, vertices, corners, found)
    room, count = len(listed.real), 0
    for pair in range(len(owner)):
        if found[LENGTH, pair] < radius:
            if count < room:
                listed.particle[count], listed.face[count] = owner[pair], face_of[pair]
                for corner in range(3):
                    listed.corners[corner, count] = corners[corner, pair]
                listed.real[count] = True
            count += 1
    pad(listed, count, len(position))
    return count


@njit(cache=True)
@no_type_check
def pad(listed: Touching, count: int, particles: int) -> None:
    """Write the padding after the first `count` pairs."""
    for pair in range(count, len(listed.real)):
        listed.particle[pair], listed.face[pair] = particles - 1, 0
        listed.corners[:, pair], listed.real[pair] = 0, False
