"""Sections through triangles against clipping."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.metrics.sections import diameters, share_above


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


def test_level_triangles_are_above_or_not():
    z = jnp.asarray([[1.0, 1, 1], [3, 3, 3]])
    np.testing.assert_allclose(share_above(z, jnp.asarray(2.0)), [0, 1], atol=1e-14)


def test_diameter_is_that_of_a_circle_and_none_is_nothing():
    area = jnp.asarray([np.pi, 0, -1])
    np.testing.assert_allclose(diameters(area), [2, 0, 0], rtol=1e-15)
