"""What is near to a few of many points is what is within a radius of one of them."""

import numpy as np
import pytest

from jaxgrow.neighbors.within_radius import may_coincide, near_seeds


def cloud(count, seed, size=10.0):
    return np.random.default_rng(seed).uniform(-size, size, (count, 3)) - [30, 0, 4]


@pytest.mark.parametrize("radius", [0.4, 2.0, 50.0])
@pytest.mark.parametrize("spread", [1e-3, 5.0, 9e3])  # far more cells than are made
def test_near_is_what_is_within_the_radius_of_a_seed(radius, spread):
    points = cloud(500, 0)
    points[:3] = [[1e9, 0, 0], [0, -1e150, 0], [-30, 0, -4]]
    seeds = cloud(40, 1, spread)
    seeds[:2] = points[5], points[6] + [radius, 0, 0]
    distance = np.linalg.norm(points[:, None] - seeds[None], axis=-1)
    off = np.abs(distance - radius).min(axis=1)
    near = near_seeds(points, seeds, radius)
    sure = off > 1e-9
    np.testing.assert_array_equal(near[sure], (distance <= radius).any(axis=1)[sure])
    assert near.any()


def test_nothing_is_near_nobody():
    points = cloud(20, 2)
    assert not near_seeds(points, points[:0], 3.0).any()
    assert near_seeds(None, points, 3.0).shape == (0,)


def test_points_of_32_bits_have_the_same_vicinity():
    points, seeds = cloud(300, 3).astype(np.float32), cloud(9, 4).astype(np.float32)
    wide = near_seeds(points.astype(float), seeds.astype(float), 4.0)
    np.testing.assert_array_equal(near_seeds(points, seeds, 4.0), wide)


@pytest.mark.parametrize("where", [(0, 1), (7, 298), (299, 150)])
def test_two_points_at_the_same_place_are_found(where):
    points, alive = cloud(300, 5), np.ones(300, bool)
    assert not may_coincide(points, alive)
    points[where[0]] = points[where[1]]
    assert may_coincide(points, alive)
    alive[where[1]] = False
    assert not may_coincide(points, alive)


def test_zero_has_no_sign_and_nan_is_at_no_place():
    points = np.array([[0.0, 1, -0.0], [-0.0, 1, 0.0], [np.nan, 0, 0], [np.nan, 0, 0]])
    alive = np.ones(4, bool)
    assert may_coincide(points, alive)
    assert not may_coincide(points[1:], alive[1:])
