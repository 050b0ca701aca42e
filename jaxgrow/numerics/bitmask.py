"""Bit masks: sparse Boolean arrays packed into 32-bit words.

On a CPU ``jnp.nonzero`` and ``jnp.cumsum`` visit every entry of a mask several times;
words are counted 32 entries at a time.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt


BITS = 32
"""Bits of a word."""


class Tally(NamedTuple):
    """Words with the running count of their set bits.

    Attributes:
        words: row by row.
        upto: bits set in each and in those before it.
    """

    words: UInt[Array, " w"]
    upto: Int[Array, " w"]

    @property
    def total(self) -> Int[Array, ""]:
        """Of the bits that are set."""
        return self.upto[-1]


def packed(mask: Bool[Array, "*b n"]) -> UInt[Array, "*b w"]:
    """Pack a mask into words along its last axis.

    Entry 32 w + j is bit j of word w.
    """
    *batch, count = mask.shape
    spare = [(0, 0)] * len(batch) + [(0, -count % BITS)]
    bits = jnp.pad(mask, spare).reshape(*batch, -1, BITS).astype(jnp.uint32)
    value = jnp.uint32(1) << jnp.arange(BITS, dtype=jnp.uint32)
    value = jnp.expand_dims(value, range(bits.ndim - 1))
    return jnp.sum(bits * value, axis=-1, dtype=jnp.uint32)


def count_bits(words: UInt[Array, "*n"]) -> Int[Array, "*n"]:
    """Count the set bits of each word (population count)."""
    return jax.lax.population_count(words).astype(jnp.int32)


def bit_of_rank(words: UInt[Array, "*n"], rank: Int[Array, "*n"]) -> Int[Array, "*n"]:
    """Find the set bit of each word that has ``rank`` set bits below it."""
    bit = jnp.zeros(words.shape, jnp.int32)
    for half in (16, 8, 4, 2, 1):  # binary search: lower or upper half
        low = count_bits(words & jnp.uint32((1 << half) - 1))
        above = rank >= low
        rank = jnp.where(above, rank - low, rank)
        words = jnp.where(above, words >> jnp.uint32(half), words)
        bit = jnp.where(above, bit + half, bit)
    return bit


def first_true(
    mask: Bool[Array, "b n"], room: int
) -> tuple[Int[Array, "b k"], Int[Array, " b"]]:
    """List where each row is true, ascending, and count it.

    Args:
        mask: row by row.
        room: how many entries of a row are wanted at most.

    Returns:
        The places, padded by n, and the number of true entries of each row.
    """
    words = packed(mask)
    upto = jnp.cumsum(count_bits(words), axis=1, dtype=jnp.int32)
    number = jnp.arange(room, dtype=jnp.int32)
    before = upto[:, None, :] <= number[None, :, None]
    place = jnp.sum(before, axis=2, dtype=jnp.int32)
    place = jnp.minimum(place, words.shape[1] - 1)
    word = jnp.take_along_axis(words, place, axis=1)
    rank = number[None] - jnp.take_along_axis(upto, place, axis=1) + count_bits(word)
    found = BITS * place + bit_of_rank(word, rank)
    total = upto[:, -1]
    return jnp.where(number[None] < total[:, None], found, mask.shape[1]), total


def counted(words: UInt[Array, " w"]) -> Tally:
    """Return words with the running count of their set bits."""
    return Tally(words, jnp.cumsum(count_bits(words), dtype=jnp.int32))


def set_bits(
    tally: Tally, size: int, start: int | Array = 0
) -> tuple[Int[Array, " s"], Int[Array, " s"]]:
    """List the set bits, word by word, from number `start` on.

    Args:
        tally: of the words.
        size: how many of them are wanted.
        start: how many are skipped.

    Returns:
        The word of each and its bit, both 0 for padding.
    """
    number = start + jnp.arange(size, dtype=jnp.int32)
    real = number < tally.total
    # method="scan": unrolled, the compiler repeats the search for every use of `place`
    place = jnp.searchsorted(tally.upto, number, side="right", method="scan")
    place = jnp.where(real, place, 0).astype(jnp.int32)
    word = tally.words[place]
    rank = number - (tally.upto[place] - count_bits(word))
    bit = bit_of_rank(word, rank)
    return place, jnp.where(real, bit, 0)


def list_true(mask: Bool[Array, " n"], size: int) -> tuple[Int[Array, " s"], Array]:
    """List where a mask is true, ascending, padded by 0; and count it.

    As ``jnp.nonzero``, which is slow on a CPU.
    """
    tally = counted(packed(mask))
    place, bit = set_bits(tally, size)
    return BITS * place + bit, tally.total
