"""Loops for CPUs, compiled by numba, called by XLA programs or the host.

XLA runs a sum over neighbours on a CPU as many small programs with arrays between them;
a loop keeps a pair in registers. A whole descent is one loop. If loops cannot be used
(`refusal` gives the reason, and it is reported once), on accelerators, and in 32 bits,
XLA computes the same. The host's operations on a surface of a few hundred triangles are
always loops: NumPy would spend most of its time on calls and on candidates that are not
near. Tests compare all loops with XLA or with sums over all pairs, to rounding. Each
loop runs on one thread.
"""

import functools
import os
from importlib import import_module
from typing import Any

from jaxgrow.kernels.refusals import Refusal


SWITCH = "JAXGROW_KERNELS"
"""Environment variable; ``off`` disables the loops in the device's programs."""


@functools.cache
def _prepared() -> Refusal | None:
    """Prepare numba's cache of loops; return the reason if that fails."""
    return import_module("jaxgrow.kernels.loop_cache").prepare()


@functools.cache
def refusal() -> Refusal | None:
    """Return the reason why loops cannot be used here; None if they can."""
    if os.environ.get(SWITCH, "") == "off":
        return Refusal(f"{SWITCH} is off", None)
    return _prepared()


def wanted() -> bool:
    """Return whether loops can be used here.

    Warns:
        SlowPathWarning: they cannot, and the user did not disable them.
    """
    found = refusal()
    if found is not None:
        found.say()
    return found is None


def loops(name: str) -> Any:
    """Import loops that the host calls.

    They are imported at the first call only, as numba takes half a second. They compute
    in 64 bits, like all of the host's code.

    Args:
        name: of a module of `jaxgrow.kernels`.
    """
    _prepared()
    return import_module(f"jaxgrow.kernels.{name}")
