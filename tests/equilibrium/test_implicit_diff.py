"""The derivative of an equilibrium: differences, and unrolled iterations."""

from dataclasses import fields

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium import implicit_diff as implicit
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.equilibrium.relax import relax
from jaxgrow.runtime.results import Result
from jaxgrow.state import replaced
from jaxgrow.transfer.device import reset_springs

from .derivatives import (
    backward,
    changed,
    flat,
    forward,
    PARAMETERS,
    rest,
    settled,
    stepped,
    still,
)


def difference(problem, tangent, step):
    """The central difference of the equilibria on either side, extrapolated to 0.

    The plain one at h and h/2 (Richardson): what is left is of the order h⁴.
    """

    def central(step):
        up, down = (
            flat(rest(stepped(problem, tangent, s), tolerance=1e-13))
            for s in (step, -step)
        )
        return (up - down) / (2 * step)

    return (4 * central(step / 2) - central(step)) / 3


def check(problem, tangent, step, rtol=1e-7):
    """The derivative along a tangent against differences of equilibria; its size."""
    found = forward(problem, tangent)
    size = np.linalg.norm(found)

    def error(step):
        return np.linalg.norm(difference(problem, tangent, step) - found) / size

    if not error(step) <= rtol:
        errors = [error(h) for h in (step, step / 2, step / 4)]
        raise AssertionError(f"errors at h, h/2, h/4: {errors}")
    return size


# central differences


@pytest.fixture(scope="module")
def polyp(make_particles, make_membrane, load):
    """Tissue and tumour under a pinned membrane that a load presses on them."""
    rng = np.random.default_rng(2)
    position = rng.uniform([-2.2, -2.2, -2.0], [2.2, 2.2, -0.5], (50, 3))
    particles = make_particles(
        position, position[:, 2] < -1.6, (np.arange(50) % 3 == 0).astype(int)
    )
    parameters = changed(
        tumour_stiffness=1.5, barrier_range=0.9, bending_stiffness=0.02
    )
    return settled(particles, make_membrane(), parameters, load(24, [0, 0.01, -0.6]))


OF_SHEETS = {
    "area_modulus": 0.02,
    "surface_tension": 0.02,
    "healthy_stiffness": 0.1,
    "membrane_modulus": 0.1,
    "kirchhoff_modulus": 0.1,
    "flowing_modulus": 0.1,
    "membrane_poisson": 0.3,
}
"""Parameters of the terms that a scene has only if it asks for them."""


@pytest.fixture(scope="module")
def sheet(make_membrane, load):
    """A membrane with every term, half of it healthy, under a load."""
    membrane = make_membrane()
    half = replaced(membrane, hyperplasia=0.5 * membrane.hyperplasia)
    parameters = changed(bending_stiffness=0.02, **OF_SHEETS)
    return settled(None, reset_springs(half), parameters, load(24, [0, 0.01, -0.06]))


@pytest.mark.parametrize("name", OF_SHEETS)
def test_derivative_in_a_parameter_of_sheets_is_that_of_differences(sheet, name):
    tangent = eqx.tree_at(
        lambda p: getattr(p.parameters, name), still(sheet), jnp.ones(())
    )
    assert check(sheet, tangent, 0.02 * OF_SHEETS[name]) > 1e-5


WITHOUT_EFFECT = (
    *("collision_range", "collision_stiffness", "daughter_offset", "focus_radius"),
)
IN_EFFECT = [
    field.name
    for field in fields(Parameters)
    if field.name not in (*WITHOUT_EFFECT, *OF_SHEETS)
]


@pytest.mark.parametrize("name", IN_EFFECT)
def test_derivative_in_a_parameter_is_that_of_differences(polyp, name):
    value = getattr(polyp.parameters, name)
    tangent = eqx.tree_at(
        lambda p: getattr(p.parameters, name), still(polyp), jnp.ones(())
    )
    assert check(polyp, tangent, 1e-4 * float(value)) > 1e-3


@pytest.mark.parametrize("name", WITHOUT_EFFECT)
def test_derivative_in_a_parameter_without_effect_is_zero(polyp, name):
    tangent = eqx.tree_at(
        lambda p: getattr(p.parameters, name), still(polyp), jnp.ones(())
    )
    assert not forward(polyp, tangent).any()


DIRECTIONS = {
    "rest_length": (
        lambda p: p.membrane.rest["springs"],
        lambda p: p.membrane.edge_alive[:, None],
    ),
    "load": (lambda p: p.load, lambda p: p.membrane.free[:, None]),
    "held": (
        lambda p: p.particles.position,
        lambda p: (p.particles.alive & p.particles.held)[:, None],
    ),
    "pinned": (
        lambda p: p.membrane.vertices,
        lambda p: (p.membrane.vertex_alive & p.membrane.pinned)[:, None],
    ),
}


def direction(problem, name, seed=0):
    """A random tangent of one of the leaves that have a derivative."""
    leaf, where = DIRECTIONS[name]
    shape = leaf(problem).shape
    some = jnp.asarray(np.random.default_rng(seed).normal(size=shape))
    return eqx.tree_at(leaf, still(problem), jnp.where(where(problem), some, 0))


@pytest.mark.parametrize("name", list(DIRECTIONS))
def test_derivative_in_an_array_is_that_of_differences(polyp, name):
    assert check(polyp, direction(polyp, name), 1e-5) > 1e-2


def test_where_free_nodes_started_from_has_no_derivative(polyp):
    free = polyp.free()
    tangent = eqx.tree_at(
        lambda p: (p.particles.position, p.membrane.vertices),
        still(polyp),
        (free.particles, free.vertices),
    )
    assert not forward(polyp, tangent).any()


