"""Compilation of what runs a few times: references, and formulas with derivatives."""

from typing import Any

import equinox as eqx


# Not the optimisation level 0 of LLVM, which is faster still: with jaxlib 0.10.1 the
# derivatives of a lean and of lengths along an axis differ by a tenth and more.
_OPTIONS: Any = {"xla_cpu_use_fusion_emitters": False}


def quick_jit(function):
    """Compile a function without fused loops, in about half the time.

    For a formula that a test evaluates, or compares with. Programs of the package are
    compiled as users have them.
    """
    return eqx.filter_jit(function, compiler_options=_OPTIONS)
