"""When a growth ends: where its cavity is full, and where it is not."""

import numpy as np

from jaxgrow.growth.history import StepRecord
from jaxgrow.growth.stopping import (
    GrowthLimits,
    last_result,
    STAGNATION,
    stop_reason,
    Stopping,
)
from jaxgrow.lesions.polyp import Polyp
from jaxgrow.runtime.results import Result
from jaxgrow.scene.scene import Scene


def records(sizes, colliding=True, each=1):
    figures = {"residual": 0.0, "steps": 1, "method": "lbfgs", "result": "CONVERGED"}
    counts = {"particles": 2, "tumour": 2, "colliding": colliding}
    return [
        StepRecord(number * each, size, size / 10, **figures, **counts)
        for number, size in enumerate(sizes, 1)
    ]


def reason(scene, divisions, past):
    return stop_reason(scene.lesion, Stopping(0.7, divisions, past, GrowthLimits(3000)))


def test_cavity_is_full_when_divisions_against_a_wall_hardly_enlarge():
    scene = Scene(lesion=Polyp(size_mm=10.0))
    growing, stuck = [float(x) for x in np.linspace(1, 7, 70)], [7.1] * STAGNATION
    for sizes, colliding, wanted in (
        (growing, True, Result.CONVERGED),
        (growing + stuck, True, Result.CAVITY_FULL),
        (growing + stuck[1:], True, Result.CONVERGED),
        (growing + stuck, False, Result.CONVERGED),
        ([*growing, *stuck, 7.3], True, Result.CONVERGED),
    ):
        past = records(sizes, colliding)
        assert reason(scene, len(past), past) is wanted


def test_divisions_against_a_wall_are_counted_not_their_iterations():
    scene = Scene(lesion=Polyp(size_mm=10.0, divisions_per_step=4))
    growing, stuck = [float(x) for x in np.linspace(1, 7, 45)], [7.1] * STAGNATION
    for several, wanted in (
        (STAGNATION // 4, Result.CAVITY_FULL),
        (STAGNATION // 4 - 1, Result.CONVERGED),
    ):
        past = records([*growing, *stuck[:several]], each=4)
        assert reason(scene, 4 * len(past), past) is wanted


def test_what_lacks_little_in_a_full_cavity_has_its_size():
    scene = Scene(lesion=Polyp(size_mm=10.0))
    past = records([*np.linspace(1, 7, 70), *[7.1] * STAGNATION])
    for share, wanted in ((0.96, Result.CAVITY_FULL), (0.98, Result.REACHED)):
        now = Stopping(share, len(past), past, GrowthLimits(3000))
        assert stop_reason(scene.lesion, now) is wanted


def test_a_full_cavity_may_be_what_was_asked_for():
    past = records([*np.linspace(1, 7, 70), *[7.1] * STAGNATION])
    now = Stopping(0.5, len(past), past, GrowthLimits(3000))
    for filling, wanted in ((False, Result.CAVITY_FULL), (True, Result.REACHED)):
        lesion = Polyp(size_mm=30.0, fills_cavity=filling)
        assert stop_reason(lesion, now) is wanted
        assert last_result(lesion, Result.SLIVER, 0.5) is Result.SLIVER


def test_a_bound_is_no_reason_to_be_content():
    lesion = Scene(lesion=Polyp(size_mm=10.0)).lesion
    for result in (Result.TIME_LIMIT, Result.DIVISION_LIMIT, Result.CONVERGED):
        assert last_result(lesion, result, 0.99) is result
    assert last_result(Polyp(divisions=5), Result.SLIVER, 0.99) is Result.SLIVER


def test_divisions_asked_for_are_not_a_size():
    scene = Scene(lesion=Polyp(divisions=500))
    past = records([7.0] * 200)
    assert reason(scene, len(past), past) is Result.CONVERGED
