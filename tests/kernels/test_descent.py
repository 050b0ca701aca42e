"""The loop of a descent makes the steps of the program, and stops where it does."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.contact import contact_distances, reach
from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.descent import descend
from jaxgrow.equilibrium.lbfgs import LBFGS
from jaxgrow.equilibrium.loops import with_loops
from jaxgrow.equilibrium.native_descent import descend_by_loop
from jaxgrow.equilibrium.native_lists import is_looped
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists, prepared
from jaxgrow.equilibrium.relax import relax
from jaxgrow.growth.collision_broad_phase import CollisionFinder
from jaxgrow.kernels.refusals import Refusal
from jaxgrow.mesh.surface import Surface
from jaxgrow.runtime.results import Result
from jaxgrow.state import Nodes, Particles
from jaxgrow.transfer.device import parked, put_membrane


SLOTS = 160
LARGEST = 0.1


def grid(side, spacing, height):
    """A square sheet over the origin, its rim pinned."""
    line = spacing * (np.arange(side) - (side - 1) / 2)
    x, y = np.meshgrid(line, line)
    vertices = np.stack([x, y, np.full_like(x, height)], axis=-1).reshape(-1, 3)
    index = np.arange(side * side).reshape(side, side)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    rim = np.zeros(side * side, bool)
    rim[np.concatenate([index[0], index[-1], index[:, 0], index[:, -1]])] = True
    return vertices, faces, rim


def two_sheets(gap):
    """Two sheets, one above the other, in one surface; the lower one is crumpled."""
    rng = np.random.default_rng(7)
    low, faces, rim = grid(9, 0.7, 0.0)
    low = low + np.where(rim[:, None], 0.0, 0.08 * rng.normal(size=low.shape))
    high = low * [1, 1, 0] + [0.2, 0.13, gap]
    return Surface(
        np.concatenate([low, high]),
        np.concatenate([faces, faces[:, ::-1] + len(low)]),
        np.concatenate([rim, rim]),
        40,
    )


def crowd(count=140, held=True):
    """Particles under a sheet, dead ones among the living ones, some of them held."""
    rng = np.random.default_rng(3)
    position = rng.uniform([-2.4, -2.4, -2.6], [2.4, 2.4, -0.45], (count, 3))
    index = np.arange(SLOTS)
    alive = (index < count) & (index % 17 != 5)
    place = np.concatenate([position, np.asarray(parked(SLOTS - count))])
    return Particles(
        jnp.asarray(place),
        jnp.asarray(index % 2),
        jnp.asarray(alive),
        jnp.asarray((place[:, 2] < -2.2) & held),
    )


def law(**values):
    return Parameters(**{"tumour_stiffness": 2.0, "collision_range": 0.6, **values})


def problem_of(kind):
    """A problem and its lists."""
    particles, membrane, load, finder = None, None, None, None
    if kind in ("cluster", "bed", "all"):
        particles = crowd(held=kind != "cluster")
    if kind in ("sheet", "bed", "all", "sheets"):
        vertices, faces, rim = grid(9, 0.7, 0.0)
        surface = Surface(vertices, faces, rim, 40)
        if kind in ("all", "sheets"):
            surface = two_sheets(0.35)
        membrane = put_membrane(surface)
        load = 0.02 * jnp.sin(jnp.arange(membrane.vertices.size, dtype=float))
        load = load.reshape(-1, 3) if kind in ("sheet", "all") else None
        if kind in ("all", "sheets"):
            names = np.full(len(surface.vertices), -1)
            finder = CollisionFinder.of(membrane, names, None, law())
    problem = Problem.of(particles, membrane, law(), load)
    return problem, prepared(problem, allocate_lists(problem), finder)


KINDS = ["cluster", "sheet", "bed", "sheets", "all"]

scenes = pytest.fixture(scope="module", params=KINDS)(lambda request: request.param)


@pytest.fixture(scope="module")
def scene(scenes):
    return problem_of(scenes)


_by_loop, by_program = eqx.filter_jit(descend_by_loop), eqx.filter_jit(descend)


def by_loop(problem, lists, *limits):
    return _by_loop(with_loops(problem, lists), lists, *limits)


def run(descending, problem, lists, steps, tolerance=1e-7, largest=LARGEST):
    limits = (jnp.asarray(n) for n in (tolerance, steps, largest))
    return descending(problem, lists, LBFGS(), *limits)


def close(found, wanted, within):
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        scale = max(1.0, float(jnp.abs(b[jnp.isfinite(b)]).max(initial=0.0)))
        np.testing.assert_allclose(a, b, atol=within * scale)


def masked(problem, nodes):
    return jax.tree.map(jnp.multiply, problem.free(), nodes)


def seen(problem, nodes):
    """Of what is alive: of dead ones the program tells forces that nobody asks for."""
    particles, vertices = nodes.particles, nodes.vertices
    if particles is not None:
        particles = jnp.where(problem.particles.alive[:, None], particles, 0)
    if vertices is not None:
        vertices = jnp.where(problem.membrane.vertex_alive[:, None], vertices, 0)
    return Nodes(particles, vertices)


def test_forces_are_minus_the_gradient_of_the_energy(scene):
    problem, lists = scene
    found = run(by_loop, problem, lists, 0)
    assert int(found.steps) == 0
    slope = jax.jit(jax.grad(problem.energy))(problem.nodes(), lists)
    wanted = jax.tree.map(jnp.negative, slope)
    close(seen(problem, found.force), seen(problem, wanted), 1e-11)
    size = [jnp.linalg.norm(f, axis=1).max() for f in jax.tree.leaves(wanted)]
    assert min(map(float, size)) > 1e-3  # every term acts
    assert float(found.residual) > 1e-3


@pytest.mark.parametrize("sharpness", [13.0, 80.0])
def test_forces_of_other_sharpness_are_too(scenes, sharpness):
    problem, lists = problem_of(scenes)
    values = law(contact_sharpness=sharpness, smoothing=0.0)
    problem = Problem.of(problem.particles, problem.membrane, values, problem.load)
    found = run(by_loop, problem, lists, 0)
    wanted = eqx.filter_jit(Problem.forces)(problem, problem.nodes(), lists)
    close(seen(problem, found.force), seen(problem, wanted), 1e-11)


def test_first_steps_are_those_of_the_program(scene):
    problem, lists = scene
    for steps in (1, 3, 8):
        found = run(by_loop, problem, lists, steps)
        wanted = run(by_program, problem, lists, steps)
        # of two sheets, after five steps a list is full, or the host has to make one
        assert int(found.code) == int(wanted.code)
        assert bool(found.lists.stale) == bool(wanted.lists.stale)
        assert int(found.steps) == int(wanted.steps) >= min(steps, 3)
        close(found.nodes, wanted.nodes, 1e-10)
        # where barriers are steep, forces magnify what positions differ by
        close(masked(problem, found.force), masked(problem, wanted.force), 1e-6)


def test_memory_is_that_of_the_program_so_that_a_descent_goes_on(scene):
    problem, lists = scene
    half = run(by_loop, problem, lists, 5)
    numbers = (jnp.asarray(n) for n in (1e-7, 2, LARGEST))
    there = problem.at(half.nodes)
    on = by_loop(there, half.lists, LBFGS(), *numbers, half.memory)
    numbers = (jnp.asarray(n) for n in (1e-7, 2, LARGEST))
    wanted = by_program(there, half.lists, LBFGS(), *numbers, half.memory)
    close(on.nodes, wanted.nodes, 1e-10)


def test_nothing_but_free_nodes_moves(scene):
    problem, lists = scene
    found = run(by_loop, problem, lists, 8)
    moved = jax.tree.map(jnp.subtract, found.nodes, problem.nodes())
    for way, free in zip(
        jax.tree.leaves(moved), jax.tree.leaves(problem.free()), strict=True
    ):
        assert float(jnp.abs(way * (1 - free)).max()) == 0.0
        assert float(jnp.abs(way).max()) > 1e-3


@pytest.mark.parametrize("kind", ["cluster", "sheet", "bed"])
def test_end_is_an_equilibrium_by_the_program_with_lists_of_its_own(kind):
    problem, lists = problem_of(kind)
    found = run(by_loop, problem, lists, 3000)
    assert int(found.code) == Result.CONVERGED.code
    there = problem.at(found.nodes)
    fresh = prepared(there, allocate_lists(there), None)
    force = masked(there, eqx.filter_jit(Problem.forces)(there, there.nodes(), fresh))
    largest = max(
        float(jnp.linalg.norm(f, axis=1).max()) for f in jax.tree.leaves(force)
    )
    np.testing.assert_allclose(largest, found.residual, rtol=1e-4, atol=1e-12)
    assert largest <= 1e-7


@pytest.mark.parametrize("kind, steps", [("cluster", 60), ("bed", 60), ("all", 3)])
def test_near_lists_found_in_the_loop_hold_where_it_ends(kind, steps):
    """However far it went: fresh lists have no pair within reach that it lacks."""
    problem, lists = problem_of(kind)
    found = run(by_loop, problem, lists, steps)
    assert int(found.rebuilds) > 0
    there = problem.at(found.nodes)
    fresh = prepared(there, allocate_lists(there), None)
    if lists.neighbors is not None:
        known, new = (pairs_within(there, x) for x in (found.lists, fresh))
        assert known >= new
        assert len(new) > 300
    if lists.contacts is not None:
        known, new = (contacts_within(there, x) for x in (found.lists, fresh))
        assert known == new
        assert len(new) > 50


def pairs_within(problem, lists):
    listed = np.asarray(lists.neighbors.listed)
    position = np.asarray(problem.particles.position)
    alive = np.asarray(problem.particles.alive)
    pairs = set()
    for k, i in zip(*np.nonzero(listed < len(position)), strict=True):
        j = listed[k, i]
        apart = np.linalg.norm(position[i] - position[j])
        if alive[i] and alive[j] and apart < 1.5:
            pairs.add((int(i), int(j)))
    return pairs


def contacts_within(problem, lists):
    contacts = lists.contacts
    apart = np.asarray(contact_distances(problem.particles, problem.membrane, contacts))
    near = apart < float(reach(problem.parameters))
    pairs = zip(
        np.asarray(contacts.particle)[near],
        np.asarray(contacts.face)[near],
        strict=True,
    )
    return {(int(p), int(f)) for p, f in pairs}


def test_step_is_bound_by_clearance():
    """A particle a hair under the membrane, pushed at it, moves by 0.4 of the hair."""
    problem, _ = problem_of("bed")
    place = jnp.asarray([0.31, 0.07, -1e-3])
    particles = eqx.tree_at(
        lambda p: (p.position, p.held),
        problem.particles,
        (problem.particles.position.at[0].set(place), problem.particles.held),
    )
    problem = Problem.of(particles, problem.membrane, law())
    lists = allocate_lists(problem)
    found = run(by_loop, problem, lists, 1)
    moved = jax.tree.map(jnp.subtract, found.nodes, problem.nodes())
    assert 1e-5 < float(jnp.linalg.norm(moved.particles[0])) <= 0.4e-3 * (1 + 1e-12)


def test_forces_that_are_not_finite_leave_the_last_positions():
    problem, lists = problem_of("cluster")
    where = problem.particles.position.at[3, 0].set(jnp.nan)
    broken = problem.at(Nodes(where, None))
    assert int(run(by_loop, broken, lists, 5).code) == Result.NON_FINITE.code


def test_particle_on_the_membrane_is_named():
    problem, _ = problem_of("bed")
    corner = problem.membrane.vertices[40]
    where = problem.particles.position.at[0].set(corner)
    problem = problem.at(Nodes(where, problem.membrane.vertices))
    found = run(by_loop, problem, allocate_lists(problem), 5)
    assert int(found.code) == Result.ON_MEMBRANE.code


def test_full_list_is_told_and_relaxed_with_a_larger_one():
    particles = crowd(held=False)
    squeezed = eqx.tree_at(lambda p: p.position, particles, particles.position * 0.6)
    problem = Problem.of(squeezed, None, law())
    lists = allocate_lists(problem)
    small = lists.neighbors.listed[:8]
    lists = eqx.tree_at(
        lambda x: (x.neighbors.listed, x.neighbors.reference),
        lists,
        (small, lists.neighbors.reference + 9.0),
    )
    found = run(by_loop, problem, lists, 50)
    assert int(found.code) == Result.OVERFLOW.code
    assert bool(found.lists.overflow)
    end = relax(squeezed, parameters=law(), lists=found.lists, tolerance=1e-5)
    assert end.result is Result.CONVERGED


def test_loops_are_used_on_processors_in_64_bits_only(monkeypatch):
    problem, _ = problem_of("cluster")
    assert is_looped(problem)
    single = jax.tree.map(
        lambda x: x.astype(jnp.float32) if x.dtype == jnp.float64 else x, problem
    )
    assert not is_looped(single)
    lists = "jaxgrow.equilibrium.native_lists"
    monkeypatch.setattr(f"{lists}.registered", lambda _: False)
    monkeypatch.setattr(f"{lists}.refused", lambda _: Refusal("a reason", None))
    assert not is_looped(problem)
