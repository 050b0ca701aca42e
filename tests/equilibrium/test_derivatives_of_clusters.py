"""The derivative of a free cluster, which has rigid modes and may be in 32 bits."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.state import Nodes

from .derivatives import backward, changed, flat, forward, rest, settled, still


@pytest.fixture(scope="module")
def drop(make_particles):
    rng = np.random.default_rng(1)
    particles = make_particles(rng.uniform(0, 3, (27, 3)), None, np.arange(27) % 2)
    return settled(particles, parameters=changed(tumour_stiffness=1.5))


def radius_of_gyration(position):
    away = position[:27] - jnp.mean(position[:27], axis=0, keepdims=True)
    return jnp.sqrt(jnp.mean(jnp.sum(away**2, axis=1)))


@pytest.mark.parametrize("name", ["adhesion", "tumour_stiffness"])
def test_size_of_a_free_cluster_has_the_derivative_of_differences(drop, name):
    def size(value):
        varied = eqx.tree_at(lambda p: getattr(p.parameters, name), drop, value)
        return radius_of_gyration(rest(varied, tolerance=1e-12).particles)

    value = getattr(drop.parameters, name)
    step = 3e-5 * float(value)
    wanted = (size(value + step) - size(value - step)) / (2 * step)
    assert abs(wanted) > 1e-3
    assert jax.grad(size)(value) == pytest.approx(float(wanted), rel=1e-6)
    _, found = jax.jvp(size, (value,), (jnp.ones(()),))
    assert found == pytest.approx(float(wanted), rel=1e-6)


def test_free_cluster_as_a_whole_stays(drop):
    tangent = eqx.tree_at(lambda p: p.parameters.adhesion, still(drop), jnp.ones(()))
    moved = forward(drop, tangent).reshape(-1, 3)[:27]
    arm = np.asarray(drop.particles.position[:27])
    assert np.abs(moved).max() > 0.1
    np.testing.assert_allclose(moved.sum(axis=0), 0, atol=1e-10)
    np.testing.assert_allclose(np.cross(arm, moved).sum(axis=0), 0, atol=1e-10)


def test_centre_of_a_free_cluster_depends_on_nothing(drop):
    weight = Nodes(jnp.zeros((64, 3)).at[:27, 0].set(1.0), None)
    pulled = backward(drop, weight)
    np.testing.assert_allclose(flat(pulled.parameters), 0, atol=1e-10)


def test_single_precision_is_kept(drop):
    narrow = jax.tree.map(
        lambda a: a.astype(jnp.float32) if eqx.is_inexact_array(a) else a, drop
    )

    def size(value, problem):
        varied = eqx.tree_at(lambda p: p.parameters.adhesion, problem, value)
        return radius_of_gyration(rest(varied).particles)

    wanted = jax.grad(size)(drop.parameters.adhesion, drop)
    found = jax.grad(size)(narrow.parameters.adhesion, narrow)
    assert found.dtype == jnp.float32
    assert float(found) == pytest.approx(float(wanted), rel=1e-2)
