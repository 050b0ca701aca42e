"""Steps without a valid equilibrium are made again, of fewer or other divisions."""

import numpy as np
import pytest

import jaxgrow as jg
from jaxgrow.growth import loop
from jaxgrow.runtime.timer import Clock


SCENE = jg.Scene(organ=None, lesion=jg.Myoma(divisions=9, divisions_per_step=4))


@pytest.fixture
def failing(monkeypatch):
    """The numbers of divisions asked for, in a growth of which some steps fail."""
    asked, make = [], loop.grow_step

    def of(failures, result=jg.Result.STEP_LIMIT, after=0):
        def grow_step(setup, now, choices, clock, count):
            asked.append(count)
            step = make(setup, now, choices, clock, count)
            if not after < len(asked) <= after + failures:
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


@pytest.mark.parametrize(
    "share, result",
    [(0.98, jg.Result.REACHED), (0.96, jg.Result.STEP_LIMIT)],
    ids=["little", "more"],
)
def test_what_lacks_little_and_cannot_grow_on_has_its_size(failing, share, result):
    def scene(size_mm):
        lesion = jg.Myoma(size_mm=size_mm, particle_mm=1.0)
        return jg.Scene(organ=None, lesion=lesion)

    sizes = []
    jg.grow(scene(4.0), seed=3, progress=lambda told: sizes.append(told.size_mm))
    largest = max(sizes[:-1])
    failing(99, after=sizes.index(largest) + 1)
    growth = jg.grow(scene(largest / share), seed=3)
    assert growth.result is result
    assert float(growth.size_mm) == largest
    failing(0)
    assert jg.grow(scene(largest / share), events=growth.events).result is result
