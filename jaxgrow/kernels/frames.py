"""Access to XLA's call frames in compiled loops, and their validation.

The layout of a frame, and of the structures that it points to, is that of
``xla/ffi/api/c_api.h`` of version 0.x (64 bits); a test compares the offsets here with
that file::

    frame     size, extension, api, context, stage, arguments, results, ...
    arguments size, extension, count, types, pointers to buffers (results likewise)
    buffer    size, extension, type, data, rank, pointer to its dimensions
    extension size, type, next, pointer to metadata (of a query of the version)
    metadata  size, version (size, extension, major and minor), ...
    api       size, extension, version (likewise), internal, make an error, ...
    error     size, extension, message, code (input of its constructor)

each entry a word of 64 bits. A handler begins as follows, with `CODES` made by
`jaxgrow.kernels.arguments.codes_of`::

    if frames.answers_version(frame):
        return 0
    bad = frames.mismatch(frame, CODES)
    if bad:
        return frames.refuse(frame, bad)
"""

from typing import Any, no_type_check

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from numba.np.numpy_support import carray

from jaxgrow.kernels.arguments import DATA_TYPES


EXTENSION, API = 1, 2
ARGUMENT_COUNT, ARGUMENTS = 7, 9
RESULT_COUNT, RESULTS = 12, 14
"""Words of a frame: pointers, and the numbers of buffers with pointers to those."""

TYPE, DATA, RANK, DIMENSIONS = 2, 3, 4, 5
"""Words of a buffer."""

EXTENSION_TYPE, METADATA = 1, 3
"""Words of an extension."""

VERSION_OF_METADATA, VERSION_OF_API, MAKE_ERROR = 3, 4, 6
"""Words of metadata and of the api: versions (minor in the high half, major in the low
half), and the constructor of errors."""

MESSAGE, ERROR_CODE, ERROR_SIZE = 2, 3, 28
"""Words of the input of that constructor, and its size in bytes."""

QUERY_OF_VERSION, MAJOR = 1, 0
"""Type of the extension that queries the version, and the major version of this
layout."""

INVALID_ARGUMENT, INTERNAL = 3, 13
"""Codes of errors."""

_WIDTH = np.array([0, *(dtype.itemsize for dtype in DATA_TYPES)], np.int64)
"""Bytes of an entry of each type; 0 for none."""


def text(sentence: str) -> np.ndarray:
    """Convert a sentence into the constant that `fail` takes.

    Raises:
        UnicodeEncodeError: it is not in ASCII.
    """
    return np.frombuffer(sentence.encode("ascii"), np.uint8).copy()


# numba mistakes an attribute `_name` of a module for its name: there must be none
_TYPE_NAMES = np.array(
    [text(f"{dtype!s:16}") for dtype in (np.dtype(np.void), *DATA_TYPES)]
)
"""Names of types, padded with blanks."""

_ARGUMENT, _RESULT, _IS = text("argument "), text("result "), text(" is ")
_UNKNOWN, _OF_RANK, _WANTED = text("type "), text(" of rank "), text("; it must be ")
_COUNTS = text(
    "the call has not as many arguments and results as the loop; was it traced by "
    "another version of jaxgrow?"
)
_END = text(" (counted from 0).")


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
    """Return whether the call only queries the version, and answer it then."""
    frame = _words(frame_at, 5)
    if frame[EXTENSION] == 0:
        return False
    extension = _words(frame[EXTENSION], 4)
    if np.int32(extension[EXTENSION_TYPE]) != QUERY_OF_VERSION:
        return False
    version = _words(frame[API], VERSION_OF_API + 1)[VERSION_OF_API]
    if np.int32(version) == MAJOR:
        metadata = _words(extension[METADATA], VERSION_OF_METADATA + 1)
        metadata[VERSION_OF_METADATA] = version
    return True


@njit(cache=True)
@no_type_check
def argument(frame_at: int, number: int) -> int:
    """Return the address of an argument's data."""
    buffers = _words(_words(frame_at, 15)[ARGUMENTS], number + 1)
    return _words(buffers[number], 6)[DATA]


@njit(cache=True)
@no_type_check
def size(frame_at: int, number: int, axis: int) -> int:
    """Return the length of an argument along an axis."""
    buffers = _words(_words(frame_at, 15)[ARGUMENTS], number + 1)
    return _words(_words(buffers[number], 6)[DIMENSIONS], axis + 1)[axis]


