"""Head, neck and stalk in diameters of sections, base to tip."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from jaxgrow.metrics.profile import lengths_of, profile_of
from jaxgrow.metrics.sections import LEVELS


DIAMETERS = arrays(float, LEVELS, elements=st.floats(0, 20))


def drawn(*points):
    """Diameters between points (share of the length, diameter)."""
    share, diameter = np.transpose(points)
    return jnp.asarray(np.interp(np.arange(LEVELS) / LEVELS, share, diameter))


FLARED = drawn((0, 9), (0.2, 4), (0.4, 4), (0.7, 7), (1, 0))


def test_a_foot_wider_than_the_head_is_neither_head_nor_neck():
    found = profile_of(FLARED, None)
    np.testing.assert_allclose(found.width, FLARED[LEVELS // 2 :].max())
    np.testing.assert_allclose(found.neck, 4)


def test_neck_of_a_dome_is_its_base():
    found = profile_of(jnp.linspace(8.0, 0.5, LEVELS), None)
    assert found.width == 8
    assert found.neck == 8
    assert found.counted.argmin() == 0


def test_head_without_a_neck_below_full_width_is_as_wide_as_the_widest():
    found = profile_of(drawn((0, 8), (0.5, 7.9), (1, 0)), None)
    np.testing.assert_allclose(found.width, 8)


def test_width_and_neck_do_not_jump_where_a_neck_disappears():
    waists = np.linspace(3, 7, 401)
    found = [
        profile_of(drawn((0, 9), (0.3, waist), (0.6, 6), (1, 0)), None)
        for waist in waists
    ]
    for values in ([p.width for p in found], [p.neck for p in found]):
        steps = np.abs(np.diff(np.array(values)))
        # the width goes from 6 to 9 while the head fades over 0.1 of its width
        assert steps.max() < 0.5
    np.testing.assert_allclose([found[0].width, found[0].neck], [6, 3], atol=0.15)
    np.testing.assert_allclose([found[-1].width, found[-1].neck], [9, 9], atol=1e-9)


@given(DIAMETERS)
def test_neck_is_never_wider_than_the_width(diameter):
    found = profile_of(jnp.asarray(diameter), None)
    assert 0 <= found.neck <= found.width <= diameter.max()


@given(DIAMETERS, st.floats(0.01, 5))
def test_smooth_widths_are_as_near_as_stated_and_never_negative(diameter, bound):
    exact = profile_of(jnp.asarray(diameter), None)
    smooth = profile_of(jnp.asarray(diameter), bound)
    assert -1e-12 <= smooth.width - exact.width <= bound / 3 + 1e-12
    assert -2 / 3 * bound - 1e-12 <= smooth.neck - exact.neck <= bound + 1e-12
    assert smooth.neck >= 0


def lengths(diameter, length=10.0, foot=0.5):
    found = profile_of(diameter, None)
    return lengths_of(found, diameter, jnp.asarray(length), jnp.asarray(foot))


def test_stalk_is_what_is_narrow_below_the_head():
    found = lengths(FLARED)
    limit = (4 + FLARED[LEVELS // 2 :].max()) / 2
    begins = 2 * (9 - limit) / (9 - 4)
    ends = 4 + 3 * (limit - 4) / (7 - 4)
    np.testing.assert_allclose(found.stalk, ends - begins, rtol=0.02)
    np.testing.assert_allclose(found.head, 10 - ends, rtol=0.02)


def test_a_straight_stalk_begins_at_the_former_surface():
    found = lengths(drawn((0, 3), (0.5, 3), (0.51, 8), (1, 0)))
    np.testing.assert_allclose(found.stalk + found.head, 10.5, rtol=1e-9)
    np.testing.assert_allclose(found.stalk, 5.5, atol=0.2)


@pytest.mark.parametrize("waist", [5.8, 6.0])
def test_hardly_a_neck_makes_no_stalk(waist):
    found = lengths(drawn((0, 6), (0.3, waist), (0.6, 6), (1, 0)))
    np.testing.assert_allclose([found.stalk, found.head], [0, 10.5], atol=1e-9)
