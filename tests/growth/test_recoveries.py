"""A relaxation that fails is tried again; particles that fly apart are noticed."""

import equinox as eqx
import numpy as np
import pytest

from jaxgrow.energy.a2 import CUTOFF
from jaxgrow.growth import adaptation
from jaxgrow.runtime.results import Result
from jaxgrow.transfer.device import get_particles

from .free_clusters import free, nearest


def test_relaxation_that_fails_ends_the_growth_with_the_last_equilibrium(
    monkeypatch, thirty
):
    monkeypatch.setattr(adaptation, "ATTEMPTS", ((0.1, 1), (0.025, 1)))
    ended = free(tolerance=1e-12)
    assert ended.result is Result.STEP_LIMIT
    assert len(ended.history) == len(ended.events) + 1 < 5
    assert ended.history[-1].result == "STEP_LIMIT"
    assert ended.history[-1].mended == {
        "retried_after_step_limit": 1,
        "step_redrawn": 3,
    }
    count = int(ended.state.particles.alive.sum())
    assert count == 1 + len(ended.events)


def test_relaxation_that_fails_is_tried_again_with_shorter_steps(monkeypatch, thirty):
    monkeypatch.setattr(adaptation, "ATTEMPTS", ((0.1, 1), (0.1, 1500)))
    mended = free()
    assert mended.result is thirty.result
    retried = [r.mended.get("retried_after_step_limit", 0) for r in mended.history]
    assert sum(retried) > 10
    # from where the first attempt started, not from where it ended
    np.testing.assert_array_equal(
        mended.state.particles.position, thirty.state.particles.position
    )


def test_cluster_that_flies_apart_is_no_equilibrium(monkeypatch):
    real = adaptation.relax

    def throw(particles, *rest, **more):
        outcome = real(particles, *rest, **more)
        far = eqx.tree_at(
            lambda p: p.position, outcome.state[0], replace_fn=lambda x: 9 * x
        )
        return outcome._replace(state=(far, None))

    monkeypatch.setattr(adaptation, "relax", throw)
    ended = free(divisions=3)
    assert ended.result is Result.EVAPORATED
    assert len(ended.events) == 0
    assert ended.history[-1].mended == {
        "retried_after_evaporated": 1,
        "step_redrawn": 3,
    }


@pytest.mark.parametrize(
    "factor, apart", [(1.0, False), (1.15, False), (1.4, True), (4.0, True)]
)
def test_particles_that_fly_apart_are_noticed(thirty, factor, apart):
    """A jump of the radius of gyration, though everybody keeps a neighbour to 1.5."""
    before = thirty.state.particles
    after = eqx.tree_at(lambda p: p.position, before, factor * before.position)
    nearest_after = nearest(get_particles(after)[0])
    assert (nearest_after.max() < 1.5) == (factor < 4)
    assert adaptation._flew_apart(before, after) is apart


@pytest.mark.parametrize("moved", [0, 5, 200])
@pytest.mark.parametrize("scattered", [0, 3, 9, 40])
def test_particles_that_lost_their_neighbours_are_counted(moved, scattered):
    rng = np.random.default_rng(0)
    old = rng.uniform(-4, 4, (400, 3))
    old[:3] += 50 * np.arange(1, 4)[:, None]  # they have none from the beginning
    new, chosen = old.copy(), rng.permutation(400)
    new[chosen[:moved]] += 0.1 * rng.normal(size=(moved, 3))
    new[chosen[:scattered]] += 30 + 9 * np.arange(scattered)[:, None]
    alone = [int(np.count_nonzero(nearest(at) >= CUTOFF)) for at in (old, new)]
    wanted = alone[1] > alone[0] + 0.02 * 400
    assert adaptation._lost(old, new) is bool(wanted)
    assert wanted == (scattered > 8)


def test_two_that_keep_away_from_each_other_are_apart():
    old = np.array([[0.0, 0, 0], [1, 0, 0]])
    assert adaptation._lost(old, 9 * old)
    assert not adaptation._lost(9 * old, 10 * old)
