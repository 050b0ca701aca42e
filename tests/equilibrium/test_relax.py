"""Relaxation: closed forms, every result, and what may not move."""

import inspect
from itertools import product

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist

from jaxgrow.energy.a2 import A2
from jaxgrow.energy.pair import pair_force
from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists, stale
from jaxgrow.equilibrium.relax import relax
from jaxgrow.runtime.results import Result


def everybody(count):
    index = np.arange(count)
    return jnp.asarray((index[None, :] + index[1:, None]) % count)


def dense_residual(particles, parameters=None):
    """Largest force on a free particle, by the sum over all pairs."""
    count = particles.position.shape[0]
    force = pair_force(particles, everybody(count), parameters or Parameters())
    return np.linalg.norm(np.asarray(force)[np.asarray(particles.free)], axis=1).max()


# particles alone


def test_dimer_rests_at_r0(make_particles):
    start = make_particles([[0, 0, 0], [0.3, 0.5, 0.1]])
    outcome = relax(start, tolerance=1e-9)
    assert outcome.result is Result.CONVERGED
    gap = outcome.state[0].position[1] - outcome.state[0].position[0]
    # F' = -1/2 at rest: a force of 1e-9 is a distance of 2e-9
    np.testing.assert_allclose(np.linalg.norm(gap), 1, atol=1e-8)


SLOW = [("euler", 1e-3), ("serial", 1e-3)]  # soft modes take them for ever


@pytest.mark.parametrize(
    "method, tolerance", [*product(["lbfgs", "fire", "auto"], [1e-3, 1e-9]), *SLOW]
)
def test_particles_alone_come_to_rest(cluster, method, tolerance):
    outcome = relax(cluster, tolerance=tolerance, method=method, max_steps=20_000)
    assert outcome.result is Result.CONVERGED
    assert method in (outcome.stats.method, "auto")
    assert outcome.state[1] is None
    assert outcome.stats.residual <= tolerance
    assert dense_residual(outcome.state[0]) <= tolerance * (1 + 1e-6)


def test_method_that_ended_it_is_named(cluster):
    assert relax(cluster, method="auto").stats.method == "lbfgs"
    assert relax(cluster, method="fire").stats.method == "fire"


def test_serial_order_takes_fewer_steps_than_all_at_once(cluster):
    # the paper's remark
    steps = [
        relax(cluster, method=m, max_steps=20_000).stats.steps
        for m in ("serial", "euler")
    ]
    assert 3 * steps[0] < steps[1]


def test_serial_order_is_that_of_the_slots(make_particles):
    # the second particle sees where the first one went, and so goes less far
    pair = make_particles([[0, 0, 0], [0.9, 0, 0]])
    once = relax(pair, method="serial", max_steps=1, tolerance=1e-12)
    first = -0.64 * float(A2().force(jnp.asarray(0.9)))
    second = 0.9 + 0.64 * float(A2().force(jnp.asarray(0.9 - first)))
    assert -0.1 < first < 0 < second - 0.9 < -first
    found = once.state[0].position[:2, 0]
    np.testing.assert_allclose(found, [first, second], atol=1e-14)


def test_serial_order_is_for_particles_alone(bed):
    with pytest.raises(ValueError, match="'serial', which is for particles alone"):
        relax(*bed, method="serial")


@pytest.mark.parametrize("method", ["euler", "serial"])
def test_the_papers_methods_do_not_move_what_is_held_or_dead(cluster, method):
    still = ~np.asarray(cluster.free)
    after = relax(cluster, method=method, max_steps=50).state[0]
    np.testing.assert_array_equal(after.position[still], cluster.position[still])


def test_lbfgs_takes_fewer_steps_than_fire(cluster):
    steps = [
        relax(cluster, tolerance=1e-6, method=m).stats.steps for m in ("lbfgs", "fire")
    ]
    assert 1.2 * steps[0] < steps[1]


def test_held_and_dead_particles_do_not_move_by_a_bit(cluster):
    outcome = relax(cluster)
    still = ~np.asarray(cluster.free)
    after = outcome.state[0]
    np.testing.assert_array_equal(after.position[still], cluster.position[still])
    assert np.abs(after.position - cluster.position)[~still].max() > 0.1
    np.testing.assert_array_equal(after.alive, cluster.alive)
    np.testing.assert_array_equal(after.species, cluster.species)


def test_same_start_gives_the_same_bits(cluster):
    first, second = relax(cluster), relax(cluster)
    np.testing.assert_array_equal(first.state[0].position, second.state[0].position)


def test_order_of_the_particles_is_irrelevant_at_the_end(make_particles):
    rng = np.random.default_rng(5)
    position = rng.uniform(0, 2.5, (20, 3))
    order = rng.permutation(20)
    first = relax(make_particles(position), tolerance=1e-9).state[0].position[:20]
    second = relax(make_particles(position[order]), tolerance=1e-9).state[0].position
    # rounding on the way may turn and shift a free cluster as a whole
    np.testing.assert_allclose(pdist(second[:20]), pdist(first[order]), atol=1e-7)


# both together