def test_reverse_mode_is_the_transpose_of_forward_mode(polyp):
    rng = np.random.default_rng(3)
    tangent = jax.tree.map(
        lambda a: jnp.asarray(rng.normal(size=a.shape)) * 0.1, still(polyp)
    )
    weight = jax.tree.map(
        lambda a: jnp.asarray(rng.normal(size=a.shape)), polyp.nodes()
    )
    first = flat(weight) @ forward(polyp, tangent)
    pulled = ravel_pytree(eqx.filter(backward(polyp, weight), eqx.is_inexact_array))[0]
    second = np.asarray(pulled) @ np.asarray(ravel_pytree(tangent)[0])
    assert abs(first) > 1
    assert first == pytest.approx(second, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["collision_range", "collision_stiffness"])
def test_derivative_in_a_parameter_of_collisions(make_membrane, load, name):
    # a load presses the membrane on a static wall under it
    from jaxgrow.growth.collision_broad_phase import CollisionFinder
    from jaxgrow.mesh.collision_mesh import Walls

    corners = np.array([[-20.0, -20, -0.8], [40, -20, -0.8], [-20, 40, -0.8]])
    walls = Walls(corners, np.array([[0, 1, 2]]), np.array([100, 101, 102]))
    parameters, membrane = changed(spring_stiffness=0.3), make_membrane()
    collide = CollisionFinder.of(membrane, np.full(49, -1), walls, parameters)
    pressed = jnp.where(membrane.free[:, None], load(jnp.arange(49), [0, 0, -0.3]), 0)

    def height(value, start, tolerance=1e-12):
        varied = eqx.tree_at(lambda p: getattr(p, name), parameters, value)
        outcome = relax(
            None,
            start,
            parameters=varied,
            load=pressed,
            tolerance=tolerance,
            collide=collide,
        )
        assert outcome.result is Result.CONVERGED
        return outcome.state[1]

    value = getattr(parameters, name)
    start = height(value, membrane)
    assert -0.8 < start.vertices[24, 2] < -0.3
    found = float(jax.grad(lambda v: height(v, start).vertices[24, 2])(value))
    step = 1e-5
    ends = [float(height(value + s, start).vertices[24, 2]) for s in (step, -step)]
    assert abs(found) > 1e-3
    assert found == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-5)


# differentiating the iterations


@pytest.fixture(scope="module")
def trampoline(make_membrane, load):
    """A stiff membrane that a load pulls up."""
    parameters = changed(spring_stiffness=1.0)
    return settled(None, make_membrane(side=5), parameters, load(12, [0.1, 0, 0.5]))


def descended(problem, lists, rate, steps):
    """Where steepest descent of so many steps gets to."""
    free = problem.free()

    @jax.checkpoint
    def step(nodes, _):
        force = problem.forces(nodes, lists)
        return jax.tree.map(
            lambda x, f, on: x + rate * on * f, nodes, force, free
        ), None

    return jax.lax.scan(step, problem.nodes(), length=steps)[0]


@pytest.mark.parametrize("name, rate", [("cage", 0.4), ("trampoline", 0.2)])
def test_derivative_is_that_of_the_iterations(request, name, rate):
    problem = request.getfixturevalue(name)
    rng = np.random.default_rng(5)
    weight = jax.tree.map(
        lambda a: jnp.asarray(rng.normal(size=a.shape)), problem.nodes()
    )

    lists = allocate_lists(problem)

    def weighted(problem):
        end = descended(problem, lists, rate, 4000)
        products = jax.tree.map(lambda w, x: jnp.sum(w * x), weight, end)
        return sum(jax.tree.leaves(products))

    wanted = eqx.filter_jit(eqx.filter_grad(weighted))(problem)
    found = backward(problem, weight)
    names = [f.name for f in fields(Parameters)]
    for pick in [lambda p, n=n: getattr(p.parameters, n) for n in names] + [
        leaf
        for key, (leaf, _) in DIRECTIONS.items()
        if (key == "held") == (name == "cage")
    ]:
        one, other = np.asarray(pick(found)), np.asarray(pick(wanted))
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-8)
    assert abs(found.parameters.pretension + found.parameters.adhesion) > 1e-3


# what it is made of


@pytest.mark.parametrize("name", ["_forward", "_backward"])
def test_no_callback_is_in_the_program(polyp, name):
    known = implicit._Known(polyp, allocate_lists(polyp), jnp.ones((), bool))
    vector = implicit._floats(polyp)
    if name == "_backward":
        vector = implicit.Equilibrium(polyp.nodes(), polyp.nodes())
    program = str(
        jax.make_jaxpr(getattr(implicit, name))(known, implicit._flat(vector))
    )
    assert "while" in program
    assert "callback" not in program
    assert "infeed" not in program


def test_values_are_those_without_a_derivative(cage):
    tangent = still(cage)
    value, _ = eqx.filter_jvp(rest, (cage,), (tangent,))
    plain = rest(cage, tolerance=1e-10)
    np.testing.assert_array_equal(value.particles, plain.particles)


def test_tolerance_is_tight_while_a_derivative_is_taken(cluster):
    def loose(adhesion):
        varied = eqx.tree_at(lambda p: p.adhesion, PARAMETERS, adhesion)
        seen.append(relax(cluster, parameters=varied, tolerance=1e-2).stats.residual)
        return adhesion

    seen = []
    jax.grad(loose)(jnp.asarray(0.2))
    loose(jnp.asarray(0.2))
    assert seen[0] <= 1e-10
    assert seen[1] > 1e-6
