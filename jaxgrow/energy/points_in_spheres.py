"""Search for the spheres that hold a point, without an array of all pairs.

The results of a point for 32 spheres are the bits of one word. The set bits of words
are counted, and the list is read from the counts: for sparse results that costs a tenth
of ``jnp.nonzero``, which visits every pair.

Many spheres are sorted along a space-filling curve (Morton, "A computer oriented
geodetic data base", 1966) and grouped in bundles of 32, each with a bounding sphere. A
point is tested against the bundles first, and then only against the spheres of those
that hold it. These pairs of a point and a bundle are processed in rounds of equal size,
as many as needed: memory is bounded, and only the list can overflow.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt

from jaxgrow.numerics.bitmask import BITS, count_bits, counted, set_bits


FEW_PAIRS = 2**22
"""Pairs of a point and a sphere up to which no bundles are made."""

ROUND = 2**15
"""Pairs of a point and a bundle per round."""

KEYS = 2**32
"""Number of pairs up to which a pair is one 32-bit sort key."""

_SLACK = 1.001
"""Factor on the radius of a bundle, so that rounding loses none of its spheres."""

_MORTON_BITS = 10
"""Bits of a coordinate in the Morton code."""


class Spheres(NamedTuple):
    """Spheres; a sphere that is not finite, or of radius 0, holds no point.

    Attributes:
        centre: in r0.
        radius: in r0.
    """

    centre: Float[Array, "f 3"]
    radius: Float[Array, " f"]


class Inside(NamedTuple):
    """Pairs of a point and a sphere that holds it, by point, then by sphere.

    Attributes:
        point: index of the point of each pair, 0 for padding.
        sphere: index of its sphere, 0 for padding.
        total: number of pairs, listed or not.
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
    """Bundles of spheres: the sphere of row j, column w is in bundle w.

    Attributes:
        around: bounding sphere of each bundle.
        member: its spheres.
        which: their indices.
    """

    around: Spheres
    member: _Columns
    which: Int[Array, "b w"]


def list_inside(
    points: Float[Array, "n 3"], alive: Bool[Array, " n"], spheres: Spheres, size: int
) -> Inside:
    """List the pairs of a point and a sphere that holds it, up to `size`.

    Args:
        points: in r0.
        alive: False for points that are skipped.
        spheres: the spheres.
        size: capacity of the list.
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
    """Count the pairs of a point and a sphere that holds it."""
    if points.shape[0] * spheres.radius.shape[0] <= FEW_PAIRS:
        held = count_bits(_words(points, alive, _columns(spheres)))
        return jnp.sum(held, dtype=jnp.int32)
    return _list_by_bundles(points, alive, spheres, 0).total


def _columns(spheres: Spheres) -> _Columns:
    """Arrange spheres by words, with empty ones to fill the last word."""
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
    """Test which spheres hold each point; return a word per column."""
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

    # a branch, so that the compiler does not repeat the test at every use of a word
    return jax.lax.cond(jnp.any(alive), filled, lambda: empty)


def _pairs(
    place: Int[Array, " s"], bit: Int[Array, " s"], columns: int
) -> tuple[Int[Array, " s"], Int[Array, " s"]]:
    """Convert the place of a bit in a table of words to row and column."""
    return place // columns, place % columns * BITS + bit


def _list_by_bundles(
    points: Float[Array, "n 3"], alive: Bool[Array, " n"], spheres: Spheres, size: int
) -> Inside:
    points, spheres = jax.lax.stop_gradient((points, spheres))  # while: no reverse mode
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

    # a round always writes ROUND entries; those past the end are cut off
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
    """Test which spheres of its bundle hold each point."""
    words = jnp.zeros(bundle.shape, jnp.uint32)
    for bit in range(BITS):
        near = jnp.zeros(bundle.shape, points.dtype)
        for axis in range(3):
            near += (points[:, axis] - member.centre[axis, bit][bundle]) ** 2
        within = real & (near < member.square[bit][bundle])
        words |= jnp.where(within, jnp.uint32(1 << bit), jnp.uint32(0))
    return words


def _tied(spheres: Spheres) -> _Bundles:
    """Group nearby spheres in bundles."""
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
    """Return the Morton code of each centre; the largest for unused ones."""
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
    """Sort the pairs found, up to `size`, by point, then by sphere."""
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
