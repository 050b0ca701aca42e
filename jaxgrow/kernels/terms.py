"""XLA handler that evaluates the roots of an energy's terms once.

Arguments: addresses of the roots, wiring (see `jaxgrow.kernels.tables`), mask of
particles alive, nodes, a displacement (without rows for forces and blocks), and the
buffers. Results: the sum of the roots' results, in 3 columns or, for blocks, in 9; and
the clearance of each node, its distance to the nearest element that it must not cross.
"""

from typing import no_type_check

import numpy as np
from numba import cfunc

from jaxgrow.kernels import frames
from jaxgrow.kernels.arguments import Argument, codes_of
from jaxgrow.kernels.tables import make_tables, run


ARGUMENTS = (
    Argument("addresses", np.int64, 1),
    Argument("wiring", np.int64, 2),
    Argument("alive", np.bool_, 1),
    Argument("nodes", np.float64, 2),
    Argument("along", np.float64, 2),
)
RESULTS = (Argument("sum", np.float64, 2), Argument("distances", np.float64, 1))

_CODES = codes_of(ARGUMENTS, RESULTS, more=True)


@cfunc(frames.HANDLER, cache=True)
@no_type_check
def handler(frame: int) -> int:
    """Call all roots from XLA; see the module for arguments and results."""
    if frames.answers_version(frame):
        return 0
    bad = frames.mismatch(frame, _CODES)
    if bad:
        return frames.refuse(frame, bad)
    roots, most = frames.size(frame, 0, 0), frames.size(frame, 1, 1)
    total = frames.size(frame, 3, 0)
    addresses = frames.long_indices(frames.argument(frame, 0), (roots,))
    wiring = frames.long_indices(frames.argument(frame, 1), (roots, most))
    nodes = frames.reals(frames.argument(frame, 3), (total, 3))
    along = frames.reals(frames.argument(frame, 4), (frames.size(frame, 4, 0), 3))
    columns = frames.size_of_result(frame, 0, 1)
    out = frames.reals(frames.result(frame, 0), (total, columns))
    clear = frames.reals(frames.result(frame, 1), (total,))
    out[:], clear[:] = 0.0, np.inf
    count, last = frames.size(frame, 2, 0), frames.count_arguments(frame)
    tables = make_tables(frame, wiring, last, count, nodes, along, out, clear)
    run(addresses, tables)
    return 0
