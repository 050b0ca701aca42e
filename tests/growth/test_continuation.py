"""Growths that are watched, stopped, interrupted, and go on."""

import pickle
import signal

import numpy as np
import pytest

import jaxgrow as jg


CLUSTER = jg.Scene(organ=None, lesion=jg.Myoma(divisions=11))
POLYP = jg.Scene(
    lesion=jg.Polyp(divisions=8, particle_mm=1.5, divisions_per_step=1),
    surroundings=jg.Surroundings(radius=4.0),
)


def bits(growth):
    """All that a growth ends with, to the last bit."""
    membrane = growth.state.membrane
    surface = () if membrane is None else (membrane.vertices, membrane.faces)
    arrays = (growth.state.particles.position, *surface)
    return [np.asarray(array).tobytes() for array in arrays]


@pytest.fixture(scope="module", params=[CLUSTER, POLYP], ids=["cluster", "polyp"])
def whole(request):
    return jg.grow(request.param, seed=2)


def test_growth_that_goes_on_has_the_bits_of_one_that_never_ended(whole):
    short = jg.grow(whole.scene, seed=2, max_divisions=3)
    assert short.result is jg.Result.DIVISION_LIMIT
    assert bits(short) != bits(whole)
    longer = jg.grow(after=short)
    assert longer.result is jg.Result.REACHED
    assert longer.seed == 2
    assert bits(longer) == bits(whole)
    assert longer.events.divisions == whole.events.divisions
    assert [r.division for r in longer.history] == [r.division for r in whole.history]
    # what it goes on from is as it was
    assert bits(jg.grow(after=short)) == bits(whole)


def test_growth_that_went_on_can_be_replayed(whole):
    longer = jg.grow(after=jg.grow(whole.scene, seed=2, max_divisions=3))
    assert bits(jg.grow(whole.scene, events=longer.events)) == bits(whole)


def test_growth_goes_on_in_another_process(whole):
    short = jg.grow(whole.scene, seed=2, max_divisions=3)
    longer = jg.grow(after=pickle.loads(pickle.dumps(short)))
    assert longer.result is jg.Result.REACHED
    assert longer.history[-1].residual <= 1e-3
    # who divides is drawn as there, and where it is to the tolerance
    parents = [
        [d.parent for e in g.events for d in e.divisions] for g in (longer, whole)
    ]
    assert parents[0] == parents[1]


def test_growth_goes_on_to_another_number_of_divisions():
    larger = jg.Scene(organ=None, lesion=jg.Myoma(divisions=14))
    longer = jg.grow(larger, after=jg.grow(CLUSTER, seed=2))
    assert longer.events.divisions == 14
    np.testing.assert_allclose(
        longer.state.particles.position[:15],
        jg.grow(larger, seed=2).state.particles.position[:15],
        atol=1e-9,
    )


def test_what_watches_a_growth_sees_its_state_and_may_end_it(whole):
    seen = []

    def watch(progress):
        seen.append(progress)
        return progress.divisions == 4

    stopped = jg.grow(whole.scene, seed=2, progress=watch)
    assert stopped.result is jg.Result.STOPPED
    assert stopped.events.divisions == 4
    assert [p.divisions for p in seen] == [1, 2, 3, 4]
    last = seen[-1].state
    np.testing.assert_array_equal(
        last.particles.position, stopped.state.particles.position
    )
    assert bits(jg.grow(after=stopped)) == bits(whole)


def test_interrupted_growth_is_not_lost(whole):
    # a shell makes its background jobs ignore Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def interrupt(progress):
        if progress.divisions == 4:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt) as caught:
        jg.grow(whole.scene, seed=2, progress=interrupt)
    growth = caught.value.growth
    assert isinstance(caught.value, jg.GrowthInterrupted)
    assert growth.result is jg.Result.INTERRUPTED
    assert growth.events.divisions == 4
    assert bits(jg.grow(after=growth)) == bits(whole)


def test_interrupt_keeps_its_growth_between_processes(tiny_cluster):
    from jaxgrow.growth.grow import GrowthInterrupted

    sent = pickle.loads(pickle.dumps(GrowthInterrupted(tiny_cluster)))
    assert isinstance(sent, GrowthInterrupted)
    assert bits(sent.growth) == bits(tiny_cluster)
    assert str(sent) == str(GrowthInterrupted(tiny_cluster))


def test_interrupted_step_was_never_made(whole, monkeypatch):
    from jaxgrow.growth import choices

    real, calls = choices.settle, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 5:
            raise KeyboardInterrupt
        return real(*arguments)

    monkeypatch.setattr(choices, "settle", interrupted)
    with pytest.raises(jg.GrowthInterrupted) as caught:
        jg.grow(whole.scene, seed=2)
    monkeypatch.undo()
    growth = caught.value.growth
    assert growth.events.divisions == len(growth.history) == 4
    assert bits(jg.grow(after=growth)) == bits(whole)


@pytest.mark.parametrize(
    "more, message",
    [
        ({"tolerance": 1e-5}, "goes on as it began"),
        ({"parameters": jg.Parameters()}, "goes on as it began"),
        ({"scene": POLYP}, "are those of a myoma"),
        (
            {
                "scene": jg.Scene(
                    organ=None, lesion=jg.Myoma(divisions=20, site="isthmus")
                )
            },
            "differs from that of the growth",
        ),
    ],
)
def test_growth_goes_on_in_its_own_scene_alone(more, message):
    short = jg.grow(CLUSTER, max_divisions=2)
    with pytest.raises(ValueError, match=message):
        jg.grow(**more, after=short)


def test_replay_cannot_go_on():
    short = jg.grow(CLUSTER, max_divisions=2)
    again = jg.grow(CLUSTER, events=short.events)
    with pytest.raises(ValueError, match="cannot go on"):
        jg.grow(after=again)


def test_nothing_to_grow_is_refused():
    with pytest.raises(ValueError, match="nothing to grow"):
        jg.grow()


def test_history_is_a_table(whole):
    rows = [record.as_dict() for record in whole.history]
    assert [row["division"] for row in rows] == list(range(1, len(rows) + 1))
    surfaced = whole.state.membrane is not None
    assert ("vertices" in rows[0]) is surfaced
    assert all(isinstance(record, jg.StepRecord) for record in whole.history)
