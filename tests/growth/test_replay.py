"""Replay of a growth's choices, and derivatives along them."""

from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.parameters import Parameters
from jaxgrow.growth import boundary, choices
from jaxgrow.growth.grow import grow
from jaxgrow.lesions.myoma import Myoma
from jaxgrow.lesions.polyp import Polyp
from jaxgrow.metrics import shape_metrics
from jaxgrow.runtime.results import Result
from jaxgrow.scene.scene import Scene, Surroundings


POLYP = Scene(
    lesion=Polyp(divisions=8, particle_mm=1.5, divisions_per_step=1),
    surroundings=Surroundings(radius=4.0),
)
CLUSTER = Scene(organ=None, lesion=Myoma(divisions=11))
NARROW = Scene(
    lesion=Myoma(divisions=3, depth_mm=1.5, site="posterior", particle_mm=1.5),
    surroundings=Surroundings(radius=3.5, thickness=3.2),
)
MEETING = Scene(
    lesion=Polyp(divisions=4, particle_mm=1.5),
    surroundings=Surroundings(radius=4.0, collisions="on"),
)
THREE_AT_ONCE = Scene(
    lesion=Polyp(divisions=7, particle_mm=1.5, divisions_per_step=3),
    surroundings=Surroundings(radius=4.0),
)
MYOMA = Scene(
    lesion=Myoma(divisions=4, particle_mm=1.5),
    surroundings=Surroundings(radius=4.0, thickness=4.0),
)


def leaves(growth):
    return jax.tree.leaves((growth.state.particles, growth.state.membrane))


def arrays(scene=POLYP, **changed):
    return jax.tree.map(jnp.asarray, replace(scene.parameters, **changed))


@pytest.fixture(scope="module")
def polyp():
    return grow(POLYP, tolerance=1e-10)


@pytest.fixture(scope="module")
def cluster():
    return grow(CLUSTER, tolerance=1e-10)


def check_same(first, again):
    assert again.result is first.result is Result.REACHED
    assert len(again.history) == len(first.events)
    assert sum(record.steps for record in again.history) == 0
    for new, old in zip(leaves(again), leaves(first), strict=True):
        np.testing.assert_array_equal(new, old)
    assert again.size_mm == first.size_mm
    assert again.mended.get("patch_enlarged") == first.mended.get("patch_enlarged")


@pytest.mark.parametrize(
    "scene",
    [POLYP, CLUSTER, MEETING, MYOMA, THREE_AT_ONCE],
    ids=["polyp", "free", "meeting", "myoma", "three-at-once"],
)
def test_replay_gives_the_same_bits(scene):
    first = grow(scene, seed=3)
    meeting = scene is MEETING
    assert all(event.equilibrium.colliding is meeting for event in first.events)
    again = grow(scene, events=first.events)
    check_same(first, again)
    counted = [[record.division for record in g.history] for g in (first, again)]
    assert counted[0] == counted[1]
    if scene is THREE_AT_ONCE:
        assert counted[0] == [3, 6, 7]
        assert first.history[-1].tumour == 7


def test_replay_enlarges_the_patch_again(monkeypatch):
    with monkeypatch.context() as sensitive:  # one that feels mere rearrangements
        sensitive.setattr(boundary, "FORCE_CHANGE_LIMIT", 1e-3)
        sensitive.setattr(boundary, "SHARE", 0.0)
        sensitive.setattr(choices, "ENLARGEMENTS", 1)
        first = grow(NARROW, tolerance=1e-2)
    assert first.mended["patch_enlarged"] == 1
    assert any(event.enlargements for event in [first.events.start, *first.events])
    check_same(first, grow(NARROW, events=first.events))


def test_other_parameters_move_every_equilibrium_a_little(polyp):
    stiffer = grow(POLYP, parameters={"spring_stiffness": 0.0401}, events=polyp.events)
    assert stiffer.tolerance == 1e-10
    assert all(r.steps > 0 and r.residual <= 1e-10 for r in stiffer.history)
    gap = stiffer.state.membrane.vertices - polyp.state.membrane.vertices
    assert 1e-6 < np.abs(gap).max() < 1e-2


def test_events_of_another_lesion_are_refused(polyp):
    with pytest.raises(ValueError, match="events are those of a polyp with particles"):
        grow(MYOMA, events=polyp.events)


def test_events_are_a_sequence(polyp):
    assert len(polyp.events) == len(list(polyp.events)) == 8
    assert polyp.events[0].divisions[0].slot == polyp.events[1].divisions[0].slot - 1
    assert len(polyp.events[2:]) == 6
    assert polyp.events.parameters == POLYP.parameters


