"""Inner loops for processors: compiled by numba, called by XLA programs or the host.

XLA runs a sum over neighbours on a processor as many small programs with arrays between
them; a loop keeps a pair in registers. A whole descent is one loop. Where loops cannot
be used (`refusal` tells why, and is said once), on accelerators, and in 32 bits, the
same is computed by XLA. What the host does with a surface of a few hundred triangles is
loops always: NumPy would spend most of its time there on calls and on candidates that
are not near. Tests hold all of it equal to XLA or to all pairs, to rounding. Each loop
runs on one thread.
"""

import functools
import os
from importlib import import_module
from typing import Any

from jaxgrow.kernels.refusals import Refusal


SWITCH = "JAXGROW_KERNELS"
"""Environment variable that, set to ``off``, leaves the device's programs to XLA."""


@functools.cache
def _prepared() -> Refusal | None:
    """Make sure that numba can keep loops and read them; why not, if it cannot."""
    return import_module("jaxgrow.kernels.loop_cache").prepare()


@functools.cache
def refusal() -> Refusal | None:
    """Find out why no loop may be used here; None if they may."""
    if os.environ.get(SWITCH, "") == "off":
        return Refusal(f"{SWITCH} is off", None)
    return _prepared()


def wanted() -> bool:
    """Whether loops may be used here.

    Warns:
        SlowPathWarning: they may not, though nobody switched them off.
    """
    found = refusal()
    if found is not None:
        found.say()
    return found is None


def loops(name: str) -> Any:
    """Import loops that the host calls: not before, as numba takes half a second.

    They know 64 bits, of which all that the host does is.

    Args:
        name: of a module of `jaxgrow.kernels`.
    """
    _prepared()
    return import_module(f"jaxgrow.kernels.{name}")
