"""The springs of the membrane."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.parameters import Parameters
from jaxgrow.energy.springs import Springs
from jaxgrow.energy.term import energy_of_elements


def total(membrane, parameters):
    elements = Springs().elements(None, membrane)
    return energy_of_elements(Springs(), membrane.vertices, elements, parameters)


energy = eqx.filter_jit(total)


def length_of(membrane):
    start, end = np.asarray(membrane.vertices)[np.asarray(membrane.edges).T]
    return np.linalg.norm(end - start, axis=1)


def at_rest(membrane):
    return membrane.with_rest({"springs": Springs().at_rest(membrane)})


def test_length_at_rest_is_the_euclidean_one(scene):
    found = at_rest(scene.membrane).rest_length
    np.testing.assert_allclose(found, length_of(scene.membrane), rtol=1e-15)


def test_padding_has_no_rest_length(scene):
    alive = scene.membrane.edge_alive.at[3].set(False)
    dead = eqx.tree_at(lambda m: m.edge_alive, scene.membrane, alive)
    assert Springs().at_rest(dead)[3] == 0


@pytest.mark.parametrize("pretension", [0.0, 0.1])
def test_energy_is_the_printed_sum(scene, pretension):
    rest = (1 - pretension) * np.asarray(scene.membrane.rest_length)
    parameters = Parameters(spring_stiffness=0.7, pretension=pretension)
    wanted = 0.5 * 0.7 * np.sum((length_of(scene.membrane) - rest) ** 2)
    np.testing.assert_allclose(energy(scene.membrane, parameters), wanted, rtol=1e-13)


def test_springs_at_rest_have_no_energy_without_pretension(scene):
    assert energy(at_rest(scene.membrane), Parameters(pretension=0.0)) < 1e-30


def test_pretension_of_a_spring_reset_is_proportional_to_its_length(scene):
    membrane = at_rest(scene.membrane)
    parameters = Parameters(spring_stiffness=0.5, pretension=0.2)
    slope = jax.jit(jax.grad(lambda x: total(membrane.at(x), parameters)))
    force = -np.asarray(slope(membrane.vertices))
    vertices = np.asarray(membrane.vertices)
    wanted = np.zeros_like(vertices)
    for i, j in np.asarray(membrane.edges):
        wanted[i] += 0.5 * 0.2 * (vertices[j] - vertices[i])
        wanted[j] += 0.5 * 0.2 * (vertices[i] - vertices[j])
    np.testing.assert_allclose(force, wanted, atol=1e-13)


def test_derivative_in_stiffness_is_the_energy_over_it(scene):
    def of(stiffness):
        return total(scene.membrane, Parameters(spring_stiffness=stiffness))

    value, slope = jax.value_and_grad(of)(jnp.asarray(0.3))
    np.testing.assert_allclose(slope, value / 0.3, rtol=1e-14)
