"""Smooth minimum of `jaxgrow.energy.smooth_minimum`, with derivatives."""

import math
from typing import no_type_check

import numpy as np

from jaxgrow.kernels.regrouped import regrouped


_LEAST = 1e-30
"""Distance in place of 0, see `jaxgrow.numerics.guards.smallest_distance`."""

_LARGEST_WHOLE = 64.0
"""Largest integer exponent for which powers are computed by products."""


@regrouped
@no_type_check
def _power(base: float, exponent: float) -> float:
    """Raise a positive base to a power."""
    if exponent != math.floor(exponent) or exponent > _LARGEST_WHOLE:
        return base**exponent
    left, value = np.int64(exponent), 1.0
    while left > 0:
        if left & 1:
            value *= base
        base *= base
        left >>= 1
    return value


@regrouped
@no_type_check
def _raise(base: np.ndarray, exponent: float, value: np.ndarray) -> None:
    """Raise all entries of an array, which is overwritten, to a power."""
    if exponent != math.floor(exponent) or exponent > _LARGEST_WHOLE:
        for k in range(len(base)):
            value[k] = base[k] ** exponent
        return
    left = np.int64(exponent)
    for k in range(len(base)):
        value[k] = 1.0
    while left > 0:
        if left & 1:
            for k in range(len(base)):
                value[k] *= base[k]
        for k in range(len(base)):
            base[k] *= base[k]
        left >>= 1


@regrouped
@no_type_check
def smooth_minima(
    owner: np.ndarray,
    value: np.ndarray,
    half: float,
    reach: float,
    u: np.ndarray,
    slope: np.ndarray,
    power: np.ndarray,
) -> None:
    """Compute the smooth minimum of each owner's values, with its derivative.

    Args:
        owner: of each value, ascending.
        value: not negative; values not below the reach are ignored.
        half: half of the sharpness.
        reach: R of the formula.
        u: the smooth minimum, of the owner of each value; the reach if all of its
            values are ignored. Written.
        slope: its derivative with respect to each value; 0 for ignored ones. Written.
        power: each value over its owner's least, to the power of -half. Written.
    """
    count = len(value)
    share, far = np.zeros(count), np.zeros(count)
    start = 0
    while start < count:
        stop, nearest = start, reach
        while stop < count and owner[stop] == owner[start]:
            nearest = min(nearest, value[stop])
            stop += 1
        # the formula is homogeneous: measured in the nearest value nothing overflows
        unit = max(nearest, _LEAST)
        beyond = _power(unit / reach, half) if nearest < reach else 1.0
        for k in range(start, stop):
            u[k], far[k] = unit, beyond
            share[k] = unit / max(value[k], _LEAST) if value[k] < reach else 0.0
        start = stop
    _raise(share, half, power)
    start = 0
    while start < count:
        stop, total = start, 0.0
        while stop < count and owner[stop] == owner[start]:
            excess = power[stop] - far[stop]
            total += excess * excess if excess > 0.0 else 0.0
            stop += 1
        norm, least = math.sqrt(total), reach
        scale = 0.0
        if norm > 0.0:
            inner = norm + far[start]
            least = u[start] * inner ** (-1.0 / half)
            scale = least / inner / norm
        for k in range(start, stop):
            excess = power[k] - far[k]
            counts = excess > 0.0 and value[k] > _LEAST
            slope[k] = scale * excess * power[k] / value[k] if counts else 0.0
            u[k] = least
        start = stop


@regrouped
@no_type_check
def smooth_changes(
    owner: np.ndarray,
    value: np.ndarray,
    moved: np.ndarray,
    half: float,
    reach: float,
    u: np.ndarray,
    slope: np.ndarray,
    power: np.ndarray,
    along: np.ndarray,
    turned: np.ndarray,
) -> None:
    """Compute the changes of the smooth minimum and of its derivative.

    Args:
        owner: of each value, ascending.
        value: as for `smooth_minima`.
        moved: changes of the values; 0 for ignored ones.
        half: as for `smooth_minima`, like the arguments below.
        reach: likewise.
        u: likewise.
        slope: likewise.
        power: likewise.
        along: change of the minimum, of the owner of each value. Written.
        turned: change of the derivative with respect to each value. Written.
    """
    count = len(value)
    start = 0
    while start < count:
        stop, nearest, size = start, reach, 0.0
        while stop < count and owner[stop] == owner[start]:
            nearest = min(nearest, value[stop])
            along[start] += slope[stop] * moved[stop]
            stop += 1
        far = (max(nearest, _LEAST) / reach) ** half if nearest < reach else 1.0
        total = 0.0
        for k in range(start, stop):
            excess = power[k] - far
            if excess > 0.0:
                total += excess * excess
                size -= excess * half * power[k] * moved[k] / value[k]
        norm = math.sqrt(total)
        change, inner = 0.0, norm + far
        if norm > 0.0:
            size /= norm
            change = along[start] / u[start] - size / inner - size / norm
        for k in range(start, stop):
            along[k] = along[start]
            turned[k] = 0.0
            if slope[k] > 0.0:
                share = moved[k] / value[k]
                excess = power[k] - far
                turned[k] = slope[k] * (change - (half + 1.0) * share)
                turned[k] -= slope[k] / excess * half * power[k] * share
        start = stop
