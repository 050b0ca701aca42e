"""Steps without a valid equilibrium are made again, of fewer or other divisions."""

import numpy as np
import pytest

import jaxgrow as jg
from jaxgrow.growth import loop
from jaxgrow.runtime.timer import Clock


SCENE = jg.Scene(organ=None, lesion=jg.Myoma(divisions=9, divisions_per_step=4))


@pytest.fixture
def failing(monkeypatch):
    """The numbers of divisions asked for, in a growth whose first steps fail."""
    asked, make = [], loop.grow_step

    def of(failures, result=jg.Result.STEP_LIMIT):
        def grow_step(setup, now, choices, clock, count):
            asked.append(count)
            step = make(setup, now, choices, clock, count)
            if len(asked) > failures:
                return step
            return loop.StepResult(now, result, step.event, step.settled)

        monkeypatch.setattr(loop, "grow_step", grow_step)
        return asked

    return of


def test_step_is_made_again_with_half_as_many_divisions(failing):
    asked = failing(2)
    growth = jg.grow(SCENE, seed=3)
    assert asked == [4, 2, 1, 4, 4, 2]
    assert growth.result is jg.Result.REACHED
    assert growth.events.divisions == 9
    assert growth.mended["step_redrawn"] == 2
    assert [record.division for record in growth.history] == [1, 3, 7, 9]


def test_what_failed_is_in_no_replay(failing):
    failing(2)
    growth = jg.grow(SCENE, seed=3)
    again = jg.grow(SCENE, events=growth.events)
    one, other = growth.state.particles, again.state.particles
    np.testing.assert_array_equal(one.position, other.position)


def test_it_ends_after_the_third_failure(failing):
    asked = failing(99)
    growth = jg.grow(SCENE, seed=3)
    assert asked == [4, 2, 1, 1]
    assert growth.result is jg.Result.STEP_LIMIT
    assert growth.events.divisions == 0


def test_other_ends_are_ends(failing):
    asked = failing(99, jg.Result.SLIVER)
    assert jg.grow(SCENE, seed=3).result is jg.Result.SLIVER
    assert asked == [4]


def test_no_step_is_made_again_after_the_time_limit(failing, monkeypatch):
    asked = failing(99)
    monkeypatch.setattr(Clock, "elapsed", property(lambda _: 10.0 * len(asked)))
    assert jg.grow(SCENE, seed=3, max_seconds=5).result is jg.Result.STEP_LIMIT
    assert asked == [4]
