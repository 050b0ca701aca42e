"""Foci of hyperplasia: marks, emitting vertices, stalks and lobes."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrow as jg
from jaxgrow.energy.healthy import HealthySprings
from jaxgrow.energy.springs import Springs
from jaxgrow.lesions.focus import (
    draw_emitters,
    emitting,
    least_distance,
    mark_foci,
    spread_out,
    vertex_areas,
)
from jaxgrow.mesh.fairing import fair
from jaxgrow.state import Frame, Particles, State
from jaxgrow.transfer.device import get_surface, put_remeshed


def sheet(side=13, spacing=0.8):
    """A flat square sheet, its centre at the origin."""
    y, x = spacing * (np.mgrid[:side, :side] - side // 2)
    vertices = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    index = np.arange(side * side).reshape(side, side)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return jg.make_membrane(vertices, faces)


FRAME = Frame(jnp.zeros(3), jnp.array([0.0, 0.0, 1.0]), jnp.asarray(1.0), None)
NOBODY = Particles(
    jnp.zeros((1, 3)), jnp.zeros(1, int), jnp.zeros(1, bool), jnp.zeros(1, bool)
)


def state_of(membrane):
    return State(NOBODY, membrane, FRAME)


@pytest.fixture(scope="module")
def flat():
    return sheet()


@pytest.fixture(scope="module")
def centre(flat):
    return int(np.linalg.norm(np.asarray(flat.vertices), axis=1).argmin())


def distance(membrane, vertex):
    points = np.asarray(membrane.vertices)
    return np.linalg.norm(points - points[vertex], axis=1)


def test_marks_are_one_inside_and_zero_far_outside(flat, centre):
    marked = mark_foci(state_of(flat), (centre,), 2.0).membrane
    far = distance(flat, centre)
    marks = np.asarray(marked.hyperplasia)
    np.testing.assert_array_equal(marks[far <= 2.0], 1)
    np.testing.assert_array_equal(marks[far >= 3.0], 0)
    between = (far > 2.05) & (far < 2.95)
    share = 3 - far[between]
    np.testing.assert_allclose(marks[between], share**2 * (3 - 2 * share), atol=1e-12)
    assert int(marked.source) == -1


def test_marks_of_several_foci_are_those_of_the_nearest(flat):
    centres = (40, 120)
    both = np.asarray(mark_foci(state_of(flat), centres, 1.5).membrane.hyperplasia)
    one, other = (
        np.asarray(mark_foci(state_of(flat), (c,), 1.5).membrane.hyperplasia)
        for c in centres
    )
    np.testing.assert_allclose(both, np.maximum(one, other), atol=1e-14)


def test_marks_are_differentiable_in_the_radius(flat, centre):
    def total(radius):
        return mark_foci(state_of(flat), (centre,), radius).membrane.hyperplasia.sum()

    step = 1e-6
    wanted = (total(2.3 + step) - total(2.3 - step)) / (2 * step)
    found = jax.grad(total)(2.3)
    assert found > 0.1
    np.testing.assert_allclose(found, wanted, rtol=1e-7)


def lifted(membrane, height=1.0):
    """The sheet with a smooth hill, the reference being flat."""
    points = np.asarray(membrane.vertices)
    hill = height * np.exp(-(points[:, 0] ** 2 + points[:, 1] ** 2) / 4)
    return membrane.at(jnp.asarray(points + hill[:, None] * [0.0, 0, 1]))


def test_healthy_edges_remember_their_reference_and_hyperplastic_ones_do_not(
    flat, centre
):
    marked = mark_foci(state_of(flat), (centre,), 1.5).membrane
    hill = lifted(marked)
    rest = np.asarray(HealthySprings().at_rest(hill))
    edges = np.asarray(flat.edges)
    flat_length = np.linalg.norm(
        np.diff(np.asarray(flat.vertices)[edges], axis=1), axis=2
    )
    np.testing.assert_allclose(rest[:, 0], flat_length[:, 0], atol=1e-14)
    ends = distance(flat, centre)[edges]
    np.testing.assert_array_equal(rest[(ends <= 1.5).any(axis=1), 1], 0)
    np.testing.assert_array_equal(rest[(ends >= 2.25).all(axis=1), 1], 1)
    # the springs of the paper are reset everywhere
    lengths = np.asarray(Springs().at_rest(hill))[:, 0]
    now = np.linalg.norm(np.diff(np.asarray(hill.vertices)[edges], axis=1), axis=2)
    np.testing.assert_allclose(lengths, now[:, 0], atol=1e-14)


def test_remeshing_carries_marks_and_reference_like_positions(flat, centre):
    marked = mark_foci(state_of(flat), (centre,), 1.5).membrane
    stretched = marked.at(2.0 * marked.vertices)
    _, remeshing = fair(get_surface(stretched), np.zeros((0, 3)), max_area=0.7)
    assert remeshing.counts["quaternary"] > 0
    after = put_remeshed(stretched, remeshing)
    alive = np.asarray(after.vertex_alive)
    # both are affine in the positions, so midpoints have exactly their values
    np.testing.assert_allclose(
        np.asarray(after.reference)[alive],
        0.5 * np.asarray(after.vertices)[alive],
        atol=1e-12,
    )
    wanted = remeshing.apply(np.asarray(marked.hyperplasia))
    np.testing.assert_array_equal(np.asarray(after.hyperplasia)[alive], wanted)


def test_emitters_are_different_vertices_of_the_focus_drawn_by_area(flat, centre):
    marked = mark_foci(state_of(flat), (centre,), 1.5).membrane
    inside = emitting(marked)
    rng, counts = np.random.default_rng(3), np.zeros(len(inside))
    for _ in range(400):
        drawn = draw_emitters(marked, 4, rng)
        assert len(set(drawn)) == 4
        counts[list(drawn)] += 1
    assert not counts[~inside].any()
    assert (counts[inside] > 0).all()
    area = vertex_areas(get_surface(marked))
    assert np.isclose(area.sum(), (12 * 0.8) ** 2)
    few = draw_emitters(marked, 1000, rng)
    assert sorted(few) == list(np.flatnonzero(inside))


def test_every_focus_emits_equally_often_whatever_its_area(flat):
    one, other = 3 * 13 + 3, 9 * 13 + 9
    state = mark_foci(state_of(flat), (one, other), 1.0)
    wide = mark_foci(state_of(flat), (other,), 2.2)
    marks = jnp.maximum(state.membrane.hyperplasia, wide.membrane.hyperplasia)
    both = dataclasses.replace(state.membrane, hyperplasia=marks)
    small = distance(flat, one) < 1.5
    rng = np.random.default_rng(0)
    drawn = [draw_emitters(both, 1, rng)[0] for _ in range(600)]
    share = small[drawn].mean()
    assert abs(share - 0.5) < 4 * 0.5 / np.sqrt(600)
    assert emitting(both)[small].sum() < 0.4 * emitting(both).sum()


def test_focus_without_a_free_vertex_emits_nothing(flat):
    pinned = dataclasses.replace(flat, pinned=jnp.ones_like(flat.pinned))
    marked = mark_foci(state_of(pinned), (0,), 2.0).membrane
    assert draw_emitters(marked, 3, np.random.default_rng(0)) == ()


@pytest.mark.parametrize("count", [2, 3, 5])
def test_lobes_are_spread_evenly_over_the_upper_half(flat, centre, count):
    hill = lifted(flat, 5.0)
    marked = mark_foci(state_of(hill), (centre,), 6.0).membrane
    found = spread_out(marked, count, FRAME)
    assert len(set(found)) == count
    heights = np.asarray(hill.vertices)[:, 2]
    assert (heights[list(found)] >= 0.5 * heights.max() - 1e-9).all()
    apart = least_distance(state_of(marked), found)
    points = np.asarray(hill.vertices)[heights >= 2.5]
    across = np.linalg.norm(points[:, None] - points[None], axis=2).max()
    assert apart > 0.25 * across


SCENE = jg.Scene(
    lesion=jg.Polyp(divisions=24, particle_mm=1.2, stalk_mm=0.4), parameters={}
)


@pytest.fixture(scope="module")
def stalked():
    return jg.grow(SCENE, seed=2)


def test_stalk_grows_from_its_source_and_then_the_focus_emits(stalked):
    assert stalked.result is jg.Result.REACHED
    with_foci = [event for event in stalked.events if event.foci]
    assert len(with_foci) == 2
    assert stalked.events[0].foci
    sources = [[d.source for d in event.divisions] for event in stalked.events]
    second = next(i for i, e in enumerate(stalked.events) if i and e.foci)
    assert all(len(set(own)) == 1 for own in sources[:second])
    assert len({s for own in sources[second:] for s in own}) > 3
    assert int(stalked.state.membrane.source) == -1


def test_growth_with_foci_replays_to_the_bit(stalked):
    again = jg.grow(SCENE, events=stalked.events)
    for a, b in zip(
        jax.tree.leaves(again.state), jax.tree.leaves(stalked.state), strict=True
    ):
        np.testing.assert_array_equal(a, b)


def test_growth_with_foci_goes_on_to_the_same_bits(stalked):
    fewer = SCENE.model_copy(
        update={"lesion": SCENE.lesion.model_copy(update={"divisions": 8})}
    )
    first = jg.grow(fewer, seed=2)
    on = jg.grow(SCENE, after=first)
    np.testing.assert_array_equal(
        on.state.particles.position, stalked.state.particles.position
    )


def test_paper_has_one_source_and_resets_every_spring():
    lesion = jg.Polyp(divisions=3, particle_mm=1.2, focus_mm=0.0)
    growth = jg.grow(jg.Scene(lesion=lesion), seed=0)
    membrane = growth.state.membrane
    assert int(membrane.source) >= 0
    assert not any(event.foci for event in growth.events)
    np.testing.assert_array_equal(np.asarray(membrane.hyperplasia), 1)
    assert len({d.source for e in growth.events for d in e.divisions}) == 1


def test_radius_of_the_focus_is_asked_for_in_millimetres_or_as_a_parameter():
    scene = jg.Scene(lesion=jg.Polyp(size_mm=12.0, focus_mm=2.0))
    assert scene.parameters.focus_radius == pytest.approx(2.0)
    with pytest.raises(ValueError, match="determines focus_radius already"):
        jg.Scene(lesion=jg.Polyp(focus_mm=2.0), parameters={"focus_radius": 1.0})


def test_small_focus_has_a_flexible_lining_by_default():
    def bending(focus=None, **given):
        lesion = jg.Polyp(size_mm=12, focus_mm=focus)
        return jg.Scene(lesion=lesion, parameters=given).parameters.bending_stiffness

    usual = jg.Polyp.mechanics["bending_stiffness"]
    assert bending() == bending(1.5) == bending(4.0) == bending(0.0) == usual
    np.testing.assert_allclose(bending(0.5), usual / 3**1.5)
    assert bending(0.5, bending_stiffness=0.01) == 0.01
