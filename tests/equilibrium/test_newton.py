"""Newton's method: it ends a relaxation, keeps its bounds, and gives up far away."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium import newton
from jaxgrow.equilibrium.newton import polish
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.equilibrium.relax import relax
from jaxgrow.runtime.results import Result

from ..quick_jit import quick_jit


PARAMETERS = jax.tree.map(lambda v: jnp.asarray(v, float), Parameters())
LARGEST = jnp.asarray(0.1)


@eqx.filter_jit
def forces(problem, lists):
    return problem.forces(problem.nodes(), lists)


@eqx.filter_jit
def _polished(problem, lists, tolerance, largest):
    return polish(problem, lists, tolerance, largest)


def polished(particles, membrane=None, tolerance=1e-12):
    problem = Problem(particles, membrane, PARAMETERS)
    lists = allocate_lists(problem)
    return problem, _polished(problem, lists, jnp.asarray(tolerance), LARGEST)


def largest_force(problem, lists):
    """On what may move, computed on the host."""
    each = jax.tree.map(
        lambda f, on: np.linalg.norm(np.asarray(f) * np.asarray(on), axis=1).max(),
        forces(problem, lists),
        problem.free(),
    )
    return max(jax.tree.leaves(each))


def shaken(state, size, seed=0):
    """The state with every node that may move displaced at random."""
    rng = np.random.default_rng(seed)
    problem = Problem(*state, PARAMETERS)
    nodes = jax.tree.map(
        lambda x, on: x + size * on * jnp.asarray(rng.normal(size=x.shape), x.dtype),
        problem.nodes(),
        problem.free(),
    )
    moved = problem.at(nodes)
    return moved.particles, moved.membrane


def moves(before, after):
    """How far each node went."""
    return np.concatenate(
        [
            np.linalg.norm(np.asarray(b) - np.asarray(a), axis=1)
            for a, b in zip(
                jax.tree.leaves(before), jax.tree.leaves(after), strict=True
            )
        ]
    )


@pytest.fixture(scope="module")
def near(cluster, bed):
    """States whose largest force is 1e-4, as descent leaves them."""
    scenes = {"particles": (cluster, None), "both": bed}
    return {
        name: relax(*scene, tolerance=1e-4, method="lbfgs").state
        for name, scene in scenes.items()
    }


@pytest.fixture(scope="module")
def one_iteration():
    """A single iteration, to see what each of them does."""
    compiled = quick_jit(lambda *inputs: polish(*inputs))

    def iterate(particles, membrane, tolerance=1e-13, largest=0.1):
        problem = Problem(particles, membrane, PARAMETERS)
        limits = jnp.asarray(tolerance), jnp.asarray(largest)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(newton, "MAX_ITERATIONS", 1)
            return problem, compiled(problem, allocate_lists(problem), *limits)

    return iterate


@pytest.mark.parametrize("name", ["particles", "both"])
def test_residual_falls_to_rounding_within_five_iterations(near, one_iteration, name):
    state, residuals = near[name], []
    for _ in range(5):
        problem, outcome = one_iteration(*state)
        at = problem.at(outcome.nodes)
        state = at.particles, at.membrane
        residuals.append(float(outcome.residual))
    assert residuals[-1] <= 1e-13, residuals


def test_residual_is_squared_by_an_iteration(near, one_iteration):
    # `both`: no pair of it crosses a kink of the force on the way
    state, residuals = near["both"], []
    for _ in range(3):
        problem, outcome = one_iteration(*state)
        at = problem.at(outcome.nodes)
        state = at.particles, at.membrane
        residuals.append(float(outcome.residual))
    before, after = np.array(residuals[:-1]), np.array(residuals[1:])
    assert np.all(after <= 300 * before**2 + 1e-14), residuals


def test_residual_is_that_of_the_nodes(near):
    problem, outcome = polished(*near["particles"], tolerance=1e-6)
    assert Result.of(outcome.code) is Result.CONVERGED
    assert outcome.residual <= 1e-6
    found = largest_force(problem.at(outcome.nodes), outcome.lists)
    assert found == pytest.approx(float(outcome.residual), rel=1e-6)
    np.testing.assert_array_equal(
        outcome.force.particles,
        forces(problem.at(outcome.nodes), outcome.lists).particles,
    )


def test_no_node_moves_farther_than_the_largest_step(near, one_iteration):
    start = shaken(near["both"], 1e-3)
    problem, outcome = one_iteration(*start, largest=1e-4)
    moved = moves(problem.nodes(), outcome.nodes)
    assert moved.max() == pytest.approx(1e-4)
    assert outcome.residual < largest_force(problem, outcome.lists)


def test_no_node_moves_farther_than_its_own_bound(near, one_iteration, monkeypatch):
    start = shaken(near["particles"], 1e-3)
    bound = 1e-5 * (1 + np.arange(64) % 7)

    def displacement(problem, outcome):
        return np.asarray(outcome.nodes.particles - problem.particles.position)

    whole = displacement(*one_iteration(*start))
    monkeypatch.setattr(newton, "MAX_ITERATIONS", 1)
    monkeypatch.setattr(
        Problem,
        "bound",
        lambda self, *_: eqx.tree_at(
            lambda n: n.particles, self.nodes(), jnp.asarray(bound)
        ),
    )
    problem = Problem(*start, PARAMETERS)
    compiled = quick_jit(lambda *inputs: polish(*inputs))
    limits = jnp.asarray(1e-13), LARGEST
    part = displacement(problem, compiled(problem, allocate_lists(problem), *limits))
    share = np.linalg.norm(part, axis=1) / bound
    assert share.max() == pytest.approx(1)
    # all by the same fraction of where Newton's step leads
    scale = np.vdot(part, whole) / np.vdot(whole, whole)
    assert 0 < scale < 0.1
    np.testing.assert_allclose(part, scale * whole, atol=1e-12)


def test_what_is_held_pinned_or_dead_stays_to_the_bit(near):
    outcome = relax(*near["both"], tolerance=1e-13)
    assert outcome.stats.method == "newton"
    for before, after, name in zip(
        near["both"], outcome.state, ("position", "vertices"), strict=True
    ):
        still = ~np.asarray(before.free)
        first, last = getattr(before, name), getattr(after, name)
        np.testing.assert_array_equal(last[still], first[still])
        assert np.abs(last - first)[~still].max() > 1e-6


def test_free_cluster_does_not_drift(make_particles):
    rng = np.random.default_rng(1)
    start = relax(make_particles(rng.uniform(0, 3, (27, 3))), tolerance=1e-3).state
    problem, outcome = polished(*start)
    assert Result.of(outcome.code) is Result.CONVERGED
    shift = np.asarray(outcome.nodes.particles - problem.particles.position)[:27]
    assert np.abs(shift).max() > 1e-5
    np.testing.assert_allclose(shift.mean(axis=0), 0, atol=1e-14)


def test_equilibrium_is_left_as_it_is(near):
    problem, outcome = polished(*near["particles"], tolerance=1e-3)
    assert Result.of(outcome.code) is Result.CONVERGED
    assert outcome.steps == 0
    np.testing.assert_array_equal(outcome.nodes.particles, problem.particles.position)


@pytest.mark.parametrize("size", [0.03, 0.1, 0.3])
def test_from_far_it_gives_up_with_the_best_state(near, size):
    start = shaken(near["particles"], size)
    problem, outcome = polished(*start)
    before = largest_force(problem, allocate_lists(problem))
    if Result.of(outcome.code) is not Result.CONVERGED:
        assert Result.of(outcome.code) is Result.STEP_LIMIT
        assert outcome.residual > 1e-12
    assert outcome.residual <= before * (1 + 1e-12)
    found = largest_force(problem.at(outcome.nodes), outcome.lists)
    assert found == pytest.approx(float(outcome.residual))


def test_step_that_makes_it_worse_is_not_taken(near, monkeypatch):
    monkeypatch.setattr(newton, "MAX_ITERATIONS", 1)
    monkeypatch.setattr(newton, "_HALVINGS", 0)
    compiled = quick_jit(lambda *inputs: polish(*inputs))
    kept = 0
    for seed in range(12):
        # so far away that Newton's whole step helps some starts and harms others
        problem = Problem(*shaken(near["particles"], 0.006, seed), PARAMETERS)
        lists = allocate_lists(problem)
        before = largest_force(problem, lists)
        outcome = compiled(problem, lists, jnp.asarray(1e-12), LARGEST)
        assert outcome.residual <= before * (1 + 1e-12)
        kept += bool(jnp.all(outcome.nodes.particles == problem.particles.position))
    assert 0 < kept < 12


def test_random_start_is_too_far(cluster):
    problem, outcome = polished(cluster)
    assert Result.of(outcome.code) is Result.STEP_LIMIT
    assert np.isfinite(np.asarray(outcome.nodes.particles)).all()
    assert outcome.residual <= largest_force(problem, outcome.lists) * (1 + 1e-12)


# as a method of `relax`


def test_newton_ends_a_relaxation_to_the_rounding_of_forces(bed):
    outcome = relax(*bed, tolerance=1e-13)
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.method == "newton"
    assert outcome.stats.residual <= 1e-13


@pytest.mark.parametrize("tolerance", [1e-4, 1e-10])
def test_newton_is_not_asked_where_lbfgs_converges(bed, tolerance):
    outcome = relax(*bed, tolerance=tolerance)
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.method == "lbfgs"


@pytest.mark.parametrize("tolerance, reached", [(1e-9, 1e-9), (1e-10, 1e-12)])
def test_what_may_be_differentiated_goes_beyond_its_tolerance(bed, tolerance, reached):
    residual = relax(*bed, tolerance=tolerance).stats.residual
    assert reached / 10 < residual <= reached


def test_newton_goes_on_where_lbfgs_does_not_converge(near):
    """With too few steps for it, from near an equilibrium."""
    few = relax(*near["both"], tolerance=1e-10, max_steps=60, method="lbfgs")
    assert few.result is Result.STEP_LIMIT
    outcome = relax(*near["both"], tolerance=1e-10, max_steps=60)
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.method == "newton"


@pytest.mark.parametrize("name", ["particles", "both"])
@pytest.mark.parametrize("method", ["lbfgs", "fire"])
def test_plain_methods_come_to_the_same_place(near, name, method):
    exact = relax(*near[name], tolerance=1e-13)
    plain = relax(*near[name], tolerance=1e-12, method=method)
    assert exact.stats.method == "newton"
    assert plain.result is Result.CONVERGED
    nodes = [Problem(*o.state, PARAMETERS).nodes() for o in (exact, plain)]
    assert moves(*nodes).max() <= 1e-8


def test_equilibrium_that_newton_cannot_reach_is_reached(make_particles):
    # two clusters turn against each other without force: their Hessian is singular
    rng = np.random.default_rng(4)
    near, far = rng.uniform(0, 2, (10, 3)), 6 + rng.uniform(0, 2, (10, 3))
    outcome = relax(make_particles(np.concatenate([near, far])), tolerance=5e-13)
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.residual <= 5e-13


def test_single_precision_is_kept(near):
    narrow = jax.tree.map(
        lambda a: a.astype(jnp.float32) if eqx.is_inexact_array(a) else a,
        near["particles"][0],
    )
    outcome = relax(narrow, tolerance=1e-5, method="newton")
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.residual <= 1e-5
    assert outcome.state[0].position.dtype == jnp.float32
