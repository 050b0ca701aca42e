"""A membrane alone comes to rest where closed forms and a direct solver say."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse import lil_array
from scipy.sparse.linalg import spsolve

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.relax import relax
from jaxgrow.runtime.results import Result

from .springs import springs


@pytest.mark.parametrize("pretension", [0.0, 0.1])
def test_loaded_chain_stretches_by_force_over_stiffness(load, pretension):
    count, stiffness, pull = 6, 0.5, 0.2
    vertices = np.zeros((count, 3))
    vertices[:, 0] = np.arange(count) + 0.05 * np.sin(np.arange(count))
    edges = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    rest = np.linspace(0.8, 1.2, count - 1)
    chain = springs(vertices, edges, rest, np.arange(count) == 0)
    outcome = relax(
        None,
        chain,
        parameters=Parameters(
            spring_stiffness=jnp.asarray(stiffness), pretension=jnp.asarray(pretension)
        ),
        tolerance=1e-9,
        load=load(count - 1, [pull, 0, 0]),
    )
    assert outcome.result is Result.CONVERGED
    lengths = (1 - pretension) * rest + pull / stiffness
    found = np.asarray(outcome.state[1].vertices)[:count]
    wanted = np.zeros((count, 3))
    wanted[1:, 0] = np.cumsum(lengths)
    np.testing.assert_allclose(found, wanted, atol=1e-7)


def test_hub_on_spokes_sags_to_the_closed_form(load):
    spokes, stiffness, depth = 8, 0.3, 0.75
    angle = 2 * np.pi * np.arange(spokes) / spokes
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vertices = np.concatenate([[[0.0, 0.0, 0.01]], rim])
    edges = np.stack([np.zeros(spokes, int), np.arange(1, spokes + 1)], axis=1)
    hub = springs(vertices, edges, 1.0, np.arange(spokes + 1) > 0)
    length = np.hypot(1, depth)
    force = spokes * stiffness * (length - 0.9) * depth / length
    parameters = Parameters(
        spring_stiffness=jnp.asarray(stiffness), pretension=jnp.asarray(0.1)
    )
    outcome = relax(
        None, hub, parameters=parameters, tolerance=1e-9, load=load(0, [0, 0, force])
    )
    assert outcome.result is Result.CONVERGED
    np.testing.assert_allclose(outcome.state[1].vertices[0], [0, 0, depth], atol=1e-7)


def test_membrane_under_a_small_load_solves_the_discrete_laplace_equation(
    make_membrane, load
):
    membrane = make_membrane()
    force = 1e-4
    parameters = Parameters(bending_stiffness=0.0)
    outcome = relax(
        None,
        membrane,
        parameters=parameters,
        tolerance=1e-10,
        load=load(24, [0, 0, force]),
    )
    assert outcome.result is Result.CONVERGED

    matrix = lil_array((49, 49))
    for (i, j), alive in zip(
        np.asarray(membrane.edges), np.asarray(membrane.edge_alive), strict=True
    ):
        if alive:
            for a, b in ((i, j), (j, i)):
                matrix[a, a] += 1
                matrix[a, b] -= 1
    free = np.flatnonzero(np.asarray(membrane.free))
    # every edge just reset pulls with k τ per length
    pull = np.where(free == 24, force, 0.0)
    inner = matrix.tocsr()[free][:, free]
    wanted = spsolve(inner * parameters.spring_stiffness * parameters.pretension, pull)
    found = np.asarray(outcome.state[1].vertices)[free, 2]
    assert found.max() > 1e-4
    np.testing.assert_allclose(found, wanted, rtol=1e-3, atol=1e-9)


def test_membrane_just_reset_rests_flat_without_load(make_membrane):
    membrane = make_membrane()
    outcome = relax(None, membrane, tolerance=1e-9)
    assert outcome.result is Result.CONVERGED
    assert not np.any(np.asarray(outcome.state[1].vertices)[:, 2])


@pytest.mark.parametrize("method", ["lbfgs", "fire"])
def test_membrane_alone_comes_to_rest_with_its_rim_in_place(
    make_membrane, load, method
):
    membrane = make_membrane()
    outcome = relax(
        None, membrane, tolerance=1e-8, method=method, load=load(24, [0, 0, 0.05])
    )
    assert outcome.result is Result.CONVERGED
    still = ~np.asarray(membrane.free)
    np.testing.assert_array_equal(
        outcome.state[1].vertices[still], membrane.vertices[still]
    )
    assert outcome.state[1].vertices[24, 2] > 0.05