@pytest.fixture(scope="module", params=["lbfgs", "fire"])
def settled(bed, request):
    return relax(*bed, tolerance=1e-9, method=request.param)


def test_particles_and_membrane_come_to_rest_together(settled, bed):
    assert settled.result is Result.CONVERGED
    assert settled.stats.residual <= 1e-9
    problem = Problem(*settled.state, Parameters())
    forces = eqx.filter_jit(lambda p, lists: p.forces(p.nodes(), lists))
    force = forces(problem, allocate_lists(problem))
    force = jax.tree.map(jnp.multiply, force, problem.free())
    largest = max(np.abs(f).max() for f in jax.tree.leaves(force))
    assert largest <= 1e-9


def test_what_is_held_pinned_or_dead_stays_to_the_bit(settled, bed):
    for before, after, name in zip(
        bed, settled.state, ("position", "vertices"), strict=True
    ):
        still = ~np.asarray(before.free)
        first, last = getattr(before, name), getattr(after, name)
        np.testing.assert_array_equal(last[still], first[still])
        assert np.abs(last - first)[~still].max() > 0.01


def test_coarse_tolerance_is_kept_and_takes_fewer_steps(bed, settled):
    coarse = relax(*bed, tolerance=1e-3)
    assert coarse.result is Result.CONVERGED
    assert coarse.stats.residual <= 1e-3
    assert coarse.stats.steps < settled.stats.steps


def test_lists_of_an_earlier_call_may_be_passed_on(bed):
    first = relax(*bed, tolerance=1e-3)
    again = relax(*first.state, tolerance=1e-9, lists=stale(first.lists))
    fresh = relax(*first.state, tolerance=1e-9)
    assert again.result is Result.CONVERGED
    np.testing.assert_allclose(
        again.state[0].position, fresh.state[0].position, atol=1e-12
    )


def test_lists_of_another_shape_are_not_used(bed, cluster):
    lists = relax(*bed).lists
    outcome = relax(cluster, lists=lists)
    assert outcome.result is Result.CONVERGED
    assert outcome.lists.contacts is None


# results other than success


def test_step_limit_is_a_result_with_the_last_state(cluster):
    outcome = relax(cluster, tolerance=1e-9, method="lbfgs", max_steps=4)
    assert outcome.result is Result.STEP_LIMIT
    assert outcome.stats.steps == 4
    assert outcome.stats.residual > 1e-9
    assert dense_residual(outcome.state[0]) == pytest.approx(outcome.stats.residual)


def test_auto_goes_on_with_fire_where_lbfgs_stops(cluster):
    outcome = relax(cluster, tolerance=1e-9, max_steps=4)
    assert outcome.stats.method == "fire"
    assert outcome.stats.steps == 8


@pytest.mark.parametrize("method", ["lbfgs", "fire", "newton", "euler", "serial"])
def test_position_that_is_not_finite_is_a_result(cluster, method):
    # jax-md's lists raise no flag for it
    position = cluster.position.at[7].set(jnp.nan)
    broken = eqx.tree_at(lambda p: p.position, cluster, position)
    outcome = relax(broken, method=method)
    assert outcome.result is Result.NON_FINITE
    assert not outcome.result.success


def test_particle_at_nan_that_nobody_feels_is_a_result(make_particles):
    lost = make_particles([[0, 0, 0], [np.nan, 0, 0]])
    assert relax(lost).result is Result.NON_FINITE


def test_force_that_overflows_is_a_result(make_membrane, load):
    outcome = relax(
        None, make_membrane(), load=load(24, [0, 0, np.inf]), method="lbfgs"
    )
    assert outcome.result is Result.NON_FINITE
    assert np.isfinite(outcome.state[1].vertices).all()


def test_neighbour_list_that_overflows_is_made_anew(make_particles):
    # listed while far apart, then moved together: room for few neighbours only
    rng = np.random.default_rng(9)
    apart = make_particles(
        3.0 * np.stack(np.unravel_index(np.arange(60), (4, 4, 4)), 1)
    )
    together = make_particles(rng.uniform(0, 3.5, (60, 3)))
    small = Lists(allocate_lists(Problem(apart, None, Parameters())).neighbors, None)
    outcome = relax(together, tolerance=1e-9, lists=small)
    wanted = relax(together, tolerance=1e-9)
    assert outcome.result is Result.CONVERGED
    assert outcome.lists.neighbors.listed.shape > small.neighbors.listed.shape
    # the order of the list rounds otherwise, and nothing holds the cluster's turn
    found, known = (pdist(r.state[0].position[:60]) for r in (outcome, wanted))
    np.testing.assert_allclose(found, known, atol=1e-7)


def test_lists_are_rebuilt_only_when_something_moved_too_far(make_particles):
    particles = make_particles([[0, 0, 0], [0.95, 0, 0]])  # goes to 1.0
    assert relax(particles).stats.rebuilds == 0
    particles = make_particles([[0, 0, 0], [0.4, 0, 0]])  # by 0.6, three skins
    assert 2 <= relax(particles, method="fire").stats.rebuilds <= 3


