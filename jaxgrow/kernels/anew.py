"""Lists of a given capacity, built on the host without compiling programs.

Each function returns a list and the number of pairs, listed or not.
"""

from typing import no_type_check

import numpy as np
from numba import njit

from jaxgrow.kernels import cells, near
from jaxgrow.kernels.layout import Pairs, Touching
from jaxgrow.kernels.narrow import find_collisions, find_contacts
from jaxgrow.kernels.touching import list_all


@njit(cache=True)
@no_type_check
def wide_neighbors(
    position: np.ndarray, size: float, radius: float, side: int, room: int
) -> tuple[np.ndarray, int]:
    """List the neighbours of each particle, see `jaxgrow.kernels.cells.find`."""
    count, most = len(position), np.zeros(1, np.int32)
    entries = np.zeros((count, room), np.int32)
    asked = np.ones(count, np.bool_)
    cells.find(position, size, radius, side, asked, entries, most)
    return entries, most[0]


@njit(cache=True)
@no_type_check
def near_neighbors(
    position: np.ndarray, wide: np.ndarray, radius: float, room: int
) -> tuple[np.ndarray, int]:
    """Filter the near neighbours of a wide list.

    See `jaxgrow.kernels.near.find`.
    """
    listed, most = np.zeros((room, len(position)), np.int32), np.zeros(1, np.int32)
    near.find(position, wide, radius * radius, listed, most)
    return listed, most[0]


@njit(cache=True)
@no_type_check
def _touching(room: int) -> Touching:
    return Touching(
        np.zeros(room, np.int32),
        np.zeros(room, np.int32),
        np.zeros((3, room), np.int64),
        np.zeros(room, np.uint8),
    )


@njit(cache=True)
@no_type_check
def contacts(
    position: np.ndarray,
    alive: np.ndarray,
    vertices: np.ndarray,
    faces: np.ndarray,
    face_alive: np.ndarray,
    radius: float,
    room: int,
) -> tuple[Touching, int]:
    """List all contact pairs closer than a radius.

    See `jaxgrow.kernels.touching.list_all`.
    """
    listed = _touching(room)
    given = position, alive, vertices, faces, face_alive
    return listed, list_all(*given, radius, listed)


@njit(cache=True)
@no_type_check
def near_contacts(
    wide: Touching,
    position: np.ndarray,
    vertices: np.ndarray,
    radius: float,
    room: int,
) -> tuple[Touching, int]:
    """Filter the near contacts of a list.

    See `jaxgrow.kernels.narrow.find_contacts`.
    """
    near = _touching(room)
    return near, find_contacts(wide, position, vertices, radius, near)


@njit(cache=True)
@no_type_check
def near_collisions(
    wide: Pairs,
    points: np.ndarray,
    scale: float,
    least: float,
    skin: float,
    room: int,
) -> tuple[Pairs, int]:
    """Filter the near collision pairs of a list.

    See `jaxgrow.kernels.narrow.find_collisions`. The capacity for pairs of edges is
    twice `room`; each counts as half a pair.
    """
    near = Pairs(
        np.zeros(room, np.int64),
        np.zeros((room, 3), np.int64),
        np.zeros(room, np.uint8),
        np.zeros(room),
        np.zeros((2 * room, 4), np.int64),
        np.zeros(2 * room),
    )
    return near, find_collisions(wide, points, scale, least, skin, near)
