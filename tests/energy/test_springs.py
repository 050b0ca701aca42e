"""The springs of the membrane."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.springs import edge_length, spring_energy
from jaxgrow.parameters import Parameters


energy = eqx.filter_jit(spring_energy)


def test_length_is_the_euclidean_one(scene):
    start, end = np.asarray(scene.membrane.vertices)[np.asarray(scene.membrane.edges).T]
    found = edge_length(scene.membrane)
    np.testing.assert_allclose(found, np.linalg.norm(end - start, axis=1), rtol=1e-15)


def test_padding_has_no_length(scene):
    dead = eqx.tree_at(
        lambda m: m.edge_alive,
        scene.membrane,
        scene.membrane.edge_alive.at[3].set(False),
    )
    assert edge_length(dead)[3] == 0


@pytest.mark.parametrize("pretension", [0.0, 0.1])
def test_energy_is_the_printed_sum(scene, pretension):
    length = np.asarray(edge_length(scene.membrane))
    rest = (1 - pretension) * np.asarray(scene.membrane.rest_length)
    parameters = Parameters(spring_stiffness=0.7, pretension=pretension)
    wanted = 0.5 * 0.7 * np.sum((length - rest) ** 2)
    np.testing.assert_allclose(energy(scene.membrane, parameters), wanted, rtol=1e-13)


def test_springs_at_rest_have_no_energy_without_pretension(scene):
    rest = edge_length(scene.membrane)
    membrane = eqx.tree_at(lambda m: m.rest_length, scene.membrane, rest)
    assert energy(membrane, Parameters(pretension=0.0)) < 1e-30


def test_pretension_of_a_spring_reset_is_proportional_to_its_length(scene):
    rest = edge_length(scene.membrane)
    membrane = eqx.tree_at(lambda m: m.rest_length, scene.membrane, rest)
    parameters = Parameters(spring_stiffness=0.5, pretension=0.2)

    def total(vertices):
        at = eqx.tree_at(lambda m: m.vertices, membrane, vertices)
        return spring_energy(at, parameters)

    force = -np.asarray(jax.jit(jax.grad(total))(membrane.vertices))
    vertices = np.asarray(membrane.vertices)
    wanted = np.zeros_like(vertices)
    for i, j in np.asarray(membrane.edges):
        wanted[i] += 0.5 * 0.2 * (vertices[j] - vertices[i])
        wanted[j] += 0.5 * 0.2 * (vertices[i] - vertices[j])
    np.testing.assert_allclose(force, wanted, atol=1e-13)


def test_derivative_in_stiffness_is_the_energy_over_it(scene):
    def total(stiffness):
        return spring_energy(scene.membrane, Parameters(spring_stiffness=stiffness))

    value, slope = jax.value_and_grad(total)(jnp.asarray(0.3))
    np.testing.assert_allclose(slope, value / 0.3, rtol=1e-14)
