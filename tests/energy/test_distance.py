"""Point to triangle: exact, and twice differentiable through the closest point."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.distance import (
    closest_weights,
    point_triangle_distance,
    split,
    split_corners,
)
from jaxgrow.mesh.proximity import closest_on_triangles

from ..quick_jit import quick_jit


distances = jax.jit(point_triangle_distance)


@jax.jit
def weights(point, corners):
    weights = closest_weights(split(point), *split_corners(corners))
    return jnp.stack(weights, axis=-1)


PAIRS = 4000


def random_pairs(seed):
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(PAIRS, 3, 3))
    return 1.5 * rng.normal(size=(PAIRS, 3)), corners


def needles(corners):
    """The first half of the triangles on one line or point each, exactly."""
    half = PAIRS // 2
    corners = np.round(4 * corners) / 4
    along = np.array([0.0, 1.0, 0.5])
    order = np.argsort(np.random.default_rng(8).random((half, 3)), axis=1)
    start, end = corners[:half, 0], corners[:half, 1]
    line = start[:, None] + along[order][..., None] * (end - start)[:, None]
    line[:50] = start[:50, None]  # all corners at one point
    line[50:100, 2] = line[50:100, 1]  # two corners at one point
    return np.concatenate([line, corners[half:]])


def test_distance_is_that_of_the_host():
    point, corners = random_pairs(0)
    wanted, _ = closest_on_triangles(point, corners)
    found = distances(jnp.asarray(point), jnp.asarray(corners))
    np.testing.assert_allclose(found, wanted, atol=1e-14)


def test_distance_to_a_triangle_without_area_is_that_to_its_edges():
    point, corners = random_pairs(1)
    corners = needles(corners)
    wanted, _ = closest_on_triangles(point, corners)
    found = distances(jnp.asarray(point), jnp.asarray(corners))
    np.testing.assert_allclose(found, wanted, atol=1e-13)


def test_distance_to_a_sliver_is_close_to_that_of_the_host():
    point, corners = random_pairs(2)
    rng = np.random.default_rng(3)
    thin = 10.0 ** rng.uniform(-9, -2, PAIRS)
    middle = corners[:, 0] + rng.random(PAIRS)[:, None] * (
        corners[:, 1] - corners[:, 0]
    )
    corners[:, 2] = middle + thin[:, None] * corners[:, 2]
    wanted, _ = closest_on_triangles(point, corners)
    found = distances(jnp.asarray(point), jnp.asarray(corners))
    np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_weights_are_barycentric():
    point, corners = random_pairs(4)
    found = np.asarray(weights(jnp.asarray(point), jnp.asarray(needles(corners))))
    np.testing.assert_allclose(found.sum(axis=1), 1, atol=1e-12)
    assert found.min() >= -1e-12


def test_every_region_of_the_triangle_is_met():
    found = np.asarray(weights(*map(jnp.asarray, random_pairs(0))))
    pattern = (found > 1e-12) @ np.array([4, 2, 1])
    assert set(pattern) == set(range(1, 8))  # three corners, three edges, the face


def pieces():
    """One pair per region, away from the region's border."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0.2], [0.2, 1.1, 0]])
    points = {
        "face": [0.35, 0.3, 0.6],
        "edge": [0.5, -0.4, 0.3],
        "corner": [1.6, -0.3, 0.5],
        "near": [0.35, 0.3, 0.13],
    }
    return {name: (np.array(point), corners) for name, point in points.items()}


def packed(x):
    return point_triangle_distance(x[0], x[1:])


distance = quick_jit(packed)
gradient = quick_jit(jax.grad(packed))
hessian = quick_jit(jax.jacfwd(jax.grad(packed)))


@pytest.mark.parametrize("region", list(pieces()))
def test_gradient_is_that_of_differences(region):
    point, corners = pieces()[region]
    x, h = np.concatenate([point[None], corners]), 1e-6
    wanted = np.zeros((4, 3))
    for index in np.ndindex(4, 3):
        step = np.zeros((4, 3))
        step[index] = h
        up, down = distance(jnp.asarray(x + step)), distance(jnp.asarray(x - step))
        wanted[index] = (up - down) / (2 * h)
    np.testing.assert_allclose(gradient(jnp.asarray(x)), wanted, atol=1e-8)


@pytest.mark.parametrize("region", list(pieces()))
def test_hessian_is_that_of_differences_of_the_gradient(region):
    # a gradient stopped at the closest point leaves forces right and this wrong
    point, corners = pieces()[region]
    x, h = np.concatenate([point[None], corners]), 1e-6
    wanted = np.zeros((4, 3, 4, 3))
    for index in np.ndindex(4, 3):
        step = np.zeros((4, 3))
        step[index] = h
        up, down = gradient(jnp.asarray(x + step)), gradient(jnp.asarray(x - step))
        wanted[(..., *index)] = (up - down) / (2 * h)
    found = np.asarray(hessian(jnp.asarray(x)))
    np.testing.assert_allclose(found, wanted, atol=1e-7)
    np.testing.assert_allclose(found, found.transpose(2, 3, 0, 1), atol=1e-12)
    assert np.abs(found).max() > 0.3


@pytest.mark.parametrize(
    "corners",
    [np.zeros((3, 3)), np.eye(3) * 0 + np.arange(3)[:, None] * np.array([1.0, 0, 0])],
    ids=["point", "segment"],
)
@pytest.mark.parametrize("point", [np.zeros(3), np.array([0.3, 0.4, 0.0])])
def test_degenerate_triangles_have_finite_derivatives(point, corners):
    x = jnp.asarray(np.concatenate([point[None], corners]))
    assert np.isfinite(packed(x))
    assert np.isfinite(gradient(x)).all()
    assert np.isfinite(hessian(x)).all()


def test_gradient_has_length_one_and_forces_balance():
    point, corners = random_pairs(6)
    slope = jax.jit(
        jax.grad(lambda p, c: jnp.sum(point_triangle_distance(p, c)), (0, 1))
    )
    at_point, at_corners = slope(jnp.asarray(point), jnp.asarray(corners))
    np.testing.assert_allclose(np.linalg.norm(at_point, axis=1), 1, rtol=1e-13)
    np.testing.assert_allclose(at_point + at_corners.sum(axis=1), 0, atol=1e-13)
