"""Loops that are printed from an energy compute what XLA does: every term, one test."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.contact import list_contacts, reach
from jaxgrow.energy.terms import MEMBRANE_TERMS
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.loops import blocks, with_loops
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.products import hessian_product
from jaxgrow.neighbors.verlet_list import Neighbors

from ..quick_jit import quick_jit
from .conftest import all_pairs, CONTACTS, COUNT, dense_list, PARAMETERS
from .test_conformance import coincidences, padded


# all of one shape, so that each term is compiled once


def plain(scene, _):
    return scene.particles, scene.membrane


def with_padding(scene, small):
    """Dead slots of everything with garbage in them, among them triangles and edges."""
    return padded(small, 3, like=scene)


def degenerate(scene, _):
    return coincidences(scene)


SCENES = {"random": plain, "padding": with_padding, "degenerate": degenerate}
TERMS = ["pair", *(term.name for term in MEMBRANE_TERMS), "contact", "collision"]
SINGULAR = ["contact", "collision", "bending", "area", "tension"]  # where degenerate


def problem_of(term, particles, membrane):
    """A problem that has the term alone, and its lists."""
    parameters = jax.tree.map(lambda v: jnp.asarray(v, float), PARAMETERS)
    known = {own.name: (own,) for own in MEMBRANE_TERMS}
    terms = known.get(term, ())
    lists = Lists(None, None)
    if term == "pair":
        count = particles.position.shape[0]
        listed = dense_list(count).astype(jnp.int32)
        no = jnp.zeros((), bool)
        lists = Lists(Neighbors(listed, particles.position, no, None), None)
        membrane = None
    elif term == "contact":
        found = list_contacts(particles, membrane, reach(parameters), CONTACTS)
        assert not bool(found.overflow)
        lists = Lists(None, found)
    else:
        particles = None
    if term == "collision":
        lists = lists.with_collisions(quick_jit(all_pairs)(membrane))
    return Problem(particles, membrane, parameters, terms=terms), lists


def values(problem, lists, along):
    """Forces, bounds of a step, and a Hessian product."""
    nodes = problem.nodes()
    both = problem.forces_and_bound(nodes, lists, 0.1)
    return *both, hessian_product(problem, nodes, lists)(along)


@quick_jit
def reference(problem, lists, along):
    """The same without loops, forces by the derivative of the energy."""
    force = jax.grad(lambda nodes: -problem.energy(nodes, lists))(problem.nodes())
    return force, *values(problem, lists, along)[1:]


evaluated = eqx.filter_jit(values)


def close(found, wanted, within=1e-12):
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        size = max(1.0, float(jnp.abs(b).max()))
        np.testing.assert_allclose(a, b, atol=within * size)


def seen(problem, nodes):
    """Rows of what is alive: what padding would feel nobody asks for."""
    free = problem.free()
    return jax.tree.map(
        lambda rows, on: rows * (on if rows.ndim == 2 else on[:, 0]), nodes, free
    )


@pytest.fixture(scope="module", params=TERMS)
def term(request):
    return request.param


@pytest.fixture(scope="module")
def make(scene, small, term):
    def problem(kind):
        problem, lists = problem_of(term, *SCENES[kind](scene, small))
        looped = with_loops(problem, lists, products=True)
        assert looped.loops is not None
        assert looped.loops.names == (term,)
        assert looped.is_looped(lists)
        return problem, looped, lists

    return problem


@pytest.fixture(scope="module", params=SCENES)
def kind(request):
    return request.param


def way_of(problem):
    rng = np.random.default_rng(8)
    return jax.tree.map(
        lambda x: jnp.asarray(rng.normal(size=x.shape)), problem.nodes()
    )


def test_forces_are_minus_the_derivative_of_the_energy(make, kind, term):
    problem, looped, lists = make(kind)
    along = way_of(problem)
    force = seen(problem, evaluated(looped, lists, along)[0])
    if kind == "degenerate" and term == "contact":
        # a particle on the surface: the direction of its force is that of rounding
        assert all(bool(jnp.isfinite(f).all()) for f in jax.tree.leaves(force))
        return
    close(force, seen(problem, reference(problem, lists, along)[0]))
    size = max(float(jnp.abs(f).max()) for f in jax.tree.leaves(force))
    assert size > 0.01


def test_bounds_of_a_step_are_those_of_xla(make, kind):
    problem, looped, lists = make(kind)
    along = way_of(problem)
    found = evaluated(looped, lists, along)[1]
    wanted = reference(problem, lists, along)[1]
    close(seen(problem, found), seen(problem, wanted))


def test_hessian_products_are_derivatives_of_the_forces(make, kind, term):
    problem, looped, lists = make(kind)
    along = way_of(problem)
    found = evaluated(looped, lists, seen(problem, along))[2]
    if kind == "degenerate" and term in SINGULAR:
        return  # the second derivative is singular there
    wanted = reference(problem, lists, seen(problem, along))[2]
    close(seen(problem, found), seen(problem, wanted), 1e-11)


@quick_jit
def reference_blocks(problem, lists):
    """The diagonal blocks of the second derivative of the energy."""
    leaves, structure = jax.tree.flatten(problem.nodes())
    rows = jnp.concatenate(leaves)
    places = np.cumsum([len(leaf) for leaf in leaves])[:-1]

    def slope(block, i):
        at = rows.at[i].add(block)
        nodes = jax.tree.unflatten(structure, jnp.split(at, places))
        return jnp.concatenate(
            jax.tree.leaves(jax.grad(lambda n: problem.energy(n, lists))(nodes))
        )[i]

    each = jax.vmap(jax.jacfwd(slope), (None, 0))
    return each(jnp.zeros(3), jnp.arange(len(rows)))


found_blocks = eqx.filter_jit(blocks)


def test_diagonal_blocks_are_those_of_the_second_derivative(make, kind, term):
    problem, looped, lists = make(kind)
    if kind == "degenerate" and term in SINGULAR:
        return  # the second derivative is singular there
    alive = np.concatenate(jax.tree.leaves(problem.free()))[:, 0] > 0
    found = found_blocks(looped, lists)[: len(alive)].reshape(-1, 3, 3)[alive]
    wanted = reference_blocks(problem, lists)[alive]
    size = float(jnp.linalg.norm(wanted))
    assert size > 0.1
    error = float(jnp.linalg.norm(found - wanted))
    # of contact and of collisions the stiff direction of each pair is enough
    assert error < {"contact": 0.3, "collision": 0.85}.get(term, 1e-11) * size


def test_hessian_is_symmetric(make):
    problem, looped, lists = make("random")
    rng = np.random.default_rng(2)
    one, other = (
        jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape)), problem.nodes())
        for _ in range(2)
    )

    def dot(a, b):
        return sum(
            jnp.vdot(x, y) for x, y in zip(*map(jax.tree.leaves, (a, b)), strict=True)
        )

    first = dot(other, evaluated(looped, lists, one)[2])
    second = dot(one, evaluated(looped, lists, other)[2])
    np.testing.assert_allclose(first, second, rtol=1e-11)
    assert abs(float(first)) > 1e-3


def test_position_that_is_not_a_number_makes_forces_that_are_none(make, term):
    if term in ("contact", "collision"):
        return  # each node feels another term as well, which tells
    problem, looped, lists = make("random")
    field = "vertices" if problem.particles is None else "particles"
    rows = getattr(problem.nodes(), field).at[COUNT // 2, 1].set(jnp.nan)
    bad = eqx.tree_at(lambda n: getattr(n, field), problem.nodes(), rows)
    force = looped.at(bad).forces(bad, lists)
    assert not all(bool(jnp.isfinite(f).all()) for f in jax.tree.leaves(force))
