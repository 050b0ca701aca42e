"""Smooth maxima and minima: how far they are from the exact ones, and their slopes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from jaxgrow.metrics.extremes import largest, smallest, temperature


COUNT = 7
VALUES = arrays(float, COUNT, elements=st.floats(-50, 50))
BOUNDS = st.floats(0.01, 10)
EVERY = np.ones(COUNT, bool)
ROUNDING = 1e-12


@given(VALUES, BOUNDS)
def test_smooth_maximum_is_above_the_exact_one_by_the_bound_at_most(values, bound):
    warmth = temperature(jnp.asarray(bound), COUNT)
    error = largest(jnp.asarray(values), jnp.asarray(EVERY), warmth) - values.max()
    assert -ROUNDING <= error <= bound + ROUNDING


@given(VALUES, BOUNDS)
def test_smooth_minimum_is_above_the_exact_one_by_the_bound_at_most(values, bound):
    warmth = temperature(jnp.asarray(bound), COUNT)
    error = smallest(jnp.asarray(values), warmth) - values.min()
    assert -ROUNDING <= error <= bound + ROUNDING


@pytest.mark.parametrize("bound", [None, 0.5])
def test_values_that_are_not_real_do_not_count(bound):
    values = jnp.asarray([1.0, 9.0, 2.0, -3.0])
    real = jnp.asarray([True, False, True, True])
    warmth = temperature(bound, 3)
    found = largest(values, real, warmth)
    np.testing.assert_allclose(found, largest(values[real], real[real], warmth))
    assert found < 3
    slope = jax.grad(lambda v: largest(v, real, warmth))(values)
    assert slope[1] == 0
    np.testing.assert_allclose(slope.sum(), 1)


def test_bound_is_reached_where_all_values_tie():
    warmth = temperature(0.3, COUNT)
    same = jnp.full(COUNT, 4.0)
    np.testing.assert_allclose(largest(same, jnp.asarray(EVERY), warmth), 4.3)
    np.testing.assert_allclose(smallest(same, warmth), 4.0)


def test_slope_of_a_smooth_maximum_does_not_jump_where_the_first_place_changes():
    real = jnp.ones(2, bool)

    def slope(x, bound):
        warmth = temperature(bound, 2)
        return jax.grad(lambda x: largest(jnp.stack([x, 1 - x]), real, warmth))(x)

    assert slope(0.5 + 1e-9, None) - slope(0.5 - 1e-9, None) == 2
    assert abs(slope(0.5 + 1e-9, 0.1) - slope(0.5 - 1e-9, 0.1)) < 1e-7