@njit(cache=True)
@no_type_check
def rank(frame_at: int, number: int) -> int:
    """Return the number of axes of an argument."""
    buffers = _words(_words(frame_at, ARGUMENTS + 1)[ARGUMENTS], number + 1)
    return _words(buffers[number], RANK + 1)[RANK]


@njit(cache=True)
@no_type_check
def count_arguments(frame_at: int) -> int:
    """Return the number of arguments."""
    return _words(frame_at, ARGUMENT_COUNT + 1)[ARGUMENT_COUNT]


@njit(cache=True)
@no_type_check
def _bytes(frame_at: int, number: int) -> int:
    """Compute the size of an argument in bytes."""
    buffers = _words(_words(frame_at, 15)[ARGUMENTS], number + 1)
    buffer = _words(buffers[number], 6)
    extent = _WIDTH[np.int32(buffer[TYPE])]
    rank = buffer[RANK]
    dimensions = _words(buffer[DIMENSIONS], rank)
    for axis in range(rank):
        extent *= dimensions[axis]
    return extent


@njit(cache=True)
@no_type_check
def size_of_result(frame_at: int, number: int, axis: int) -> int:
    """Return the length of a result along an axis."""
    buffers = _words(_words(frame_at, 15)[RESULTS], number + 1)
    return _words(_words(buffers[number], 6)[DIMENSIONS], axis + 1)[axis]


@njit(cache=True)
@no_type_check
def result(frame_at: int, number: int) -> int:
    """Return the address of a result's data."""
    buffers = _words(_words(frame_at, 15)[RESULTS], number + 1)
    return _words(buffers[number], 6)[DATA]


@njit(cache=True)
@no_type_check
def reals(address: int, shape: tuple[int, ...]) -> np.ndarray:
    """Wrap the memory at an address as an array of 64-bit floats."""
    return carray(_as_pointer(address), shape, np.float64)


@njit(cache=True)
@no_type_check
def indices(address: int, shape: tuple[int, ...]) -> np.ndarray:
    """Wrap the memory at an address as an array of 32-bit integers."""
    return carray(_as_pointer(address), shape, np.int32)


@njit(cache=True)
@no_type_check
def long_indices(address: int, shape: tuple[int, ...]) -> np.ndarray:
    """Wrap the memory at an address as an array of 64-bit integers."""
    return carray(_as_pointer(address), shape, np.int64)


@njit(cache=True)
@no_type_check
def booleans(address: int, shape: tuple[int, ...]) -> np.ndarray:
    """Wrap the memory at an address as an array of bytes 0 and 1."""
    return carray(_as_pointer(address), shape, np.uint8)


@njit(cache=True)
@no_type_check
def mismatch(frame_at: int, codes: np.ndarray) -> int:
    """Compare a call with the declarations of its handler.

    This takes about 20 ns, and 1 ns per buffer.

    Args:
        frame_at: address of the call.
        codes: of `jaxgrow.kernels.arguments.codes_of`.

    Returns:
        0 if the numbers of arguments and results, and the type and rank of each, are
        those declared; otherwise the input of `refuse`.
    """
    frame = _words(frame_at, RESULTS + 1)
    arguments, results, given = codes[0] >> 1, codes[1], frame[ARGUMENT_COUNT]
    more = given - arguments
    if more < 0 or (more > 0 and not codes[0] & 1) or frame[RESULT_COUNT] != results:
        return -1
    for k in range(arguments + results):
        place = k if k < arguments else k + more
        buffer = _buffer(frame, place, given)
        if 256 * np.int64(np.int32(buffer[TYPE])) + buffer[RANK] != codes[2 + k]:
            return (place + 1) << 32 | codes[2 + k]
    return 0


@njit(cache=True)
@no_type_check
def _buffer(frame: np.ndarray, number: int, arguments: int) -> np.ndarray:
    """Return a buffer by its number; results follow the arguments."""
    if number < arguments:
        return _words(_words(frame[ARGUMENTS], number + 1)[number], DIMENSIONS + 1)
    number -= arguments
    return _words(_words(frame[RESULTS], number + 1)[number], DIMENSIONS + 1)


