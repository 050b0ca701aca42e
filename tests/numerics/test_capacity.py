"""Capacities are few."""

import pytest

from jaxgrow.numerics.capacity import capacity_for


@pytest.mark.parametrize("size", [0, 1, 64, 65, 96, 97, 1000, 12345])
def test_capacity_holds_the_size_and_is_at_most_half_too_large(size):
    capacity = capacity_for(size, 64)
    assert capacity >= max(size, 64)
    assert capacity == 64 or capacity * 2 // 3 <= size


def test_capacities_up_to_a_million_are_few():
    seen = {capacity_for(size, 64) for size in range(1, 1_000_000, 61)}
    assert len(seen) <= 26  # log(10⁶ / 64) / log(3/2) = 23.8
