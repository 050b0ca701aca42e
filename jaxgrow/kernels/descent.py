"""XLA handler of the descent by loops (`jaxgrow.kernels.steps`).

Its arguments are the fields of `Scene`, `Bounds` (in one array), addresses and wiring
of the terms' roots, their buffers, the wide `Lists`, the near ones, `Now` and `Memory`,
see `jaxgrow.kernels.layout`. All from the lists on are changed: they are the results
too, which share their memory. (The wide collisions are made by the host, and do not
change.)
"""

from typing import no_type_check

import numpy as np
from numba import cfunc, njit

from jaxgrow.kernels import frames
from jaxgrow.kernels.arguments import Argument, codes_of
from jaxgrow.kernels.layout import (
    Bounds,
    Lists,
    Memory,
    Now,
    Pairs,
    Scene,
    Touching,
)
from jaxgrow.kernels.steps import descend


SCENE, BOUNDS, ADDRESSES, WIRING, BUFFERS = 0, 6, 7, 8, 9
"""Number of the first argument of each kind."""

WIDE, NEAR, NOW, MEMORY, END = 0, 15, 30, 39, 44
"""Number of the first result of each kind, and number of all results."""


_REAL, _WHOLE, _SHORT, _FLAG = np.float64, np.int64, np.int32, np.bool_
ARGUMENTS = (
    *(Argument("alive", _FLAG, 1), Argument("free", _FLAG, 1)),
    *(Argument("faces", _WHOLE, 2), Argument("face_alive", _FLAG, 1)),
    *(Argument("load", _REAL, 2), Argument("still", _REAL, 2)),
    Argument("bounds", _REAL, 1),
    *(Argument("addresses", _WHOLE, 1), Argument("wiring", _WHOLE, 2)),
)
"""Fields of `Scene`, `Bounds`, and the roots; buffers and results follow."""

_OF_LISTS = (
    *(Argument("listed", _SHORT, 2), Argument("listed_at", _REAL, 2)),
    *(Argument("particle", _SHORT, 1), Argument("face", _SHORT, 1)),
    *(Argument("corners", _WHOLE, 2), Argument("real", _FLAG, 1)),
    *(Argument("touching", _REAL, 2), Argument("touched", _REAL, 2)),
    *(Argument("vertex", _WHOLE, 1), Argument("corners_of_pair", _WHOLE, 2)),
    *(Argument("apart", _FLAG, 1), Argument("vertex_margin", _REAL, 1)),
    *(Argument("edges", _WHOLE, 2), Argument("edge_margin", _REAL, 1)),
    Argument("collided", _REAL, 2),
)
RESULTS = (
    *_OF_LISTS,
    *_OF_LISTS,
    *(Argument(f"positions_{k}", _REAL, 2) for k in range(7)),
    *(Argument("residual", _REAL, 1), Argument("counts", _WHOLE, 1)),
    *(Argument("displacement", _REAL, 3), Argument("change", _REAL, 3)),
    *(Argument("inverse", _REAL, 1), Argument("oldest", _WHOLE, 1)),
    Argument("scale", _REAL, 1),
)
"""Fields of the wide `Lists`, of the near ones, of `Now` and of `Memory`."""

_CODES = codes_of(ARGUMENTS, RESULTS, more=True)


@njit(cache=True)
@no_type_check
def _at(frame: int, number: int) -> int:
    """Return the address of an argument, or of the result in its place."""
    changed = frames.count_arguments(frame) - END
    if number < changed:
        return frames.argument(frame, number)
    return frames.result(frame, number - changed)


@njit(cache=True)
@no_type_check
def _points(frame: int, number: int) -> np.ndarray:
    return frames.reals(_at(frame, number), (frames.size(frame, number, 0), 3))


@njit(cache=True)
@no_type_check
def _numbers(frame: int, number: int) -> np.ndarray:
    return frames.reals(_at(frame, number), (frames.size(frame, number, 0),))


@njit(cache=True)
@no_type_check
def _flags(frame: int, number: int) -> np.ndarray:
    return frames.booleans(_at(frame, number), (frames.size(frame, number, 0),))


@njit(cache=True)
@no_type_check
def _whole(frame: int, number: int) -> np.ndarray:
    return frames.long_indices(_at(frame, number), (frames.size(frame, number, 0),))


@njit(cache=True)
@no_type_check
def _table(frame: int, number: int) -> np.ndarray:
    rows, columns = frames.size(frame, number, 0), frames.size(frame, number, 1)
    return frames.long_indices(_at(frame, number), (rows, columns))


@njit(cache=True)
@no_type_check
def _short(frame: int, number: int) -> np.ndarray:
    return frames.indices(_at(frame, number), (frames.size(frame, number, 0),))


@njit(cache=True)
@no_type_check
def _lists(frame: int, first: int) -> Lists:
    rows, columns = frames.size(frame, first, 0), frames.size(frame, first, 1)
    return Lists(
        frames.indices(_at(frame, first), (rows, columns)),
        _points(frame, first + 1),
        Touching(
            _short(frame, first + 2),
            _short(frame, first + 3),
            _table(frame, first + 4),
            _flags(frame, first + 5),
        ),
        _points(frame, first + 6),
        _points(frame, first + 7),
        Pairs(
            _whole(frame, first + 8),
            _table(frame, first + 9),
            _flags(frame, first + 10),
            _numbers(frame, first + 11),
            _table(frame, first + 12),
            _numbers(frame, first + 13),
        ),
        _points(frame, first + 14),
    )


@njit(cache=True)
@no_type_check
def _pairs_of_memory(frame: int, number: int) -> np.ndarray:
    """Read displacements or changes, all coordinates of each in a row."""
    rows, nodes = frames.size(frame, number, 0), frames.size(frame, number, 1)
    return frames.reals(_at(frame, number), (rows, 3 * nodes))


@cfunc(frames.HANDLER, cache=True)
@no_type_check
def handler(frame: int) -> int:
    """Call `descend` from XLA; see the module for arguments and results."""
    if frames.answers_version(frame):
        return 0
    bad = frames.mismatch(frame, _CODES)
    if bad:
        return frames.refuse(frame, bad)
    changed = frames.count_arguments(frame) - END
    frames.keep(frame, changed, END)
    scene = Scene(
        _flags(frame, 0),
        _flags(frame, 1),
        _table(frame, 2),
        _flags(frame, 3),
        _points(frame, 4),
        _points(frame, 5),
    )
    b = _numbers(frame, BOUNDS)
    bounds = Bounds(
        *(b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7], b[8]),
        *(b[9], b[10], b[11], b[12], b[13], b[14], b[15], b[16]),
    )
    at = changed + NOW
    now = Now(
        _points(frame, at),
        _points(frame, at + 1),
        _points(frame, at + 2),
        _points(frame, at + 3),
        _points(frame, at + 4),
        _points(frame, at + 5),
        _points(frame, at + 6),
        _numbers(frame, at + 7),
        _whole(frame, at + 8),
    )
    at = changed + MEMORY
    memory = Memory(
        _pairs_of_memory(frame, at),
        _pairs_of_memory(frame, at + 1),
        _numbers(frame, at + 2),
        _whole(frame, at + 3),
        _numbers(frame, at + 4),
    )
    wide, near = _lists(frame, changed + WIDE), _lists(frame, changed + NEAR)
    roots = _whole(frame, ADDRESSES), _table(frame, WIRING)
    descend(frame, changed, *roots, scene, bounds, wide, near, now, memory)
    return 0
