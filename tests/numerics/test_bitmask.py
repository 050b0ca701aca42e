"""Masks as words against NumPy's flatnonzero."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.numerics.bitmask import (
    bit_of_rank,
    count_bits,
    first_true,
    list_true,
    packed,
)


def masks(count, share, rows=7):
    mask = np.random.default_rng(count).random((rows, count)) < share
    mask[0], mask[1] = False, True
    return mask


@pytest.mark.parametrize("count", [1, 31, 32, 33, 200])
@pytest.mark.parametrize("share", [0.05, 0.5])
@pytest.mark.parametrize("room", [1, 12, 250])
def test_first_true_finds_the_first_entries_of_each_row(count, share, room):
    mask = masks(count, share)
    places, total = first_true(jnp.asarray(mask), room)
    assert np.array_equal(total, mask.sum(axis=1))
    for row, found in zip(mask, np.asarray(places), strict=True):
        wanted = np.full(room, count)
        first = np.flatnonzero(row)[:room]
        wanted[: len(first)] = first
        assert np.array_equal(found, wanted)


def test_words_hold_the_entries_in_their_order():
    mask = masks(70, 0.4)
    words = np.asarray(packed(jnp.asarray(mask)))
    assert words.shape == (7, 3)
    bits = (words[:, :, None] >> np.arange(32, dtype=np.uint32)) & 1
    assert np.array_equal(bits.reshape(7, -1)[:, :70].astype(bool), mask)
    assert not bits.reshape(7, -1)[:, 70:].any()


def test_bits_are_found_by_their_rank():
    words = np.random.default_rng(0).integers(1, 2**32, 50, dtype=np.uint32)
    count = np.asarray(count_bits(jnp.asarray(words)))
    for rank in range(32):
        some = count > rank
        bit = bit_of_rank(jnp.asarray(words[some]), jnp.full(some.sum(), rank))
        for word, found in zip(words[some].tolist(), np.asarray(bit), strict=True):
            assert word >> int(found) & 1
            assert (word & ((1 << int(found)) - 1)).bit_count() == rank


@pytest.mark.parametrize("share", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("length", [1, 32, 1000])
def test_list_of_a_mask_is_that_of_nonzero(share, length):
    mask = np.random.default_rng(0).uniform(size=length) < share
    found, count = jax.jit(list_true, static_argnums=1)(jnp.asarray(mask), 300)
    (wanted,) = np.nonzero(mask)
    assert count == len(wanted)
    padded = np.zeros(300, int)
    padded[: min(300, len(wanted))] = wanted[:300]
    np.testing.assert_array_equal(found, padded)
