"""Inner loops for processors: compiled by numba, called by XLA programs.

XLA runs a sum over neighbours on a processor as many small programs with arrays between
them; a loop keeps a pair in registers. Of a polyp's 768 slots, pair forces take half of
the time, contact forces two thirds, near lists a quarter and wide ones a tenth of what
they take as XLA programs. Where numba is not installed (extra ``fast``), on
accelerators, in 32 bits and under a derivative the same is computed by XLA; tests hold
both equal, to rounding. Each loop runs on one thread.

What the host does with a surface of a few hundred triangles has loops too: numpy spends
most of its time there on calls and on candidates that are not near. Where they may not
be used numpy finds the same, in the same order.
"""

import functools
import os
from importlib.util import find_spec

import numpy as np


SWITCH = "JAXGROW_KERNELS"
"""Environment variable that, set to ``off``, leaves everything to XLA."""


@functools.cache
def wanted() -> bool:
    """Whether loops may be used here: numba is installed, and nobody objects."""
    return os.environ.get(SWITCH, "") != "off" and find_spec("numba") is not None


def serve(array: np.ndarray) -> bool:
    """Whether loops may be used on an array of the host: they know 64 bits."""
    return wanted() and array.dtype == np.float64
