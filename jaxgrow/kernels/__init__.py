"""Inner loops for processors: compiled by numba, called by XLA programs.

XLA runs a sum over neighbours on a processor as many small programs with arrays between
them; a loop keeps a pair in registers, which takes half of the time and, of few
particles, a third. Where numba is not installed (extra ``fast``), on accelerators, in
32 bits and under a derivative the same is computed by XLA; a test holds both equal.
"""

import functools
import os
from importlib.util import find_spec


SWITCH = "JAXGROW_KERNELS"
"""Environment variable that, set to ``off``, leaves everything to XLA."""


@functools.cache
def wanted() -> bool:
    """Whether loops may be used here: numba is installed, and nobody objects."""
    return os.environ.get(SWITCH, "") != "off" and find_spec("numba") is not None
