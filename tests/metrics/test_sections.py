"""Sections through triangles against clipping, and which of them is the neck."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import quad

from jaxgrow.metrics.sections import (
    diameters,
    LEVELS,
    mean_above,
    necks,
    section_heights,
    share_above,
)


def clipped_share(z, level):
    """Area above a level of the triangle (0, 0), (1, 0), (0, 1), over its area."""
    corners = np.array([[0.0, 0], [1, 0], [0, 1]])
    polygon = []
    for k in range(3):
        a, b, za, zb = corners[k], corners[k - 2], z[k], z[k - 2]
        if za >= level:
            polygon.append(a)
        if (za - level) * (zb - level) < 0:
            polygon.append(a + (b - a) * (level - za) / (zb - za))
    if len(polygon) < 3:
        return 0.0
    x, y = np.transpose(polygon)
    return x @ np.roll(y, -1) - y @ np.roll(x, -1)


HEIGHTS = np.random.default_rng(0).normal(size=(20, 3))


@pytest.mark.parametrize("level", [-1.0, 0.0, 0.3, 2.0])
def test_share_above_a_level_is_that_of_the_clipped_triangle(level):
    wanted = [clipped_share(z, level) for z in HEIGHTS]
    found = share_above(jnp.asarray(HEIGHTS), jnp.asarray(level))
    np.testing.assert_allclose(found, wanted, atol=1e-12)


@pytest.mark.parametrize("level", [-1.0, 0.0, 0.3, 2.0])
def test_mean_above_a_level_is_the_integral_of_the_shares(level):
    wanted = [
        quad(lambda h, z=z: clipped_share(z, h), level, 4, points=np.sort(z))[0]
        for z in HEIGHTS
    ]
    found = mean_above(jnp.asarray(HEIGHTS), jnp.asarray(level))
    np.testing.assert_allclose(found, wanted, atol=1e-7)


@pytest.mark.parametrize("measure", [share_above, mean_above])
def test_level_triangles_are_above_or_not(measure):
    z = jnp.asarray([[1.0, 1, 1], [3, 3, 3]])
    np.testing.assert_allclose(measure(z, jnp.asarray(2.0)), [0, 1], atol=1e-14)


def test_surroundings_are_as_high_as_above_the_former_surface():
    z = jnp.asarray([3.0, 3, 3, -1, 0.4])
    above = jnp.asarray([0.1, 0.375, 2, 0.1, 0.4])
    np.testing.assert_allclose(section_heights(z, above), [0.1, 1.6875, 3, -1, 0.4])


def test_diameter_is_that_of_a_circle_and_none_is_nothing():
    area = jnp.asarray([np.pi, 0, -1])
    np.testing.assert_allclose(diameters(area), [2, 0, 0], rtol=1e-15)


PROFILES = arrays(float, LEVELS, elements=st.floats(0, 20))


@given(PROFILES)
def test_neck_is_the_narrowest_below_the_widest_unless_others_are_more_so(profile):
    widest = profile.argmax()
    below = profile[: widest + 1].min()
    _, found = necks(jnp.asarray(profile), None)
    beyond = [
        profile[i] + 2 * (profile.max() - profile[i:].max())
        for i in range(widest + 1, LEVELS)
    ]
    np.testing.assert_allclose(found, min([below, *beyond]), atol=1e-12)
    assert 0 <= found <= below + 1e-12


@given(PROFILES, PROFILES)
def test_neck_is_continuous_in_the_diameters(profile, change):
    change = change * 1e-3
    _, before = necks(jnp.asarray(profile), None)
    _, after = necks(jnp.asarray(profile + change), None)
    assert abs(after - before) <= 5 * np.abs(change).max() + 1e-12


@given(PROFILES, st.floats(0.01, 5))
def test_smooth_neck_is_as_near_as_stated_and_never_negative(profile, bound):
    _, exact = necks(jnp.asarray(profile), None)
    _, smooth = necks(jnp.asarray(profile), bound)
    assert -2 / 3 * bound - 1e-12 <= smooth - exact <= bound + 1e-12
    assert smooth >= 0


def test_neck_of_a_sessile_profile_is_its_base():
    counted, neck = necks(jnp.linspace(8.0, 0.5, LEVELS), None)
    assert neck == 8
    assert counted.argmin() == 0
