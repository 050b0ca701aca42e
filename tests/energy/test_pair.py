"""The pair energy and its hand-written derivatives, against dense sums."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxgrow.energy.a2 import A2
from jaxgrow.energy.pair import pair_energy, pair_force
from jaxgrow.energy.parameters import Parameters
from jaxgrow.state import Particles


COUNT = 16
PARAMETERS = jax.tree.map(jnp.asarray, Parameters(adhesion=0.3, tumour_stiffness=2.0))


def with_values(adhesion, smoothing, stiffness):
    new = [jnp.asarray(v) for v in (adhesion, smoothing, stiffness)]
    return eqx.tree_at(
        lambda p: [p.adhesion, p.smoothing, p.tumour_stiffness], PARAMETERS, new
    )


@pytest.fixture(scope="module")
def cluster():
    """16 slots, the last two dead, half of the living tumour."""
    rng = np.random.default_rng(3)
    position = rng.uniform(0, 2, (COUNT, 3))
    return Particles(
        jnp.asarray(position),
        jnp.asarray(np.arange(COUNT) % 2),
        jnp.arange(COUNT) < COUNT - 2,
        jnp.zeros(COUNT, bool),
    )


@pytest.fixture(scope="module")
def listed():
    """All pairs from both sides, one empty slot, neighbour-major."""
    index = np.arange(COUNT)
    full = (index[None, :] + index[1:, None]) % COUNT
    return jnp.asarray(np.concatenate([full, np.full((1, COUNT), COUNT)]))


def plain_sum(position, particles, parameters):
    """Σ over i < j, written as the formula and differentiated by jax."""
    first, second = np.triu_indices(COUNT, 1)
    gap = position[first] - position[second]
    length = jnp.sqrt(jnp.sum(gap**2, axis=1))
    tumour = particles.species == 1
    both = tumour[first] & tumour[second]
    stiffness = jnp.where(both, parameters.tumour_stiffness, 1)
    alive = particles.alive
    law = A2(parameters.adhesion, parameters.smoothing)
    value = jnp.where(alive[first] & alive[second], stiffness * law.energy(length), 0)
    return jnp.sum(value)


def by_rule(position, particles, listed, parameters):
    at = eqx.tree_at(lambda p: p.position, particles, position)
    return pair_energy(at, listed, parameters)


plain = eqx.filter_jit(jax.value_and_grad(plain_sum, argnums=(0, 2)))
ruled = eqx.filter_jit(jax.value_and_grad(by_rule, argnums=(0, 3)))


@pytest.mark.parametrize(
    "values", [(0.3, 0.1, 2.0), (0.0, 0.1, 1.0), (0.2, 0.0, 1.0), (0.4, 0.3, 0.5)]
)
def test_energy_and_gradient_are_those_of_the_plain_sum(cluster, listed, values):
    parameters = with_values(*values)
    wanted, slope = plain(cluster.position, cluster, parameters)
    found, same = ruled(cluster.position, cluster, listed, parameters)
    np.testing.assert_allclose(found, wanted, rtol=1e-13)
    np.testing.assert_allclose(same[0], slope[0], atol=1e-12)


@pytest.mark.parametrize("name", ["adhesion", "smoothing", "tumour_stiffness"])
def test_derivative_in_a_parameter_is_that_of_the_plain_sum(cluster, listed, name):
    _, slope = plain(cluster.position, cluster, PARAMETERS)
    _, same = ruled(cluster.position, cluster, listed, PARAMETERS)
    wanted, found = getattr(slope[1], name), getattr(same[1], name)
    assert abs(wanted) > 1e-2
    np.testing.assert_allclose(found, wanted, rtol=1e-11)


def test_force_is_minus_the_gradient(cluster, listed):
    _, slope = plain(cluster.position, cluster, PARAMETERS)
    force = jax.jit(pair_force)(cluster, listed, PARAMETERS)
    np.testing.assert_allclose(force, -slope[0], atol=1e-12)


def test_hessian_is_that_of_the_plain_sum(cluster, listed):
    hessian = jax.jit(jax.jacfwd(jax.grad(by_rule)))
    wanted = jax.jit(jax.hessian(lambda x: plain_sum(x, cluster, PARAMETERS)))
    np.testing.assert_allclose(
        hessian(cluster.position, cluster, listed, PARAMETERS),
        wanted(cluster.position),
        atol=1e-11,
    )


def test_force_depends_on_a_parameter_as_the_plain_sum_does(cluster, listed):
    def mixed(energy):
        def force(adhesion):
            parameters = with_values(adhesion, 0.1, 2.0)
            return jax.grad(lambda x: energy(x, parameters))(cluster.position)

        return jax.jit(jax.jacfwd(force))(jnp.asarray(0.3))

    found = mixed(lambda x, p: by_rule(x, cluster, listed, p))
    wanted = mixed(lambda x, p: plain_sum(x, cluster, p))
    assert np.abs(wanted).max() > 0.01
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_derivative_rule_is_consistent_forward_and_reverse(cluster, listed):
    energy = jax.jit(lambda x, s: by_rule(x, cluster, listed, with_values(0.3, 0.1, s)))
    where = (cluster.position, jnp.asarray(2.0))
    check_grads(energy, where, order=1, atol=1e-6, rtol=1e-6, eps=1e-6)


def test_printed_force_is_that_of_the_dense_sum(cluster, listed):
    parameters = with_values(0.35, 0.0, 1.0)
    position = np.asarray(cluster.position)[:-2]
    gap = position[:, None] - position[None]
    u = np.linalg.norm(gap, axis=2) + np.eye(len(gap))
    force = np.where(u < 0.5, 1 - u**2, (1 - u) * (2 - u) / 2)
    force = np.where(u > 1, 0.35 * force, force) * (u <= 1.5) / u
    wanted = np.einsum("ij,ijk->ik", force, gap)
    found = jax.jit(pair_force)(cluster, listed, parameters)
    np.testing.assert_allclose(found[:-2], wanted, atol=1e-12)


def test_stiffness_is_that_of_two_tumour_particles_only(listed):
    def pair_of(first, second):
        species = jnp.zeros(COUNT, int).at[:2].set(jnp.asarray([first, second]))
        position = jnp.zeros((COUNT, 3)).at[1, 0].set(0.8)
        alive = jnp.arange(COUNT) < 2
        return Particles(position, species, alive, jnp.zeros(COUNT, bool))

    energy = jax.jit(pair_energy)
    parameters = with_values(0.2, 0.1, 3.0)
    tissue, mixed, tumour = (
        energy(pair_of(*kinds), listed, parameters)
        for kinds in [(0, 0), (0, 1), (1, 1)]
    )
    np.testing.assert_allclose([mixed, tumour], [tissue, 3 * tissue], rtol=1e-14)


def test_two_particles_at_one_point_exert_no_force(listed):
    alive = jnp.arange(COUNT) < 2
    still = jnp.zeros(COUNT, bool)
    both = Particles(jnp.ones((COUNT, 3)), jnp.zeros(COUNT, int), alive, still)
    force = jax.jit(pair_force)(both, listed, PARAMETERS)
    assert not np.any(force)
