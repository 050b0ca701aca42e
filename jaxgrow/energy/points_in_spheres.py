"""Which points lie in which spheres, listed without an array of all pairs.

Of 32 spheres a point's answers are the bits of one word. Words are counted by their
bits, and the list is read from the counts: of few pairs that costs a tenth of
``jnp.nonzero``, which goes through every pair.

Many spheres are put in the order of a curve that fills space (Morton, "A computer
oriented geodetic data base", 1966) and tied up in bundles of 32, each with a sphere
around it. A point is asked for its bundles first, and only for the spheres in those
then. These pairs of a point and a bundle are taken in rounds of equal size, as many as
there are: memory is bounded, and nothing but the list can overflow.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt

from jaxgrow.numerics.bitmask import BITS, count_bits, counted, set_bits


FEW_PAIRS = 2**22
"""Up to as many pairs of a point and a sphere no bundles are tied."""

ROUND = 2**15
"""Pairs of a point and a bundle in a round."""

KEYS = 2**32
"""Up to as many pairs have a number each that they are sorted by."""

_SLACK = 1.001
"""Factor on the radius of a bundle, so that rounding loses none of its spheres."""

_MORTON_BITS = 10
"""Of a coordinate in the number of a place on the curve."""


class Spheres(NamedTuple):
    """Spheres; a sphere that is not finite, or of radius 0, holds no point.

    Attributes:
        centre: in r0.
        radius: in r0.
    """

    centre: Float[Array, "f 3"]
    radius: Float[Array, " f"]


class Inside(NamedTuple):
    """Pairs of a point and a sphere that it lies in, by point, then by sphere.

    Attributes:
        point: index of the point of each pair, 0 for padding.
        sphere: index of its sphere, 0 for padding.
        total: how many pairs there are, listed or not.
    """

    point: Int[Array, " p"]
    sphere: Int[Array, " p"]
    total: Int[Array, ""]


class _Columns(NamedTuple):
    """Spheres by words: sphere 32 w + j is in row j, column w.

    Attributes:
        centre: coordinate by coordinate.
        square: of the radius; 0 for none.
    """

    centre: Float[Array, "3 b w"]
    square: Float[Array, "b w"]


class _Bundles(NamedTuple):
    """Spheres in bundles: that of row j and column w is in bundle w.

    Attributes:
        around: a sphere around each bundle.
        member: the spheres of each.
        which: index of each of those.
    """

    around: Spheres
    member: _Columns
    which: Int[Array, "b w"]


def list_inside(
    points: Float[Array, "n 3"], alive: Bool[Array, " n"], spheres: Spheres, size: int
) -> Inside:
    """Pairs of a point and a sphere that it lies in; all, if they are `size` at most.

    Args:
        points: in r0.
        alive: which of them are asked for.
        spheres: that they may lie in.
        size: of the list.
    """
    if points.shape[0] * spheres.radius.shape[0] <= FEW_PAIRS:
        words = _words(points, alive, _columns(spheres))
        tally = counted(words.reshape(-1))
        pairs = _pairs(*set_bits(tally, size), words.shape[1])
        return Inside(*pairs, tally.total)
    return _list_by_bundles(points, alive, spheres, size)


def count_inside(
    points: Float[Array, "n 3"], alive: Bool[Array, " n"], spheres: Spheres
) -> Int[Array, ""]:
    """How many pairs there are of a point and a sphere that it lies in."""
    if points.shape[0] * spheres.radius.shape[0] <= FEW_PAIRS:
        held = count_bits(_words(points, alive, _columns(spheres)))
        return jnp.sum(held, dtype=jnp.int32)
    return _list_by_bundles(points, alive, spheres, 0).total


def _columns(spheres: Spheres) -> _Columns:
    """The spheres by words, with empty ones to fill the last word."""
    extra = -spheres.radius.shape[0] % BITS
    finite = jnp.isfinite(spheres.radius)
    square = jnp.where(finite, spheres.radius, 0) ** 2
    return _Columns(
        jnp.pad(spheres.centre, ((0, extra), (0, 0))).T.reshape(3, -1, BITS).mT,
        jnp.pad(square, (0, extra)).reshape(-1, BITS).T,
    )


def _words(
    points: Float[Array, "n 3"], alive: Bool[Array, " n"], spheres: _Columns
) -> UInt[Array, "n w"]:
    """In which spheres each point lies, a word for every column."""
    empty = jnp.zeros((points.shape[0], spheres.square.shape[1]), jnp.uint32)

    def filled() -> UInt[Array, "n w"]:
        words = empty
        for bit in range(BITS):
            near = jnp.zeros(words.shape, points.dtype)
            for axis in range(3):
                centre = spheres.centre[axis, bit]
                near += (points[:, axis, None] - centre[None, :]) ** 2
            within = alive[:, None] & (near < spheres.square[bit][None, :])
            words |= jnp.where(within, jnp.uint32(1 << bit), jnp.uint32(0))
        return words

    # a branch, so that the compiler does not test again wherever a word is used
    return jax.lax.cond(jnp.any(alive), filled, lambda: empty)


def _pairs(
    place: Int[Array, " s"], bit: Int[Array, " s"], columns: int
) -> tuple[Int[Array, " s"], Int[Array, " s"]]:
    """Row and column that a bit of a table of words stands for."""
    return place // columns, place % columns * BITS + bit


def _list_by_bundles(
    points: Float[Array, "n 3"], alive: Bool[Array, " n"], spheres: Spheres, size: int
) -> Inside:
    points, spheres = jax.lax.stop_gradient((points, spheres))  # a loop of any length
    bundles = _tied(spheres)
    words = _words(points, alive, _columns(bundles.around))
    tally = counted(words.reshape(-1))

    def in_round(state: tuple[Array, Inside]) -> tuple[Array, Inside]:
        start, found = state
        asked = set_bits(tally, ROUND, start)
        point, bundle = _pairs(*asked, words.shape[1])
        real = start + jnp.arange(ROUND, dtype=start.dtype) < tally.total
        held = counted(_member_words(points[point], real, bundles.member, bundle))

        def listed(state: tuple[Array, Inside]) -> tuple[Array, Inside]:
            begin, found = state
            which, bit = set_bits(held, ROUND, begin)
            at = jnp.minimum(found.total + begin, size)
            put = jax.lax.dynamic_update_slice
            point_at = put(found.point, point[which], (at,))
            sphere_at = put(found.sphere, bundles.which[bit, bundle[which]], (at,))
            return begin + ROUND, Inside(point_at, sphere_at, found.total)

        if size > 0:
            state = zero, found
            _, found = jax.lax.while_loop(lambda s: s[0] < held.total, listed, state)
        total = found.total + held.total
        return start + ROUND, Inside(found.point, found.sphere, total)

    # a round writes all that it has room for; what is past the end is cut off
    empty, zero = jnp.zeros(size + ROUND, jnp.int32), jnp.zeros((), jnp.int32)
    state = zero, Inside(empty, empty, zero)
    _, found = jax.lax.while_loop(lambda s: s[0] < tally.total, in_round, state)
    return _ordered(found, size, points.shape[0], spheres.radius.shape[0])


def _member_words(
    points: Float[Array, "s 3"],
    real: Bool[Array, " s"],
    member: _Columns,
    bundle: Int[Array, " s"],
) -> UInt[Array, " s"]:
    """In which spheres of its bundle each point lies."""
    words = jnp.zeros(bundle.shape, jnp.uint32)
    for bit in range(BITS):
        near = jnp.zeros(bundle.shape, points.dtype)
        for axis in range(3):
            near += (points[:, axis] - member.centre[axis, bit][bundle]) ** 2
        within = real & (near < member.square[bit][bundle])
        words |= jnp.where(within, jnp.uint32(1 << bit), jnp.uint32(0))
    return words


def _tied(spheres: Spheres) -> _Bundles:
    """Bundles of spheres that are near each other."""
    count = spheres.radius.shape[0]
    use = jnp.isfinite(spheres.radius) & jnp.all(jnp.isfinite(spheres.centre), axis=1)
    use &= spheres.radius > 0
    along = _along_curve(spheres.centre, use)
    _, index = jax.lax.sort((along, jnp.arange(count, dtype=jnp.int32)), num_keys=1)
    centre = jnp.where(use[:, None], spheres.centre, 0)[index]
    radius = jnp.where(use, spheres.radius, 0)[index]
    member = _columns(Spheres(centre, radius))
    real = member.square > 0
    low = jnp.min(jnp.where(real[None], member.centre, jnp.inf), axis=1)
    high = jnp.max(jnp.where(real[None], member.centre, -jnp.inf), axis=1)
    middle = jnp.where(jnp.isfinite(low), (low + high) / 2, 0)
    off = jnp.sqrt(jnp.sum((member.centre - middle[:, None, :]) ** 2, axis=0))
    reach = jnp.where(real, off + jnp.sqrt(member.square), 0)
    around = Spheres(middle.T, _SLACK * jnp.max(reach, axis=0))
    return _Bundles(
        around, member, jnp.pad(index, (0, -count % BITS)).reshape(-1, BITS).T
    )


def _along_curve(
    centre: Float[Array, "f 3"], use: Bool[Array, " f"]
) -> UInt[Array, " f"]:
    """Place of each on the curve; of what is not used, the last."""
    low = jnp.min(jnp.where(use[:, None], centre, jnp.inf), axis=0)
    high = jnp.max(jnp.where(use[:, None], centre, -jnp.inf), axis=0)
    side = jnp.maximum(jnp.max(high - low), jnp.finfo(centre.dtype).tiny)
    share = jnp.where(use[:, None], (centre - low[None, :]) / side, 0)
    cell = (share * (2**_MORTON_BITS - 1)).astype(jnp.uint32)
    code = jnp.zeros(centre.shape[0], jnp.uint32)
    for bit in range(_MORTON_BITS):
        for axis in range(3):
            one = (cell[:, axis] >> jnp.uint32(bit)) & jnp.uint32(1)
            code |= one << jnp.uint32(3 * bit + axis)
    return jnp.where(use, code, jnp.uint32(2**32 - 1))


def _ordered(found: Inside, size: int, points: int, spheres: int) -> Inside:
    """What was found up to `size`, by point, then by sphere."""
    real = jnp.arange(size, dtype=jnp.int32) < found.total
    point = jnp.where(real, found.point[:size], points)  # padding comes last
    sphere = found.sphere[:size]
    if (points + 1) * spheres <= KEYS:  # in a fifth of the time
        width = jnp.uint32(spheres)
        key = point.astype(jnp.uint32) * width + sphere.astype(jnp.uint32)
        key = jax.lax.sort(key)
        point, sphere = (part.astype(jnp.int32) for part in (key // width, key % width))
    else:
        point, sphere = jax.lax.sort((point, sphere), num_keys=2)
    return Inside(jnp.where(real, point, 0), jnp.where(real, sphere, 0), found.total)
