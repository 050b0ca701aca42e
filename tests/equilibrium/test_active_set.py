"""Relaxing only what is disturbed: the same end, judged on everything."""

import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrow as jg
from jaxgrow.equilibrium import active_set as local, force_cache as kept
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.equilibrium.relax import relax
from jaxgrow.equilibrium.subproblem import Mask
from jaxgrow.growth.initial_state import make_initial_state
from jaxgrow.growth.setup import Setup
from jaxgrow.runtime.results import Result
from jaxgrow.state import Species
from jaxgrow.transfer.device import put_particles

from ..quick_jit import quick_jit


equilibrium = sys.modules["jaxgrow.equilibrium.relax"]  # the name is the function's


@quick_jit
def forces(problem, lists):
    return problem.forces(problem.nodes(), lists)


def residual(particles, membrane=None, load=None):
    """Largest force on what is free, by lists made for where everything is."""
    problem = Problem.of(particles, membrane, load=load)
    force = forces(problem, allocate_lists(problem))
    largest = [np.linalg.norm(np.asarray(force.particles), axis=1)[particles.free]]
    if membrane is not None:
        rows = np.linalg.norm(np.asarray(force.vertices), axis=1)
        largest.append(rows[np.asarray(membrane.free)])
    return np.concatenate(largest).max()


@pytest.fixture(autouse=True)
def large_parts(monkeypatch):
    """Parts that would not pay, since what is tested is small."""
    monkeypatch.setattr(local, "LARGEST_SHARE", 0.7)
    monkeypatch.setattr(kept, "LARGEST_SHARE", 0.7)


@pytest.fixture(scope="module")
def ball():
    """3000 particles in equilibrium, jittered first, with room for daughters."""
    half = np.arange(-10, 11)
    lattice = np.stack(np.meshgrid(half, half, half, indexing="ij"), -1).reshape(-1, 3)
    lattice = lattice[lattice.sum(axis=1) % 2 == 0]
    nearest = np.argsort((lattice**2).sum(axis=1), kind="stable")[:3000]
    position = lattice[nearest] * 0.68
    particles = put_particles(
        position, np.full(3000, int(Species.TUMOUR)), np.zeros(3000, bool), 3072
    )
    outcome = relax(particles, tolerance=1e-6, method="lbfgs")
    assert outcome.result is Result.CONVERGED
    return outcome.state[0]


def divided(particles, parent, slot=3000):
    offset = jnp.array([0.3, 0.2, -0.35])
    return eqx.tree_at(
        lambda p: (p.position, p.alive, p.species),
        particles,
        (
            particles.position.at[slot]
            .set(particles.position[parent] + offset)
            .at[parent]
            .add(-offset),
            particles.alive.at[slot].set(True),
            particles.species.at[slot].set(int(Species.TUMOUR)),
        ),
    )


@pytest.mark.parametrize("parent, tolerance", [(0, 1e-2), (0, 3e-3), (2990, 3e-3)])
def test_a_division_moves_what_is_around_it_and_nothing_else(ball, parent, tolerance):
    start = divided(ball, parent)
    outcome = relax(start, tolerance=tolerance, method="local")
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.method == "local"
    end = outcome.state[0]
    assert outcome.stats.residual <= tolerance
    np.testing.assert_allclose(residual(end), outcome.stats.residual, rtol=1e-6)
    still = np.all(np.asarray(end.position) == np.asarray(start.position), axis=1)
    assert 0.3 * 3001 < still[:3001].sum() < 3001 - 100
    # the same packing as when all may move
    whole = relax(start, tolerance=tolerance, method="lbfgs").state[0]
    apart = np.asarray(end.position - whole.position)[:3001]
    assert np.linalg.norm(apart, axis=1).max() < 20 * tolerance


def test_what_feels_a_little_too_much_later_is_relaxed_without_the_rest(
    ball, monkeypatch
):
    sizes, cut = [], local.cut

    def watched(problem, moving, margin):
        sizes.append(moving.size)
        return cut(problem, moving, margin)

    monkeypatch.setattr(local, "cut", watched)
    monkeypatch.setattr(local, "RADIUS", 2.0)
    start = divided(ball, 0)
    outcome = relax(start, tolerance=3e-3, method="local")
    assert outcome.stats.method == "local"
    assert residual(outcome.state[0]) <= 3e-3
    assert sizes[-1] < max(sizes)


