"""Declarations of arguments and results of XLA handlers: name, type, rank.

The Python caller is checked against them when a program is traced (`checked`). The
handler checks every call against them in compiled code (`codes_of`), because the data
of an array of another type or rank would be misinterpreted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


DATA_TYPES = {
    np.dtype(name): code
    for code, name in enumerate(
        (
            *("bool", "int8", "int16", "int32", "int64"),
            *("uint8", "uint16", "uint32", "uint64"),
            *("float16", "float32", "float64"),
        ),
        start=1,
    )
}
"""XLA's number of each data type that a loop accepts."""


@dataclass(frozen=True)
class Argument:
    """Declaration of an array that is an argument or a result of a handler.

    Attributes:
        name: of the array, in messages and calls.
        dtype: of its entries, in any form that NumPy accepts; stored as a key of
            `DATA_TYPES`.
        rank: number of its axes.

    Raises:
        ValueError: loops do not accept that type, or the rank is not 0 to 255.
    """

    name: str
    dtype: Any
    rank: int

    def __post_init__(self) -> None:
        # so that np.float64 and "float64" are accepted too
        object.__setattr__(self, "dtype", np.dtype(self.dtype))
        if self.dtype not in DATA_TYPES:
            known = ", ".join(str(dtype) for dtype in DATA_TYPES)
            raise ValueError(f"{self.name} is of {self.dtype}; loops know {known}.")
        if not 0 <= self.rank < 256:
            raise ValueError(
                f"{self.name} is of rank {self.rank}; it must be 0 to 255."
            )

    def __str__(self) -> str:
        return f"{self.dtype} of rank {self.rank}"


def codes_of(
    arguments: Sequence[Argument], results: Sequence[Argument], *, more: bool = False
) -> np.ndarray:
    """Convert types and ranks into the constant for `frames.mismatch`.

    Args:
        arguments: of the handler, in their order.
        results: likewise.
        more: whether further arguments may follow, which the caller checks.

    Returns:
        Twice the number of arguments, and 1 if more may follow; the number of results;
        and for each of them, in this order, 256 times XLA's number of its type plus its
        rank.
    """
    both = [256 * DATA_TYPES[one.dtype] + one.rank for one in (*arguments, *results)]
    count = 2 * len(arguments) + more
    return np.array([count, len(results), *both], np.int64)


def checked(
    loop: str,
    arguments: Sequence[Argument],
    values: Mapping[str, Any] | Sequence[Any],
) -> list[Any]:
    """Check values against the declared types and ranks, and sort them.

    Args:
        loop: name of the handler, for the message.
        arguments: that it declares.
        values: arrays by name, or in that order.

    Returns:
        The values in the order of the arguments.

    Raises:
        TypeError: one is missing, unknown, or of another type or rank.
    """
    ordered = _ordered(loop, "argument", arguments, values)
    for declared, value in zip(arguments, ordered, strict=True):
        dtype, rank = value.dtype, len(value.shape)
        if (dtype, rank) != (declared.dtype, declared.rank):
            raise TypeError(
                f"argument {declared.name!r} of the loop {loop!r} is {dtype} of rank "
                f"{rank}; it must be {declared}."
            )
    return ordered


def checked_shapes(
    loop: str,
    results: Sequence[Argument],
    shapes: Mapping[str, Sequence[int]] | Sequence[Sequence[int]],
) -> list[tuple[int, ...]]:
    """Check shapes against the declared ranks, and sort them.

    Args:
        loop: name of the handler, for the message.
        results: that it declares.
        shapes: by name, or in that order.

    Returns:
        The shapes in the order of the results.

    Raises:
        TypeError: one is missing, unknown, or of another rank.
    """
    ordered = _ordered(loop, "result", results, shapes)
    for declared, shape in zip(results, ordered, strict=True):
        if len(shape) != declared.rank:
            raise TypeError(
                f"result {declared.name!r} of the loop {loop!r} has the shape "
                f"{tuple(shape)}; it must be {declared}."
            )
    return [tuple(shape) for shape in ordered]


def _ordered(
    loop: str,
    what: str,
    declared: Sequence[Argument],
    given: Mapping[str, Any] | Sequence[Any],
) -> list[Any]:
    """Sort the given values into the declared order."""
    names = [one.name for one in declared]
    if isinstance(given, Mapping):
        odd = sorted(set(names).symmetric_difference(given))
        if odd:
            problem = "is missing" if odd[0] in names else "is unknown"
            raise TypeError(
                f"{what} {odd[0]!r} of the loop {loop!r} {problem}; it has "
                f"{', '.join(names)}."
            )
        return [given[name] for name in names]
    if len(given) != len(names):
        raise TypeError(
            f"the loop {loop!r} is given {len(given)} {what}s; it has {len(names)}: "
            f"{', '.join(names)}."
        )
    return list(given)
