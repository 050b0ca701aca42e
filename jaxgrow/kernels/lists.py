"""Rebuild of Verlet lists that are no longer valid, within a descent.

As `jaxgrow.equilibrium.problem.Problem.rebuilt`: near lists are filtered from wide
ones, wide ones are built by cell lists, and a few particles with long moves are
relisted one by one.
"""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from jaxgrow.kernels import cells, near
from jaxgrow.kernels.layout import (
    Bounds,
    FOUND,
    FULL_CANDIDATES,
    FULL_COLLISIONS,
    FULL_CONTACTS,
    FULL_NEIGHBOURS,
    FULL_WIDE,
    Lists,
    OLD_COLLISIONS,
    Scene,
)
from jaxgrow.kernels.links import relink
from jaxgrow.kernels.narrow import find_collisions, find_contacts
from jaxgrow.kernels.touching import list_all


@njit(cache=True)
@no_type_check
def _farthest(
    place: np.ndarray, before: np.ndarray, use: np.ndarray
) -> tuple[float, float]:
    """Find the two longest moves; infinite if a position is not finite."""
    first, second = 0.0, 0.0
    everyone = len(use) == 0
    for i in range(len(before)):
        if not (everyone or use[i]):
            continue
        square = 0.0
        for axis in range(3):
            square += (place[i, axis] - before[i, axis]) ** 2
        if not square < np.inf:
            return np.inf, np.inf
        if square > first:
            first, second = square, first
        elif square > second:
            second = square
    return math.sqrt(first), math.sqrt(second)


@njit(cache=True)
@no_type_check
def _strays(
    place: np.ndarray, before: np.ndarray, use: np.ndarray, far: float
) -> np.ndarray:
    """Find the particles whose moves are longer than `far`."""
    found, count = np.zeros(len(before), np.int64), 0
    for i in range(len(before)):
        square = 0.0
        for axis in range(3):
            square += (place[i, axis] - before[i, axis]) ** 2
        if use[i] and not square <= far * far:
            found[count] = i
            count += 1
    return found[:count]


@njit(cache=True)
@no_type_check
def _keep(place: np.ndarray, use: np.ndarray, reference: np.ndarray) -> None:
    """Store the positions of the nodes in use as the reference."""
    for i in range(len(reference)):
        if len(use) == 0 or use[i]:
            reference[i] = place[i]


@njit(cache=True)
@no_type_check
def relist(
    scene: Scene,
    bounds: Bounds,
    wide: Lists,
    listed: Lists,
    place: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Rebuild the lists that are not valid, and mark overflows.

    It also marks whether the host must rebuild its list of collisions.

    Args:
        scene: the constant arrays.
        bounds: skins and radii.
        wide: wide lists; written.
        listed: near ones; written.
        place: positions of particles, vertices and static vertices, in r0.
        counts: see `jaxgrow.kernels.layout.Now`; written.
    """
    count = len(scene.alive)
    particles, points = place[:count], place[count:]
    if listed.listed.shape[0] > 0:
        _relist_neighbours(scene.alive, bounds, wide, listed, particles, counts)
    if len(listed.contacts.real) > 0:
        _relist_contacts(scene, bounds, wide, listed, particles, points, counts)
    if len(listed.collisions.vertex) > 0:
        _relist_collisions(bounds, wide, listed, points, counts)


@njit(cache=True)
@no_type_check
def _relist_neighbours(
    alive: np.ndarray,
    bounds: Bounds,
    wide: Lists,
    listed: Lists,
    particles: np.ndarray,
    counts: np.ndarray,
) -> None:
    first, second = _farthest(particles, listed.listed_at, alive)
    if first + second <= bounds.skin:
        return
    counts[FOUND] += 1
    first, second = _farthest(particles, wide.listed_at, alive)
    holds = first + second <= bounds.wide_radius - bounds.radius
    strays = _strays(particles, listed.listed_at, alive, 0.25 * bounds.skin)
    if len(strays) <= bounds.strays and not (holds and bounds.few):
        for one in strays:
            listed.listed_at[one] = wide.listed_at[one] = particles[one]
        for one in strays:
            fits = relink(listed.listed, one, listed.listed_at, bounds.radius)
            counts[FULL_NEIGHBOURS] |= not fits
            fits = relink(wide.listed.T, one, wide.listed_at, bounds.wide_radius)
            counts[FULL_WIDE] |= not fits
        return
    most = np.zeros(1, np.int32)
    if not holds:
        size, side = bounds.cell, int(bounds.cells)
        radius = bounds.wide_radius
        cells.find(particles, size, radius, side, alive, wide.listed, most)
        _keep(particles, alive, wide.listed_at)
        counts[FULL_WIDE] |= most[0] > wide.listed.shape[1]
    near.find(particles, wide.listed, bounds.radius**2, listed.listed, most)
    _keep(particles, alive, listed.listed_at)
    counts[FULL_NEIGHBOURS] |= most[0] > listed.listed.shape[0]


@njit(cache=True)
@no_type_check
def _relist_contacts(
    scene: Scene,
    bounds: Bounds,
    wide: Lists,
    listed: Lists,
    particles: np.ndarray,
    points: np.ndarray,
    counts: np.ndarray,
) -> None:
    alive, everyone = scene.alive, scene.alive[:0]
    moved = _farthest(particles, listed.touching, alive)[0]
    moved += _farthest(points, listed.touched, everyone)[0]
    if moved <= bounds.contact_skin:
        return
    counts[FOUND] += 1
    moved = _farthest(particles, wide.touching, alive)[0]
    moved += _farthest(points, wide.touched, everyone)[0]
    if not moved <= bounds.candidate_radius - bounds.contact_radius:
        vertices = points[: len(wide.touched)]
        found = list_all(
            particles,
            alive,
            vertices,
            scene.faces,
            scene.face_alive,
            bounds.candidate_radius,
            wide.contacts,
        )
        _keep(particles, alive, wide.touching)
        _keep(points, everyone, wide.touched)
        counts[FULL_CANDIDATES] |= found > len(wide.contacts.real)
    radius, room = bounds.contact_radius, listed.contacts
    found = find_contacts(wide.contacts, particles, points, radius, room)
    _keep(particles, alive, listed.touching)
    _keep(points, everyone, listed.touched)
    counts[FULL_CONTACTS] |= found > len(room.real)


@njit(cache=True)
@no_type_check
def _relist_collisions(
    bounds: Bounds,
    wide: Lists,
    listed: Lists,
    points: np.ndarray,
    counts: np.ndarray,
) -> None:
    everyone = np.zeros(0, np.uint8)
    first, second = _farthest(points, wide.collided, everyone)
    if not first + second <= bounds.encounter_skin:
        counts[OLD_COLLISIONS] = 1
        return
    first, second = _farthest(points, listed.collided, everyone)
    if first + second <= bounds.collision_skin:
        return
    counts[FOUND] += 1
    scale, least, skin = bounds.collision_range, bounds.least, bounds.collision_skin
    room = listed.collisions
    found = find_collisions(wide.collisions, points, scale, least, skin, room)
    _keep(points, everyone, listed.collided)
    counts[FULL_COLLISIONS] |= found > len(room.vertex)