def test_rounds_grow_until_the_whole_is_to_be_relaxed():
    def mask(start, stop):
        index = np.arange(1000)
        return Mask((start <= index) & (index < stop), np.zeros(0, bool))

    free = mask(0, 1000)
    nothing = local.Chosen(mask(0, 0), mask(0, 0))
    first = nothing.following(mask(0, 200), free)
    assert (first.moving.size, first.moved.size) == (200, 200)
    # a little at the border moves alone, and if that disturbs the rest, all of it
    border = first.following(mask(190, 220), free)
    assert (border.moving.size, border.moved.size) == (30, 220)
    again = border.following(mask(150, 160), free)
    assert (again.moving.size, again.moved.size) == (220, 220)
    # much of it moves with the rest
    wider = first.following(mask(190, 320), free)
    assert (wider.moving.size, wider.moved.size) == (320, 320)
    # where it does not grow, or grows too much, the whole goes on
    assert again.following(mask(150, 160), free) is None
    assert again.following(mask(0, 900), free) is None


@pytest.mark.parametrize("last, method", [(1.0, "local"), (1e-9, "lbfgs")])
def test_what_goes_farther_than_was_allowed_for_is_relaxed_among_more(
    ball, monkeypatch, last, method
):
    monkeypatch.setattr(local, "SLIGHT", 1e9)
    monkeypatch.setattr(local, "MARGINS", (1e-9, last))
    outcome = relax(divided(ball, 0), tolerance=1e-2, method="local")
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.method == method
    assert residual(outcome.state[0]) <= 1e-2


def test_what_it_cannot_end_is_ended_on_the_whole(ball, monkeypatch):
    monkeypatch.setattr(local, "LARGEST_SHARE", 0.5)
    start = divided(ball, 0)
    outcome = relax(start, tolerance=1e-5, method="local")
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.method != "local"
    assert residual(outcome.state[0]) <= 1e-5


def test_a_disturbance_of_everything_is_relaxed_as_a_whole(ball):
    moves = 0.05 * np.random.default_rng(0).normal(size=ball.position.shape)
    moved = eqx.tree_at(lambda p: p.position, ball, ball.position + moves)
    outcome = relax(moved, tolerance=1e-2, method="local")
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.method == "lbfgs"


def test_nothing_is_done_at_rest(ball):
    outcome = relax(ball, tolerance=1e-3, method="local")
    assert (outcome.stats.steps, outcome.stats.method) == (0, "local")
    np.testing.assert_array_equal(outcome.state[0].position, ball.position)


def test_auto_looks_for_the_part_where_there_are_many(ball, monkeypatch):
    start = divided(ball, 0)
    assert relax(start, tolerance=1e-2).stats.method == "lbfgs"
    monkeypatch.setattr(local, "FEWEST", 3000)
    assert relax(start, tolerance=1e-2).stats.method == "local"
    seen = []
    watched = relax(start, tolerance=1e-2, observe=seen.append, max_steps=2)
    assert watched.stats.method != "local"
    assert len(seen) > 0


def test_forces_are_those_on_everything(ball):
    outcome = relax(divided(ball, 0), tolerance=1e-2, method="local")
    size = np.linalg.norm(np.asarray(outcome.forces.particles), axis=1)
    np.testing.assert_allclose(size.max(), outcome.stats.residual)
    assert np.count_nonzero(size) > 2900


def test_forces_are_evaluated_on_everything_once_and_then_kept(ball, monkeypatch):
    first = relax(divided(ball, 0), tolerance=1e-2, method="local")

    def never(*_):
        raise AssertionError("forces on everything are asked for")

    monkeypatch.setattr(local, "evaluated", never)
    monkeypatch.setattr(local, "prepared", never)
    start = divided(first.state[0], 40, slot=3001)
    again = relax(start, tolerance=1e-2, method="local", lists=first.lists)
    assert again.result is Result.CONVERGED
    np.testing.assert_allclose(residual(again.state[0]), again.stats.residual)
    problem = Problem.of(again.state[0], None)
    wanted = forces(problem, allocate_lists(problem)).particles
    np.testing.assert_allclose(again.forces.particles, wanted, rtol=0, atol=1e-13)
    # so the lists of all neighbours are those that were given
    assert again.lists.neighbors is first.lists.neighbors


def test_what_was_disturbed_anywhere_since_is_found(ball):
    first = relax(divided(ball, 0), tolerance=1e-2, method="local")
    moved = first.state[0].position.at[2990].add(jnp.array([0.2, 0.1, -0.2]))
    start = eqx.tree_at(lambda p: p.position, first.state[0], moved)
    assert residual(start) > 1e-2
    again = relax(start, tolerance=1e-2, method="local", lists=first.lists)
    assert again.result is Result.CONVERGED
    assert residual(again.state[0]) <= 1e-2


def test_lists_may_be_used_again_and_by_other_methods(ball):
    start = divided(ball, 0)
    first = relax(start, tolerance=1e-2, method="local")
    ends = [
        relax(start, tolerance=1e-2, method=method, lists=first.lists)
        for method in ("local", "lbfgs")
    ]
    assert all(residual(end.state[0]) <= 1e-2 for end in ends)
    np.testing.assert_allclose(
        ends[0].state[0].position, first.state[0].position, rtol=0, atol=1e-9
    )


