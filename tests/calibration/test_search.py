"""The search: which steps are accepted, and what happens when gradients fail."""

import math

import jax
import numpy as np
import optax
import pytest

from jaxgrow.calibration import fit
from jaxgrow.calibration.search import End
from jaxgrow.calibration.task import Bounds
from jaxgrow.scene import Scene


SCENE = Scene()
BOUNDS = {"spring_stiffness": (0.004, 0.4)}
TRUE = 0.12
TARGETS = {
    "height_mm": (1.3 - 0.4 * math.log(TRUE), 0.05),
    "width_mm": (2 - 0.5 * math.log(TRUE), 0.05),
}


def run(formula, **more):
    return fit(SCENE, TARGETS, BOUNDS, grower=formula, **more)


def check_best_so_far(found):
    """A point is accepted if and only if its re-grown loss is less than all before."""
    least = math.inf
    for tried in found.history:
        assert tried.accepted == (tried.loss < least)
        least = min(least, tried.loss)
    assert found.loss == least


@pytest.mark.parametrize("share", [1.0, 0.5, 0.1, 3.0])
@pytest.mark.parametrize("start", [0.04, 0.36])
def test_a_planted_value_is_found_three_times_off(formula, share, start):
    bounds = {"spring_stiffness": Bounds(low=0.004, high=0.4, start=start)}
    found = fit(SCENE, TARGETS, bounds, grower=formula(share), seeds=range(8))
    assert found.scene.parameters.spring_stiffness == pytest.approx(TRUE, rel=0.02)
    assert found.end is End.CONVERGED
    assert len(found.history) <= 10
    check_best_so_far(found)


def test_refused_steps_turn_a_gradient_of_the_wrong_sign(formula):
    found = run(formula(-0.5))
    check_best_so_far(found)
    refused = [tried for tried in found.history[1:4] if not tried.accepted]
    assert len(refused) == 3
    assert found.end is End.CONVERGED
    assert found.outcome.success


def test_without_derivatives_the_simplex_finds_it(formula):
    found = run(formula(None))
    check_best_so_far(found)
    assert {tried.how for tried in found.history[1:]} == {"derivative-free"}
    assert found.end is End.SHRUNK
    assert found.scene.parameters.spring_stiffness == pytest.approx(TRUE, rel=0.05)
    assert not found.parameters["spring_stiffness"].determined


def test_a_gradient_that_vanishes_far_from_the_targets_is_not_the_end(formula):
    found = run(formula(0.0))
    assert {tried.how for tried in found.history[1:]} == {"derivative-free"}
    assert found.outcome.success


def test_steps_that_are_refused_again_and_again_end_in_the_simplex(formula):
    class Unsteady(formula):
        """Its slopes point away from the target, however they are corrected."""

        def slopes(self, *_):
            return ((1e3,), (1e3,))

    found = run(Unsteady())
    hows = [tried.how for tried in found.history]
    assert "gradient" in hows
    assert "derivative-free" in hows
    check_best_so_far(found)
    assert found.outcome.success


def test_a_growth_that_fails_refuses_its_step_and_is_counted(formula):
    bounds = {"spring_stiffness": (0.004, 0.9)}
    targets = {"height_mm": (1.3 - 0.4 * math.log(0.3), 0.02)}

    class OneMetric(formula):
        def measure(self, seed, values):
            measured = super().measure(seed, values)
            return measured.__class__(
                seed, values, measured.result, measured.metrics[:1]
            )

        def slopes(self, seed, values):
            return super().slopes(seed, values)[:1]

    found = fit(SCENE, targets, bounds, grower=OneMetric(0.3, fails_above=0.29))
    assert found.failures
    assert set(found.failures) == {"seed 0 ended with STEP_LIMIT"}
    assert all(
        math.isinf(t.loss) and not t.accepted for t in found.history if t.failure
    )
    assert 0.27 < found.scene.parameters.spring_stiffness <= 0.29


def test_nothing_that_grows_is_an_outcome(formula):
    found = run(formula(fails_above=0.0), evaluations=5)
    assert found.outcome.name == "NOT_GROWN"
    assert len(found.history) == len(found.failures) == 5
    assert found.targets == {}


def test_a_start_that_does_not_grow_is_left(formula):
    bounds = {"spring_stiffness": Bounds(low=0.004, high=0.4, start=0.3)}
    found = fit(SCENE, TARGETS, bounds, grower=formula(fails_above=0.25))
    assert found.history[0].failure
    assert found.scene.parameters.spring_stiffness == pytest.approx(TRUE, rel=0.05)


def test_evaluations_are_bounded(formula):
    found = run(formula(), evaluations=2)
    assert len(found.history) == 2
    assert found.end is End.EXHAUSTED
    assert len(found.growths) == 8


def test_another_optimiser_can_be_used(formula):
    with jax.numpy_dtype_promotion("standard"):  # optax needs it
        found = run(formula(), optimiser=optax.adam(0.3))
    check_best_so_far(found)
    assert found.scene.parameters.spring_stiffness == pytest.approx(TRUE, rel=0.05)


def test_the_same_seeds_are_grown_at_every_point(formula):
    grower = formula()
    run(grower, seeds=(5, 7))
    seeds = [seed for seed, _ in grower.asked]
    np.testing.assert_array_equal(seeds, [5, 7] * (len(seeds) // 2))
