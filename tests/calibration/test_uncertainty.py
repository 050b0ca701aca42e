"""What is known of parameters, and why a target is not reached."""

import math

import numpy as np
import pytest

from jaxgrow.calibration import fit
from jaxgrow.calibration.coordinates import PRIOR_VARIANCE
from jaxgrow.calibration.evaluations import Evaluation
from jaxgrow.calibration.spec import Bounds
from jaxgrow.scene.scene import Scene


class Lines:
    """Metrics that are linear in the logarithms of the parameters, with noise."""

    def __init__(self, matrix, noise=0.0):
        self.matrix, self.noise = np.array(matrix, float), noise

    def measure(self, seed, values):
        rng = np.random.default_rng(seed)
        noise = self.noise * rng.standard_normal(len(self.matrix))
        metrics = self.matrix @ np.log(values) + noise
        return Evaluation(seed, values, "REACHED", tuple(metrics.tolist()))

    def slopes(self, _, values):
        return tuple(map(tuple, (self.matrix / np.array(values)).tolist()))


E = math.e
WIDE = {"spring_stiffness": Bounds(low=E**-4, high=E**4, start=1.0)}
BOTH = {**WIDE, "contact_adhesion": Bounds(low=E**-4, high=E**4, start=1.0)}


def test_the_deviation_is_that_of_the_posterior():
    found = fit(Scene(), {"height_mm": (0.0, 0.1)}, WIDE, grower=Lines([[1.0]]))
    # at the middle dx/du is a quarter of 8
    precision = (2 / 0.1) ** 2 + 1 / PRIOR_VARIANCE
    wanted = 2 / math.sqrt(precision)
    assert found.parameters["spring_stiffness"].from_targets == pytest.approx(wanted)
    assert found.parameters["spring_stiffness"].determined


def test_the_deviation_of_seeds_is_that_of_fits_to_other_seeds():
    grower, targets = Lines([[1.0]], noise=0.2), {"height_mm": (0.0, 0.1)}
    fits = [
        fit(Scene(), targets, WIDE, grower=grower, seeds=range(s, s + 8))
        for s in range(0, 320, 8)
    ]
    logs = [math.log(f.scene.parameters.spring_stiffness) for f in fits]
    told = [f.parameters["spring_stiffness"] for f in fits]
    relative = [p.from_seeds / p.value for p in told]
    assert np.mean(relative) == pytest.approx(np.std(logs, ddof=1), rel=0.25)


def test_one_seed_says_nothing_of_the_spread():
    found = fit(
        Scene(), {"height_mm": (0.0, 0.1)}, WIDE, grower=Lines([[1.0]]), seeds=[4]
    )
    stiffness = found.parameters["spring_stiffness"]
    assert math.isnan(stiffness.from_seeds)
    assert math.isnan(stiffness.low)
    assert math.isnan(stiffness.high)
    assert math.isnan(found.targets["height_mm"].spread)
    assert found.as_dict()["targets"]["height_mm"]["spread"] is None


def test_what_the_targets_do_not_determine_is_said():
    grower = Lines([[1.0, 0.0]])
    found = fit(Scene(), {"height_mm": (0.5, 0.1)}, BOTH, grower=grower)
    assert found.parameters["spring_stiffness"].determined
    free = found.parameters["contact_adhesion"]
    assert not free.determined
    assert free.low < free.value < free.high


def test_scatter_does_not_determine_a_parameter(chaos):
    bounds = {
        "spring_stiffness": Bounds(low=0.004, high=0.4, start=0.05),
        "adhesion": Bounds(low=0.05, high=0.35, start=0.2),
    }
    targets = {"height_mm": (0.0, 0.04), "width_mm": (0.0, 0.04)}
    determined = []
    for i in range(30):
        seeds = range(4 * i, 4 * (i + 1))
        found = fit(Scene(), targets, bounds, grower=chaos(0.12), seeds=seeds)
        assert found.parameters["spring_stiffness"].determined
        determined.append(found.parameters["adhesion"].determined)
    assert np.mean(determined) < 0.25  # half of them if scatter counts


def test_a_target_beyond_the_bounds_is_unreachable():
    found = fit(Scene(), {"height_mm": (6.0, 0.1)}, WIDE, grower=Lines([[1.0]]))
    assert found.outcome.name == "UNREACHED"
    reason = str(found.targets["height_mm"].reason)
    assert "uncertainties below its target 6 ± 0.1; it was " in reason
    assert reason.endswith("spring_stiffness is at its upper bound.")


def test_targets_that_exclude_each_other_are_named():
    targets = {"height_mm": (1.0, 0.1), "width_mm": (-1.0, 0.1)}
    found = fit(Scene(), targets, WIDE, grower=Lines([[1.0], [1.0]]))
    assert not any(target.reached for target in found.targets.values())
    reasons = [target.reason for target in found.targets.values()]
    assert reasons[0].endswith("what would move it there moves width_mm away.")
    assert reasons[1].endswith("what would move it there moves height_mm away.")


def test_a_target_that_no_parameter_changes_is_named():
    targets = {"height_mm": (0.5, 0.1), "width_mm": (3.0, 0.1)}
    found = fit(Scene(), targets, BOTH, grower=Lines([[1.0, 0.3], [0.01, 0.0]]))
    assert found.targets["height_mm"].reached
    reason = str(found.targets["width_mm"].reason)
    assert "from bound to bound, spring_stiffness and contact_adhesion " in reason


def test_evaluations_that_ran_out_are_the_reason():
    targets = {"height_mm": (2.0, 0.1)}
    found = fit(Scene(), targets, WIDE, grower=Lines([[1.0]]), evaluations=1)
    reason = found.targets["height_mm"].reason
    assert reason.endswith("evaluations was used up; allow more.")