def test_without_loops_it_comes_to_the_same(ball, monkeypatch):
    start = divided(ball, 0)
    ends = [relax(start, tolerance=1e-2, method="local").state[0].position]
    monkeypatch.setattr(kept, "pair_module", lambda: None)
    ends.append(relax(start, tolerance=1e-2, method="local").state[0].position)
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-9)


def test_a_derivative_is_taken_with_lists_of_where_it_ended(ball, monkeypatch):
    far = eqx.tree_at(lambda p: p.position, ball, 1.5 * ball.position)
    given = []

    def told(problem, found, lists, *, valid):
        given.append((problem, found.nodes, lists))
        return found

    monkeypatch.setattr(equilibrium, "at_equilibrium", told)
    monkeypatch.setattr(equilibrium, "exact_tolerance", lambda _: 1e-2)
    lists = relax(far, tolerance=1e3, method="local").lists

    def height(adhesion):
        parameters = jg.Parameters(adhesion=adhesion)
        end = relax(ball, parameters=parameters, method="local", lists=lists)
        return jnp.sum(end.state[0].position)

    jax.jvp(height, (0.2,), (1.0,))
    (problem, nodes, lists), *_ = given
    assert not bool(problem.outgrown(nodes, lists).any())


def test_coincident_particles_are_found_out_of_place(ball):
    start = eqx.tree_at(
        lambda p: p.position, ball, ball.position.at[7].set(ball.position[8])
    )
    outcome = relax(start, tolerance=1e-2, method="local")
    assert outcome.result is Result.CONVERGED
    gap = outcome.state[0].position[7] - outcome.state[0].position[8]
    assert np.linalg.norm(gap) > 0.5


@pytest.fixture(scope="module")
def ground():
    """A wide patch of an organ with its tissue."""
    scene = jg.Scene(
        lesion=jg.Polyp(divisions=5, particle_mm=1.0),
        surroundings=jg.Surroundings(radius=11.0),
    )
    setup = Setup(scene, jg.Parameters(), 1e-4)
    planted = make_initial_state(setup, np.random.default_rng(0))
    # its springs were reset since
    state = planted.state
    rested = relax(state.particles, state.membrane, tolerance=1e-4, method="lbfgs")
    return jg.State(*rested.state, state.frame)


def test_particles_and_membrane_rise_together_and_nothing_crosses(ground):
    particles, membrane = ground.particles, ground.membrane
    alive = np.asarray(particles.alive)
    top = np.asarray(particles.position)[alive]
    site = np.asarray(membrane.vertices)[int(membrane.source)]
    parent = int(np.linalg.norm(top - site, axis=1).argmin())
    start = divided(particles, parent, slot=int(alive.sum()))
    outcome = relax(start, membrane, tolerance=1e-2, method="local")
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.method == "local"
    end, surface = outcome.state
    assert residual(end, surface) <= 1e-2
    still = np.all(np.asarray(surface.vertices == membrane.vertices), axis=1)
    assert 3 < np.count_nonzero(~still) < 0.5 * len(still)
    whole = relax(start, membrane, tolerance=1e-2, method="lbfgs").state
    apart = np.asarray(end.position - whole[0].position)[alive]
    assert np.linalg.norm(apart, axis=1).max() < 0.3
    height = np.asarray(end.position)[alive, 2] - np.asarray(start.position)[alive, 2]
    assert np.abs(height).max() < 1


def test_a_load_and_what_is_held_are_kept(ground):
    membrane = ground.membrane
    load = jnp.zeros_like(membrane.vertices)
    load = load.at[int(membrane.source)].set(jnp.array([0.0, 0.0, 0.05]))
    outcome = relax(
        ground.particles, membrane, load=load, tolerance=5e-3, method="local"
    )
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.method == "local"
    assert residual(*outcome.state, load=load) <= 5e-3
    moved = np.any(np.asarray(outcome.state[1].vertices != membrane.vertices), axis=1)
    assert moved[int(membrane.source)]
    assert not moved[~np.asarray(membrane.free)].any()
    held = ~np.asarray(ground.particles.free)
    same = np.asarray(outcome.state[0].position == ground.particles.position)
    assert same[held].all()


def test_it_is_for_what_is_neither_observed_nor_colliding(ball):
    with pytest.raises(ValueError, match="'auto' is for everything"):
        relax(ball, method="local", observe=lambda _: None)
    with pytest.raises(ValueError, match="'auto' is for everything"):
        relax(ball, method="local", collide=lambda *_: None)
