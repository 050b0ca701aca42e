"""Reading a call frame of XLA in compiled loops; see `jaxgrow.kernels.ffi`."""

from typing import Any, no_type_check

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from numba.np.numpy_support import carray


_EXTENSION, _API = 1, 2
_ARGUMENTS, _RESULTS = 9, 14
"""Entries of a frame: pointers to those of the buffers."""

_TYPE, _DATA, _RANK, _DIMENSIONS = 2, 3, 4, 5
"""Entries of a buffer."""

_WIDTH = np.array([0, 1, 1, 2, 4, 8, 1, 2, 4, 8, 2, 4, 8], np.int64)
"""Bytes of a number of each type: none, booleans, whole numbers with and without sign
of 8 to 64 bits, and real ones of 16 to 64."""

_MAJOR = 0
"""Of the version whose layout this is."""


@intrinsic
@no_type_check
def _as_pointer(_context: Any, _address: Any) -> Any:
    signature = types.voidptr(types.intp)

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return signature, generate


@njit(cache=True)
@no_type_check
def _words(address: int, count: int) -> np.ndarray:
    return carray(_as_pointer(address), count, np.int64)


@njit(cache=True)
@no_type_check
def answers_version(frame_at: int) -> bool:
    """Whether the call only asks for the version, which is answered then."""
    frame = _words(frame_at, 5)
    if frame[_EXTENSION] == 0:
        return False
    extension = _words(frame[_EXTENSION], 4)
    if np.int32(extension[1]) != 1:
        return False
    version = _words(frame[_API], 5)[4]  # minor above, major below
    if np.int32(version) == _MAJOR:
        _words(extension[3], 4)[3] = version
    return True


@njit(cache=True)
@no_type_check
def argument(frame_at: int, number: int) -> int:
    """Address of an argument's data."""
    buffers = _words(_words(frame_at, 15)[_ARGUMENTS], number + 1)
    return _words(buffers[number], 6)[_DATA]


@njit(cache=True)
@no_type_check
def size(frame_at: int, number: int, axis: int) -> int:
    """Length of an argument along an axis."""
    buffers = _words(_words(frame_at, 15)[_ARGUMENTS], number + 1)
    return _words(_words(buffers[number], 6)[_DIMENSIONS], axis + 1)[axis]


@njit(cache=True)
@no_type_check
def rank(frame_at: int, number: int) -> int:
    """Number of axes of an argument."""
    buffers = _words(_words(frame_at, 15)[_ARGUMENTS], number + 1)
    return _words(buffers[number], 6)[_RANK]


@njit(cache=True)
@no_type_check
def count_arguments(frame_at: int) -> int:
    """Number of arguments."""
    return _words(frame_at, 15)[_ARGUMENTS - 2]


@njit(cache=True)
@no_type_check
def count_results(frame_at: int) -> int:
    """Number of results."""
    return _words(frame_at, 15)[_RESULTS - 2]


@njit(cache=True)
@no_type_check
def _bytes(frame_at: int, number: int) -> int:
    """What an argument takes."""
    buffers = _words(_words(frame_at, 15)[_ARGUMENTS], number + 1)
    buffer = _words(buffers[number], 6)
    extent = _WIDTH[np.int32(buffer[_TYPE])]
    rank = buffer[_RANK]
    dimensions = _words(buffer[_DIMENSIONS], rank)
    for axis in range(rank):
        extent *= dimensions[axis]
    return extent


@njit(cache=True)
@no_type_check
def size_of_result(frame_at: int, number: int, axis: int) -> int:
    """Length of a result along an axis."""
    buffers = _words(_words(frame_at, 15)[_RESULTS], number + 1)
    return _words(_words(buffers[number], 6)[_DIMENSIONS], axis + 1)[axis]


@njit(cache=True)
@no_type_check
def result(frame_at: int, number: int) -> int:
    """Address of a result's data."""
    buffers = _words(_words(frame_at, 15)[_RESULTS], number + 1)
    return _words(buffers[number], 6)[_DATA]


@njit(cache=True)
@no_type_check
def reals(address: int, shape: tuple[int, ...]) -> np.ndarray:
    """What lies there, as numbers of 64 bits."""
    return carray(_as_pointer(address), shape, np.float64)


@njit(cache=True)
@no_type_check
def indices(address: int, shape: tuple[int, ...]) -> np.ndarray:
    """What lies there, as whole numbers of 32 bits."""
    return carray(_as_pointer(address), shape, np.int32)


@njit(cache=True)
@no_type_check
def long_indices(address: int, shape: tuple[int, ...]) -> np.ndarray:
    """What lies there, as whole numbers of 64 bits."""
    return carray(_as_pointer(address), shape, np.int64)


@njit(cache=True)
@no_type_check
def booleans(address: int, shape: tuple[int, ...]) -> np.ndarray:
    """What lies there, as 0 and 1 of a byte each."""
    return carray(_as_pointer(address), shape, np.uint8)


HANDLER = types.intp(types.intp)
"""Signature: given the address of a frame; returns that of an error, 0 for none."""


@njit(cache=True)
@no_type_check
def keep(frame_at: int, number: int, count: int) -> None:
    """Begin the results with these arguments, as they are; results share their memory.

    Args:
        frame_at: of the call.
        number: of the argument that the first result begins as; others follow.
        count: of results that do.
    """
    for k in range(count):
        before, after = argument(frame_at, number + k), result(frame_at, k)
        if before != after:
            extent = _bytes(frame_at, number + k)
            booleans(after, (extent,))[:] = booleans(before, (extent,))
