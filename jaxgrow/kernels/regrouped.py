"""Compilation of loops with fast-math: sums may be regrouped and fused.

LLVM optimises an inlined function again in each caller, and can regroup its sums
differently each time; and of functions of the same name a process uses the one that was
loaded first. The bits of a result must depend neither on earlier calls of a process nor
on whether its loops were compiled or read from disk. So a function that may be
regrouped is never called: it is always inlined in the handler of XLA, or in the loop of
the host, that uses it.
"""

from numba import njit


regrouped = njit(
    cache=True,
    fastmath={"contract", "nsz", "reassoc", "arcp"},
    error_model="numpy",
    forceinline=True,
)
"""Decorator of a loop; NaN and infinity are preserved."""