def test_list_that_overflows_on_the_way_is_rolled_back(make_particles):
    # a sheet that a strong pull folds up: the list fits the start, not the end
    rng = np.random.default_rng(10)
    line = make_particles(
        np.stack([1.2 * np.arange(60), *0.3 * rng.normal(size=(2, 60))], axis=1)
    )
    strong = Parameters(adhesion=jnp.asarray(0.4))
    start = allocate_lists(Problem(line, None, strong))
    ended = relax(line, tolerance=1e-4, parameters=strong, lists=start)
    assert ended.result is Result.CONVERGED
    assert dense_residual(ended.state[0], strong) <= 1.01e-4


@pytest.mark.parametrize(
    "call, match",
    [
        ({}, "nothing to relax"),
        ({"tolerance": 0.0}, "tolerance is 0.0; it must be a positive"),
        ({"tolerance": float("nan")}, "tolerance is nan"),
    ],
)
def test_wrong_call_is_refused(cluster, call, match):
    particles = cluster if call else None
    with pytest.raises(ValueError, match=match):
        relax(particles, **call)


def test_unknown_method_is_refused(cluster):
    # __wrapped__: the type checker of the tests would refuse it first
    with pytest.raises(ValueError, match="method is 'simplex'; it must be one of"):
        inspect.unwrap(relax)(cluster, method="simplex")


@pytest.mark.parametrize("count", [2, 40])
def test_particles_at_one_point_do_not_stay_there(make_particles, count):
    outcome = relax(make_particles(np.zeros((count, 3))), tolerance=1e-4)
    assert outcome.result is Result.CONVERGED
    position = np.asarray(outcome.state[0].position)[:count]
    assert KDTree(position).query(position, k=2)[0][:, 1].min() > 0.6


def test_particles_are_set_apart_by_no_more_than_a_hair(make_particles):
    position = np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 0], [3.0, 0, 0]])
    outcome = relax(make_particles(position), tolerance=10.0)
    moved = np.asarray(outcome.state[0].position)[:4]
    assert outcome.stats.steps == 0
    assert 0 < np.abs(moved - position).max() < 1e-12
    assert len(np.unique(moved, axis=0)) == 4
    np.testing.assert_array_equal(moved[3], position[3])


def test_held_particles_at_one_point_stay(make_particles):
    particles = make_particles(np.zeros((3, 3)), held=np.ones(3, bool))
    outcome = relax(particles, tolerance=1e-4)
    np.testing.assert_array_equal(outcome.state[0].position[:3], np.zeros((3, 3)))


def test_particle_on_the_membrane_is_a_result(make_particles, make_membrane):
    position = np.array([[0.2, 0.3, 0.0], [0.0, 0.0, -1.0]])
    outcome = relax(make_particles(position), make_membrane(), tolerance=1e-4)
    assert outcome.result is Result.ON_MEMBRANE


@pytest.mark.parametrize("depth", [1e-9, 1e-12])
def test_particle_a_hair_under_the_membrane_is_pushed_away_from_it(
    make_particles, make_membrane, depth
):
    position = np.array([[0.0, 0.0, -depth], [0.0, 0.0, -1.0]])
    outcome = relax(make_particles(position), make_membrane(), tolerance=1e-4)
    assert outcome.result is Result.CONVERGED
    membrane = outcome.state[1]
    height = np.asarray(membrane.vertices)[np.asarray(membrane.vertex_alive), 2]
    assert np.asarray(outcome.state[0].position)[0, 2] < height.min() - 0.2


@pytest.mark.parametrize("method", ["auto", "euler", "serial"])
def test_observer_sees_every_step(make_particles, method):
    rng = np.random.default_rng(3)
    particles = make_particles(rng.uniform(0, 2, (20, 3)))
    seen = []
    outcome = relax(
        particles, tolerance=1e-2, method=method, max_steps=20_000, observe=seen.append
    )
    assert len(seen) == outcome.stats.steps > 5
    np.testing.assert_array_equal(seen[-1].particles, outcome.state[0].position)
    # one step at a time is the same way
    plain = relax(particles, tolerance=1e-2, method=method, max_steps=20_000)
    assert plain.stats.steps == outcome.stats.steps
    np.testing.assert_allclose(
        plain.state[0].position, outcome.state[0].position, atol=1e-9
    )


@pytest.mark.parametrize("step", [0.0, 0.2, np.nan])
def test_largest_step_out_of_its_range_is_refused(make_particles, step):
    with pytest.raises(ValueError, match=r"largest_step is .*; it must be positive"):
        relax(make_particles(np.zeros((1, 3))), largest_step=step)


def test_forces_are_those_on_held_nodes_too(make_particles):
    particles = make_particles(
        np.array([[0.0, 0, 0], [0.7, 0, 0]]), held=np.ones(2, bool)
    )
    outcome = relax(particles, tolerance=1e-4)
    assert outcome.stats.residual == 0
    push = float(A2(0.2, 0.1).force(jnp.asarray(0.7)))
    np.testing.assert_allclose(outcome.forces.particles[0], [-push, 0, 0], atol=1e-12)
    np.testing.assert_allclose(outcome.forces.particles[1], [push, 0, 0], atol=1e-12)
