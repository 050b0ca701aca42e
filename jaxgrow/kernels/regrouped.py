"""How loops are compiled whose sums may be regrouped and fused, so that they are quick.

LLVM optimises a function again with each caller that it becomes a part of, and regroups
otherwise each time; and of functions of the same name a process takes the one that was
loaded first. So that the bits of a result depend neither on what a process called
before nor on whether it compiled its loops or found them on disk, a function that may
be regrouped is never called: it becomes a part of the handler of XLA, or of the loop of
the host, that needs it.
"""

from numba import njit


regrouped = njit(
    cache=True,
    fastmath={"contract", "nsz", "reassoc", "arcp"},
    error_model="numpy",
    forceinline=True,
)
"""Decorator of a loop; NaN and infinity stay what they are."""