@njit(cache=True)
@no_type_check
def refuse(frame_at: int, bad: int) -> int:
    """Make the error of a call that does not match its handler's declarations.

    Args:
        frame_at: address of the call.
        bad: the result of `mismatch`.

    Returns:
        The error's address, for the handler to return; in Python it is an exception
        whose message names the argument, what it is and what it must be.
    """
    if bad < 0:
        return _fail(frame_at, INVALID_ARGUMENT, _COUNTS, len(_COUNTS))
    frame = _words(frame_at, RESULTS + 1)
    number, arguments = (bad >> 32) - 1, frame[ARGUMENT_COUNT]
    buffer = _buffer(frame, number, arguments)
    line = np.zeros(200, np.uint8)
    if number < arguments:
        end = _put_number(line, _put(line, 0, _ARGUMENT), number)
    else:
        end = _put_number(line, _put(line, 0, _RESULT), number - arguments)
    end = _put(line, end, _IS)
    end = _put_kind(line, end, np.int64(np.int32(buffer[TYPE])), buffer[RANK])
    end = _put(line, end, _WANTED)
    wanted = bad & 0xFFFFFFFF
    end = _put_kind(line, end, wanted // 256, wanted % 256)
    return _fail(frame_at, INVALID_ARGUMENT, line, _put(line, end, _END))


@njit(cache=True)
@no_type_check
def _put(line: np.ndarray, end: int, words: np.ndarray) -> int:
    # a slice on the left takes numba seconds to compile
    for k in range(len(words)):
        line[end + k] = words[k]
    return end + len(words)


@njit(cache=True)
@no_type_check
def _put_number(line: np.ndarray, end: int, number: int) -> int:
    scale = 1
    while number // scale > 9:
        scale *= 10
    while scale > 0:
        line[end] = 48 + number // scale % 10
        end, scale = end + 1, scale // 10
    return end


@njit(cache=True)
@no_type_check
def _put_kind(line: np.ndarray, end: int, kind: int, rank: int) -> int:
    if 0 < kind < len(_TYPE_NAMES):
        for k in range(_TYPE_NAMES.shape[1]):
            if _TYPE_NAMES[kind, k] != 32:
                line[end] = _TYPE_NAMES[kind, k]
                end += 1
    else:
        end = _put_number(line, _put(line, end, _UNKNOWN), kind)
    return _put_number(line, _put(line, end, _OF_RANK), rank)


@njit(cache=True)
@no_type_check
def fail(frame_at: int, code: int, sentence: np.ndarray) -> int:
    """Make an error of XLA.

    Args:
        frame_at: address of the call.
        code: `INVALID_ARGUMENT` or `INTERNAL`.
        sentence: the message, of `text`.

    Returns:
        The error's address, for the handler to return; XLA destroys it.
    """
    return _fail(frame_at, code, sentence, len(sentence))


@njit(cache=True)
@no_type_check
def _fail(frame_at: int, code: int, sentence: np.ndarray, length: int) -> int:
    """Make an error of XLA from the first `length` characters of a sentence."""
    message = np.zeros(length + 1, np.uint8)  # XLA reads up to the zero
    for k in range(length):
        message[k] = sentence[k]
    given = np.zeros(ERROR_CODE + 1, np.int64)
    given[0], given[ERROR_CODE] = ERROR_SIZE, code
    api = _words(_words(frame_at, API + 1)[API], MAKE_ERROR + 1)
    return _make_error(api[MAKE_ERROR], given, message)


@intrinsic
@no_type_check
def _make_error(_context: Any, _function: Any, given: Any, message: Any) -> Any:
    """Call XLA's constructor of errors; both arrays live until it returns."""
    signature = types.intp(types.intp, given, message)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word = ir.IntType(64)
        function, *arrays = arguments
        at_given, at_message = (
            builder.ptrtoint(
                context.make_array(kind)(context, builder, array).data, word
            )
            for kind, array in zip(signature.args[1:], arrays, strict=True)
        )
        place = builder.add(at_given, ir.Constant(word, 8 * MESSAGE))
        builder.store(at_message, builder.inttoptr(place, word.as_pointer()))
        kind = ir.FunctionType(word, [word]).as_pointer()
        return builder.call(builder.inttoptr(function, kind), [at_given])

    return signature, generate


HANDLER = types.intp(types.intp)
"""Signature: given the address of a frame; returns that of an error, 0 for none."""


@njit(cache=True)
@no_type_check
def keep(frame_at: int, number: int, count: int) -> None:
    """Copy arguments to the first results, except where they share memory.

    Args:
        frame_at: address of the call.
        number: of the argument for the first result; others follow.
        count: number of these results.
    """
    for k in range(count):
        before, after = argument(frame_at, number + k), result(frame_at, k)
        if before != after:
            extent = _bytes(frame_at, number + k)
            booleans(after, (extent,))[:] = booleans(before, (extent,))
