"""Argument tables of roots (`jaxgrow.kernels.roots`), and their calls."""

from typing import Any, no_type_check

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from jaxgrow.kernels import frames


WORDS = 6
"""Number of words of a table after its buffers: numbers of nodes and of particles, and
addresses of nodes, displacement, result and distances."""


@intrinsic
@no_type_check
def call(_context: Any, _function_at: Any, _argument: Any) -> Any:
    """Call a compiled function of an integer by its address."""
    signature = types.void(types.intp, types.intp)

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64)])
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        builder.call(function, [arguments[1]])
        return context.get_dummy_value()

    return signature, generate


@njit(cache=True)
@no_type_check
def make_tables(
    frame: int,
    wiring: np.ndarray,
    changed: int,
    count: int,
    nodes: np.ndarray,
    along: np.ndarray,
    out: np.ndarray,
    clear: np.ndarray,
) -> np.ndarray:
    """Build the argument table of each root.

    Args:
        frame: address of XLA's call.
        wiring: numbers of the arguments that are the buffers of each root; -1: none.
        changed: number of the first argument that became a result.
        count: number of particles.
        nodes: particles, then vertices, then static vertices, in r0.
        along: a displacement of them.
        out: array to which roots add.
        clear: distances that they lower.
    """
    roots, most = wiring.shape
    tables = np.zeros((roots, 3 * most + WORDS), np.int64)
    for root in range(roots):
        words = 0
        for place in range(most):
            number = wiring[root, place]
            if number < 0:
                break
            if number < changed:
                tables[root, words] = frames.argument(frame, number)
            else:
                tables[root, words] = frames.result(frame, number - changed)
            for axis in range(min(frames.rank(frame, number), 2)):
                tables[root, words + 1 + axis] = frames.size(frame, number, axis)
            words += 3
        tables[root, words] = len(nodes)
        tables[root, words + 1] = count
        tables[root, words + 2] = nodes.ctypes.data
        tables[root, words + 3] = along.ctypes.data
        tables[root, words + 4] = out.ctypes.data
        tables[root, words + 5] = clear.ctypes.data
    return tables


@njit(cache=True)
@no_type_check
def run(addresses: np.ndarray, tables: np.ndarray) -> None:
    """Call each root with its table."""
    for root in range(len(addresses)):
        call(addresses[root], tables[root].ctypes.data)
