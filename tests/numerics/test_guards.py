"""Guards stay finite, in value and in derivative, at the singularity they are for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.numerics.guards import farthest_two, safe_divide, safe_norm


def test_norm_is_the_euclidean_length():
    vectors = np.random.default_rng(0).normal(size=(20, 3))
    found = safe_norm(jnp.asarray(vectors))
    np.testing.assert_allclose(found, np.linalg.norm(vectors, axis=1), rtol=1e-15)


def test_norm_of_the_null_vector_has_gradient_zero_and_not_nan():
    null = jnp.zeros(3)
    assert safe_norm(null) == 0
    np.testing.assert_array_equal(jax.grad(safe_norm)(null), np.zeros(3))
    assert np.isfinite(jax.hessian(safe_norm)(null)).all()


def test_norm_of_what_is_not_finite_is_not_finite():
    # a length of 0 would pass for an equilibrium
    broken = jnp.asarray([[jnp.nan, 0.0, 0.0], [0.0, jnp.inf, 0.0]])
    assert not np.any(np.isfinite(safe_norm(broken)))


def test_division_is_zero_with_finite_derivatives_where_it_is_excluded():
    def ratio(x):
        return jnp.sum(safe_divide(jnp.ones(2), x, x > 0))

    x = jnp.array([0.0, 2.0])
    assert ratio(x) == 0.5
    np.testing.assert_allclose(jax.grad(ratio)(x), [0, -0.25])


@pytest.mark.parametrize(
    "lengths, total",
    [
        ([3, 1, 4, 1, 5], 9),
        ([2, 5, 5, 1], 10),
        ([5, 5, 5], 10),
        ([0, 0], 0),
        ([0, 3], 3),
        ([3], 3),
        ([1, np.nan, 2], np.nan),
        ([1, np.inf], np.inf),
        ([np.inf, np.inf], np.inf),
    ],
)
def test_two_longest_moves_are_added(lengths, total):
    moved = np.zeros((len(lengths), 3))
    moved[:, 2] = lengths
    np.testing.assert_allclose(farthest_two(jnp.asarray(moved)), total, rtol=1e-14)