def metrics(parameters, scene, events=None, **more):
    shape = shape_metrics(
        grow(scene, parameters=parameters, events=events, **more).state
    )
    return jnp.stack([shape.volume_mm3, shape.tumour_diameter_mm])


def difference(scene, events, name, step):
    """Central difference along the frozen path, of fourth order."""
    value = float(getattr(scene.parameters, name))

    def at(factor):
        changed = arrays(scene, **{name: value + factor * step * value})
        return np.asarray(metrics(changed, scene, events, tolerance=1e-13))

    wide, narrow = at(2) - at(-2), at(1) - at(-1)
    return (8 * narrow - wide) / (12 * step * value)


@pytest.fixture(scope="module")
def slopes(polyp):
    """The reverse derivative of both metrics in all parameters."""
    value, pull = jax.vjp(lambda p: metrics(p, POLYP, polyp.events), arrays())
    return value, [pull(jnp.eye(2)[i])[0] for i in range(2)]


def test_value_under_a_derivative_is_that_of_the_growth(polyp, slopes):
    value, _ = slopes
    np.testing.assert_array_equal(value, metrics(POLYP.parameters, POLYP, polyp.events))


@pytest.mark.parametrize(
    "name",
    [
        *("spring_stiffness", "adhesion", "contact_range", "pretension"),
        *("focus_radius", "healthy_stiffness", "area_modulus", "bending_stiffness"),
    ],
)
def test_gradient_agrees_with_differences_along_the_frozen_path(polyp, slopes, name):
    weak = name in ("healthy_stiffness", "area_modulus")  # a small value or effect
    wanted = difference(POLYP, polyp.events, name, 1e-3 if weak else 1e-5)
    found = [float(getattr(slope, name)) for slope in slopes[1]]
    assert np.abs(wanted).min() > 0
    np.testing.assert_allclose(found, wanted, rtol=1e-5 if weak else 1e-6)


def test_where_a_daughter_is_put_has_no_derivative(slopes):
    assert all(float(slope.daughter_offset) == 0 for slope in slopes[1])


def test_every_parameter_has_a_finite_derivative(slopes):
    for slope in slopes[1]:
        assert all(np.isfinite(getattr(slope, f.name)) for f in fields(Parameters))


def test_forward_and_reverse_agree(polyp, slopes):
    start = arrays()
    along = jax.tree.map(lambda p: 0.1 + 0 * p, start)
    _, forward = jax.jvp(lambda p: metrics(p, POLYP, polyp.events), (start,), (along,))
    reverse = [sum(0.1 * s for s in jax.tree.leaves(slope)) for slope in slopes[1]]
    np.testing.assert_allclose(forward, reverse, rtol=1e-7)


def test_gradient_needs_no_events(polyp, slopes):
    slope = jax.grad(lambda p: metrics(p, POLYP)[0])(arrays())
    for new, old in zip(*map(jax.tree.leaves, (slope, slopes[1][0])), strict=True):
        np.testing.assert_allclose(new, old, rtol=1e-6, atol=1e-9)


def test_free_cluster_shrinks_with_adhesion_as_its_gradient_says(cluster):
    def diameter(parameters, **more):
        return metrics(parameters, CLUSTER, cluster.events, **more)[1]

    slope = jax.grad(diameter)(arrays(CLUSTER))
    value = float(CLUSTER.parameters.adhesion)
    at = [
        float(diameter(arrays(CLUSTER, adhesion=value + s * 1e-4), tolerance=1e-13))
        for s in (1, -1)
    ]
    assert slope.adhesion < 0
    np.testing.assert_allclose(slope.adhesion, (at[0] - at[1]) / 2e-4, rtol=1e-5)


def test_collisions_have_derivatives_too():
    events = grow(MEETING, tolerance=1e-10).events
    slope = jax.grad(lambda p: metrics(p, MEETING, events)[0])(arrays(MEETING))
    wanted = difference(MEETING, events, "spring_stiffness", 1e-5)[0]
    np.testing.assert_allclose(slope.spring_stiffness, wanted, rtol=1e-5)


def test_replay_that_finds_no_equilibrium_says_so(polyp):
    far = replace(POLYP.parameters, spring_stiffness=1e9)
    ended = grow(POLYP, parameters=far, events=polyp.events)
    assert not ended.result.success
    assert len(ended.history) < 8 or ended.history[-1].result != "CONVERGED"
