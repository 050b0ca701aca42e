r"""Head, neck and stalk in the diameters of a lesion's sections.

A section belongs to a head if one below it is narrower: with
:math:`p_i = d_i - \min_{j \le i} d_j`, in full from :math:`p_i = 0.1 \, d_i` on and
below that in part, by :math:`\rho_i` from 0 to 1. A foot, however wide, is not a head,
as it narrows from the base on. If no section is one in full, all count in part:

.. math:: q_i = \min(1, \rho_i + 1 - \max_j \rho_j), \qquad b = \max_i q_i d_i .

So the width b is that of the head, or that of the base where there is none, and
changes continuously from one to the other. The neck is the narrowest section below the
head, :math:`n = \min_i d_i + 2 \, (b - \max_{j \ge i} q_j d_j)`: from the head upwards
the difference to the head counts twice, so that neither place needs to be known. A
dome's neck is its base.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.metrics.elevation import RAISED, smoothstep
from jaxgrow.metrics.extremes import largest, smallest, temperature
from jaxgrow.numerics.guards import safe_divide
from jaxgrow.runtime.types import Scalar


_WIDER = 0.1
"""Share by which a head is wider than what is below it, to count in full."""

_STALKED = (0.95, 0.85)
"""Neck over width from which on a part below the head is a stalk: not, and in full."""

_LOCATING = 0.1
"""Smoothing in r0 of which sections are narrower than a head, in all versions."""


class Profile(NamedTuple):
    """Widths of a lesion in r0.

    Attributes:
        width: of the widest section of the head.
        neck: of the narrowest section below it.
        counted: what each section counts as a neck; the least is the neck's.
        head: by how much something from each section upwards is head, as a width.
    """

    width: Float[Array, ""]
    neck: Float[Array, ""]
    counted: Float[Array, " h"]
    head: Float[Array, " h"]


def profile_of(diameter: Float[Array, " h"], smoothing: Scalar | None) -> Profile:
    r"""Find head and neck in diameters from the base upwards.

    Args:
        diameter: of the sections.
        smoothing: bound :math:`\epsilon` in r0; None for exact extremes. The smooth
            width is from 0 to ε/3 above the exact one, the smooth neck from -2/3 ε to
            ε.
    """
    levels = diameter.shape[0]
    upwards = jnp.tri(levels, dtype=bool).T
    rows = jnp.broadcast_to(diameter, upwards.shape)
    cool = temperature(_LOCATING, levels)
    assert cool is not None
    below = -largest(-rows, upwards.T, cool) + cool * jnp.log(levels)
    some = diameter > 0
    share = safe_divide(diameter - below, _WIDER * diameter, some)
    in_head = smoothstep(share)
    counts = jnp.minimum(1, in_head + 1 - jnp.max(in_head))

    # three extremes, with an error of at most two bounds to either side, and one up
    warmth = temperature(None if smoothing is None else smoothing / 3, levels + 1)
    wide = jnp.broadcast_to(counts * diameter, upwards.shape)
    head = largest(wide, upwards, warmth)
    counted = diameter + 2 * (head[0] - head)
    neck = smallest(jnp.append(counted, head[0]), warmth)
    return Profile(head[0], neck, counted, head)


class Lengths(NamedTuple):
    """Lengths of the parts of a lesion along its axis, in r0.

    Attributes:
        stalk: of the part below the head whose sections are at most as wide as halfway
            between neck and head.
        head: of the part above it, to the tip.
    """

    stalk: Float[Array, ""]
    head: Float[Array, ""]


def lengths_of(
    profile: Profile,
    diameter: Float[Array, " h"],
    length: Float[Array, ""],
    foot: Float[Array, ""],
) -> Lengths:
    """Compute the lengths of stalk and head.

    Where the neck is hardly narrower than the head, there is hardly a stalk: it counts
    in part between the two ratios of `_STALKED`, and without one all is head.

    Args:
        profile: of the lesion.
        diameter: of sections evenly spaced from the base ring to the tip, without it.
        length: from the base ring to the tip.
        foot: from the former surface to the base ring. It is part of the stalk where
            the ring is narrow enough, by up to half an r0.
    """
    limit = (profile.neck + profile.width) / 2
    tip = jnp.zeros_like(diameter[:1])
    ends = jnp.concatenate([diameter, tip])
    narrow = _share_below(ends[:-1], ends[1:], limit)
    under_head = jnp.concatenate([profile.head[1:], tip]) > limit
    spacing = length / diameter.shape[0]
    least = -_running_maximum(-ends)
    flare = jnp.sum(1 - _share_below(least[:-1], least[1:], limit)) * spacing
    in_foot = jnp.clip((limit - diameter[0]) / RAISED, 0, 1)
    stalk = jnp.sum(jnp.where(under_head, narrow, 0)) * spacing + in_foot * foot
    flare = flare + (1 - in_foot) * foot
    ratio = safe_divide(profile.neck, profile.width, profile.width > 0)
    none, full = _STALKED
    stalked = jnp.where(
        profile.width > 0, smoothstep((none - ratio) / (none - full)), 0
    )
    return Lengths(stalked * stalk, length + foot - stalked * (stalk + flare))


def _share_below(
    start: Float[Array, " h"], end: Float[Array, " h"], limit: Float[Array, ""]
) -> Float[Array, " h"]:
    """Compute the share of each interval that is below a limit."""
    low, high = jnp.minimum(start, end), jnp.maximum(start, end)
    share = safe_divide(limit - low, high - low, high > low)
    return jnp.where(low > limit, 0, jnp.where(high <= limit, 1, share))


def _running_maximum(values: Float[Array, " h"]) -> Float[Array, " h"]:
    rows = jnp.broadcast_to(values, (values.shape[0], values.shape[0]))
    return largest(rows, jnp.tri(values.shape[0], dtype=bool), None)
