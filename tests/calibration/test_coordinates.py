"""Unconstrained coordinates: there and back, always within the bounds."""

import jax.numpy as jnp
import numpy as np
from hypothesis import given, strategies as st

from jaxgrow.calibration.coordinates import Coordinates, PRIOR_VARIANCE
from jaxgrow.calibration.spec import Bounds


BOUNDS = [Bounds(low=0.005, high=0.5), Bounds(low=0, high=2), Bounds(low=-1, high=3)]
MAP = Coordinates.between(BOUNDS)


def test_zero_is_the_middle_and_the_geometric_one_of_positive_bounds():
    middle = MAP.parameters(jnp.zeros(3))
    np.testing.assert_allclose(middle, [0.05, 1.0, 1.0], rtol=1e-14)


@given(st.lists(st.floats(-12, 12), min_size=3, max_size=3))
def test_there_and_back_is_the_same(u):
    back = MAP.coordinates(MAP.parameters(jnp.array(u)))
    np.testing.assert_allclose(back, u, atol=1e-8)


@given(st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3))
def test_every_coordinate_is_within_the_bounds(u):
    values = MAP.parameters(jnp.array(u))
    assert bool(jnp.all((MAP.low <= values) & (values <= MAP.high)))


def test_slopes_are_those_of_differences():
    u, h = jnp.array([0.3, -1.2, 2.0]), 1e-6
    wanted = (MAP.parameters(u + h) - MAP.parameters(u - h)) / (2 * h)
    np.testing.assert_allclose(MAP.slopes(u), wanted, rtol=1e-8)


def test_a_uniform_share_has_the_prior_variance():
    share = (np.arange(100_000) + 0.5) / 100_000
    coordinates = np.log(share / (1 - share))
    np.testing.assert_allclose(np.var(coordinates), PRIOR_VARIANCE, rtol=1e-3)
