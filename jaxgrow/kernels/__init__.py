"""Inner loops for processors: compiled by numba, called by XLA programs.

XLA runs a sum over neighbours on a processor as many small programs with arrays between
them; a loop keeps a pair in registers. Of a polyp's 768 slots, pair forces take half of
the time, contact forces two thirds, near lists a quarter and wide ones a tenth of what
they take as XLA programs. A few loops are called by the host itself, where it looks for
what is near to some of very many particles. Where numba is not installed (extra
``fast``), on accelerators, in 32 bits and under a derivative the same is computed by
XLA; tests hold both equal, to rounding. Each loop runs on one thread.
"""

import functools
import os
from importlib import import_module
from importlib.util import find_spec
from typing import Any


SWITCH = "JAXGROW_KERNELS"
"""Environment variable that, set to ``off``, leaves everything to XLA."""


@functools.cache
def wanted() -> bool:
    """Whether loops may be used here: numba is installed, and nobody objects."""
    return os.environ.get(SWITCH, "") != "off" and find_spec("numba") is not None


@functools.cache
def loops(name: str) -> Any:
    """The loops that the host calls itself; None where none may be used.

    Args:
        name: of a module of `jaxgrow.kernels`.
    """
    if not wanted():
        return None
    try:
        # not above: numba takes half a second to import
        return import_module(f"jaxgrow.kernels.{name}")
    # numba loops that it can keep in no folder; then the host does without
    except Exception:
        return None
