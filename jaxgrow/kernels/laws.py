"""The laws of forces for compiled loops."""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from jaxgrow.kernels.regrouped import regrouped


@regrouped
@no_type_check
def a2(
    u: float, adhesion: float, low: float, blend: float, edge: float, tail: float
) -> float:
    """Force of `jaxgrow.A2` at u, with its branches as numbers (see `branches`)."""
    share = min(max((u - low) * blend, 0.0), 1.0)
    taper = min(max((edge - u) * tail, 0.0), 1.0)
    taper = taper * adhesion if u > 1.0 else taper
    return (1.0 - u * u) * (1.0 - share) + 0.5 * (1.0 - u) * (2.0 - u) * share * taper


@njit(cache=True)
@no_type_check
def branches(smoothing: float, cutoff: float) -> tuple[float, float, float, float]:
    """Where the blend begins and the taper ends, and the inverse of their widths.

    Without smoothing both are as wide as one rounding.
    """
    if smoothing > 0.0:
        return 0.5 - smoothing, 0.5 / smoothing, cutoff, 1.0 / smoothing
    return np.nextafter(0.5, 0.0), 1e300, np.nextafter(cutoff, 2.0 * cutoff), 1e300


@regrouped
@no_type_check
def steepness(u: float, margin: float) -> float:
    """Minus the derivative of `jaxgrow.energy.contact.barrier` at u; not negative."""
    if not u < margin:
        return 0.0
    inside = u - margin
    return 2.0 * inside * math.log(u / margin) + inside * inside / u
