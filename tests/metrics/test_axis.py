"""Metrics along the axes of leaning and bent lesions, whose sections are known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxgrow.metrics import shape_metrics

from ..quick_jit import quick_jit
from .surfaces import bent, cap, cylinder, disc_of, flared, leaning, mesh, roomy


MUSHROOM, TOP = flared(neck=2.0, foot=1.5, stalk=5.0, head=4.0)
WIDE_FOOT, WIDE_TOP = flared(neck=1.5, foot=3.0, stalk=4.0, head=3.0)


def right(degrees):
    return np.radians(degrees)


# profile, how it is turned, and length, width, neck, bend in degrees
CASES = {
    "upright tube": (cylinder(2.0, 8.0), lambda v: v, (10, 4, 4, 0)),
    "leaning tube": (
        cylinder(2.0, 8.0),
        lambda v: leaning(v, right(40), 2.0, 8.0),
        (10, 4, 4, 0),
    ),
    "tube bent by a right angle": (
        cylinder(2.0, 10.0),
        lambda v: bent(v, right(90), 10.0),
        (12, 4, 4, 90),
    ),
    "finger bent by 150 degrees": (
        cylinder(1.5, 16.0),
        lambda v: bent(v, right(150), 16.0),
        (17.5, 3, 3, 150),
    ),
    "mushroom": (MUSHROOM, lambda v: v, (TOP, 8, 4, 0)),
    "tilted mushroom": (MUSHROOM, lambda v: bent(v, right(50), 6.0), (TOP, 8, 4, 50)),
    "mushroom with a foot as wide as its head": (
        WIDE_FOOT,
        lambda v: v,
        (WIDE_TOP, 6, 3, 0),
    ),
    "tilted mushroom with such a foot": (
        WIDE_FOOT,
        lambda v: bent(v, right(30), 6.0),
        (WIDE_TOP, 6, 3, 30),
    ),
    "dome": (cap(4.0, 3.0), lambda v: v, (3, 7.416, 7.416, 0)),
    "flat dome": (cap(5.0, 2.0), lambda v: v, (2, 7.141, 7.141, 0)),
}


@pytest.fixture(scope="module")
def case(make_state):
    """The state of a lesion, and its vertices and faces."""

    def of(name):
        profile, turned, _ = CASES[name]
        vertices, faces, rim = mesh(profile, 0.8)
        surface = turned(vertices), faces, rim
        return roomy(make_state(surface, disc_of(vertices, rim))), surface

    return of


@pytest.mark.parametrize("name", list(CASES))
def test_lengths_are_those_along_and_across_the_axis(case, name):
    length, width, neck, _ = CASES[name][2]
    found = shape_metrics(case(name)[0])
    np.testing.assert_allclose(found.length_mm, length, rtol=0.03)
    np.testing.assert_allclose(found.width_mm, width, rtol=0.03)
    np.testing.assert_allclose(found.neck_width_mm, neck, rtol=0.03)
    np.testing.assert_allclose(
        [found.length_to_width, found.neck_to_width],
        [found.length_mm / found.width_mm, found.neck_width_mm / found.width_mm],
        rtol=1e-12,
    )


@pytest.mark.parametrize("name", list(CASES))
def test_bend_is_the_turning_of_the_axis(case, name):
    bend, turning = shape_metrics(case(name)[0]).bend_deg, CASES[name][2][3]
    if name == "tilted mushroom":  # all in the stalk, which is less than a third
        assert 15 < bend < turning
    else:
        np.testing.assert_allclose(bend, turning, atol=12)


@pytest.mark.parametrize(
    "name, lean", [("upright tube", 0), ("leaning tube", 40), ("dome", 0)]
)
def test_lean_is_the_chord_of_the_axis_against_the_normal(case, name, lean):
    np.testing.assert_allclose(shape_metrics(case(name)[0]).lean_deg, lean, atol=2)


def test_stalk_and_head_of_a_mushroom_meet_halfway_between_their_widths(case):
    found = shape_metrics(case("mushroom")[0])
    # where a sphere of radius 4 is as wide as a circle of 6, below its middle
    head = 4 + np.sqrt(16 - 9)
    np.testing.assert_allclose(found.head_length_mm, head, rtol=0.03)
    # and where the foot, a torus, is
    foot = 1.5 * (1 - np.sqrt(1 - (0.5 / 1.5) ** 2))
    stalk = TOP - head - foot
    np.testing.assert_allclose(found.stalk_length_mm, stalk, atol=0.5)


@pytest.mark.parametrize("name", ["dome", "flat dome", "upright tube"])
def test_a_lesion_without_a_neck_is_all_head(case, name):
    found = shape_metrics(case(name)[0])
    assert found.stalk_length_mm == 0
    assert found.head_length_mm == found.length_mm
    assert found.neck_to_width > 0.97


@pytest.mark.parametrize(
    "name, height, radius",
    [("mushroom", 5.0, 2.0), ("mushroom", 10.0, 4.0), ("upright tube", 5.0, 2.0)],
)
def test_widths_are_those_of_plane_cuts_of_the_mesh(case, name, height, radius):
    """An independent way: plane cuts of the mesh, and the areas of their outlines."""
    _, (vertices, faces, _) = case(name)
    cut = trimesh.Trimesh(vertices, faces, process=False).section(
        [0, 0, 1], [0, 0, height]
    )
    outline = np.asarray(cut.discrete[0])
    x, y, _ = outline.T
    area = abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) / 2
    wide = 2 * np.sqrt(area / np.pi)
    found = shape_metrics(case(name)[0])
    which = found.width_mm if radius == 4.0 else found.neck_width_mm
    np.testing.assert_allclose(which, wide, rtol=0.01)


NAMES = ["length_mm", "width_mm", "neck_width_mm", "base_width_mm", "lean_deg"]
NAMES += ["head_length_mm", "stalk_length_mm", "bend_deg", "contact_angle_deg"]
NAMES += ["sphericity", "area_mm2"]


@pytest.fixture(scope="module")
def rows(case):
    """The metrics of a membrane whose vertices are given, and these."""
    state, _ = case("tilted mushroom")

    def measure(vertices):
        at = eqx.tree_at(lambda s: s.membrane.vertices, state, vertices)
        found = shape_metrics(at, smoothing=0.1)
        return jnp.stack([getattr(found, name) for name in NAMES])

    return measure, state.membrane.vertices


def test_derivatives_of_a_tilted_mushroom_are_those_of_differences(rows):
    measure, vertices = rows
    along = np.random.default_rng(0).normal(size=vertices.shape)
    push = quick_jit(lambda at, by: jax.jvp(measure, (at,), (by,))[1])
    slope = push(vertices, jnp.asarray(along))
    h = 1e-5  # below it the rounding of the solved field shows
    up, down = measure(vertices + h * along), measure(vertices - h * along)
    np.testing.assert_allclose(slope, (up - down) / (2 * h), rtol=5e-4, atol=1e-5)


def test_small_changes_of_positions_change_the_metrics_little(rows):
    measure, vertices = rows
    noise = 1e-5 * np.random.default_rng(1).normal(size=vertices.shape)
    before, after = measure(vertices), measure(vertices + noise)
    np.testing.assert_allclose(after, before, rtol=1e-3, atol=1e-3)
