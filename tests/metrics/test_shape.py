"""Shape metrics of polyhedra of revolution, whose measures are closed forms."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrow.metrics import shape_metrics
from jaxgrow.state import State

from .polyhedra import (
    bumpy,
    flattened,
    NAMES,
    OF_TUMOUR,
    PROFILES,
    SECTOR,
    SEGMENTS,
)


LENGTHS = {"height_mm", "length_mm", "width_mm", "neck_width_mm", "body_diameter_mm"}
# that follow from smooth lengths
FOLLOWING = {
    "height_to_width",
    "length_to_width",
    "neck_to_width",
    "head_length_mm",
    "stalk_length_mm",
    "intracavitary_diameter_fraction",
}


def bands(name, lowest):
    """Pairs of neighbouring rings from the given height up, the tip with radius 0."""
    rings, tip = PROFILES[name]
    above = [(r, z) for r, z in (*rings, (0.0, tip)) if z >= lowest]
    if above[0][1] > lowest:
        above.insert(0, (radius_at(name, lowest), lowest))
    return list(itertools.pairwise(above))


def radius_at(name, height):
    """Radius of the profile at a height between its flat surroundings and a ring."""
    (r, z), (s, t) = next(
        pair
        for pair in itertools.pairwise(PROFILES[name][0])
        if pair[0][1] <= height < pair[1][1]
    )
    return r + (s - r) * (height - z) / (t - z)


def exact_volume(name, lowest=0.0):
    return SECTOR * sum(
        (b[1] - a[1]) / 3 * (a[0] ** 2 + a[0] * b[0] + b[0] ** 2)
        for a, b in bands(name, lowest)
    )


def exact_area(name):
    """Of the trapezoids above half an r0."""
    side, apothem = 2 * np.sin(np.pi / SEGMENTS), np.cos(np.pi / SEGMENTS)
    return SEGMENTS * sum(
        side * (a[0] + b[0]) / 2 * np.hypot(b[1] - a[1], apothem * (a[0] - b[0]))
        for a, b in bands(name, 0.5)
    )


@pytest.fixture(scope="module", params=list(PROFILES))
def shape(request, lesion):
    return request.param, shape_metrics(lesion(request.param))


def test_height_is_that_of_the_tip(shape):
    name, metrics = shape
    np.testing.assert_allclose(metrics.height_mm, PROFILES[name][1], rtol=1e-14)


def equal_circle(radius):
    """Diameter of the circle with the area of a section."""
    return 2 * np.sqrt(SECTOR * radius**2 / np.pi)


@pytest.mark.parametrize(
    "name, radius", [("mushroom", 2.5), ("cylinder", 1.5), ("dome", 2.92)]
)
def test_width_has_the_area_of_the_widest_section_of_the_head(lesion, name, radius):
    metrics = shape_metrics(lesion(name))
    # between two of the sections, 5 r0 / 48 apart
    np.testing.assert_allclose(metrics.width_mm, equal_circle(radius), rtol=0.03)


def test_length_of_an_upright_lesion_is_its_height(shape):
    name, metrics = shape
    np.testing.assert_allclose(metrics.length_mm, PROFILES[name][1], rtol=1e-6)
    np.testing.assert_allclose(metrics.lean_deg, 0, atol=1e-4)
    np.testing.assert_allclose(metrics.bend_deg, 0, atol=1e-3)


def test_volume_is_exact(shape):
    name, metrics = shape
    np.testing.assert_allclose(metrics.volume_mm3, exact_volume(name), rtol=1e-13)


def test_area_is_exact(shape):
    name, metrics = shape
    np.testing.assert_allclose(metrics.area_mm2, exact_area(name), rtol=1e-13)


@pytest.mark.parametrize("name, radius", [("mushroom", 1.0), ("cylinder", 1.5)])
def test_neck_has_the_area_of_the_narrowest_section_below_the_head(
    lesion, name, radius
):
    metrics = shape_metrics(lesion(name))
    np.testing.assert_allclose(metrics.neck_width_mm, equal_circle(radius), rtol=1e-6)


def test_neck_of_a_dome_is_its_base(lesion):
    metrics = shape_metrics(lesion("dome"))
    wanted = equal_circle(radius_at("dome", 0.5))
    np.testing.assert_allclose(metrics.neck_width_mm, wanted, rtol=1e-6)
    np.testing.assert_allclose(metrics.base_width_mm, wanted, rtol=1e-12)


def test_ratios_are_those_of_the_lengths(shape):
    _, metrics = shape
    np.testing.assert_allclose(
        [metrics.height_to_width, metrics.length_to_width, metrics.neck_to_width],
        [
            metrics.height_mm / metrics.width_mm,
            metrics.length_mm / metrics.width_mm,
            metrics.neck_width_mm / metrics.width_mm,
        ],
        rtol=1e-15,
    )
    assert metrics.neck_to_width <= 1


def test_sphericity_is_that_of_the_raised_part(shape):
    name, metrics = shape
    surface = exact_area(name) + SECTOR * radius_at(name, 0.5) ** 2
    wanted = np.pi ** (1 / 3) * (6 * exact_volume(name, 0.5)) ** (2 / 3) / surface
    np.testing.assert_allclose(metrics.sphericity, wanted, rtol=1e-12)


def test_fraction_counts_the_segments_of_balls_above(shape):
    _, metrics = shape
    # the first tumour particle is below; a plane cuts two; one is above
    segments = sum(np.pi * h**2 * (1.5 - h) / 3 for h in (0.25, 0.9))
    wanted = (0 + segments / (np.pi / 6) + 1) / 4
    np.testing.assert_allclose(metrics.intracavitary_fraction, wanted, rtol=1e-13)


def test_share_of_the_diameter_is_that_of_the_extent_above(shape):
    _, metrics = shape
    # balls from 2.5 below to 1.5 above
    np.testing.assert_allclose(
        metrics.intracavitary_diameter_fraction, 1.5 / 4, rtol=1e-13
    )


def test_tumour_diameter_is_that_of_a_ball_with_its_radius_of_gyration(shape, lesion):
    name, metrics = shape
    tumour = np.asarray(lesion(name).particles.position)[:4]
    gyration = np.sqrt(((tumour - tumour.mean(axis=0)) ** 2).sum(axis=1).mean())
    wanted = 2 * np.sqrt(5 / 3) * gyration + 1
    np.testing.assert_allclose(metrics.tumour_diameter_mm, wanted, rtol=1e-13)


def values(metrics):
    return np.array(jax.tree.leaves(metrics))


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_orientation_in_space_is_irrelevant(lesion, smoothing):
    turn = Rotation.from_rotvec([0.4, 1.0, -0.3]).as_matrix()
    turned = shape_metrics(lesion("mushroom", turn=turn), smoothing=smoothing)
    upright = shape_metrics(lesion("mushroom"), smoothing=smoothing)
    for name in NAMES:
        # the directions in which a body is measured do not turn
        rtol = 0.1 if "body" in name else 1e-6
        # angles of 0 are those of rounding
        np.testing.assert_allclose(
            getattr(turned, name),
            getattr(upright, name),
            rtol=rtol,
            atol=1e-4,
            err_msg=name,
        )


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_a_shift_along_the_former_surface_is_irrelevant(lesion, smoothing):
    there = shape_metrics(
        lesion("mushroom", shift=np.array([3.0, -2, 0])), smoothing=smoothing
    )
    here = shape_metrics(lesion("mushroom"), smoothing=smoothing)
    np.testing.assert_allclose(values(there), values(here), rtol=1e-6, atol=1e-4)


def test_lengths_are_in_millimetres(lesion):
    one = shape_metrics(lesion("mushroom"))
    three = shape_metrics(lesion("mushroom", mm=3.0))
    power = {"mm": 1, "mm2": 2, "mm3": 3}
    for name in NAMES:
        unit = -1 if "per_mm" in name else power.get(name.rsplit("_")[-1], 0)
        np.testing.assert_allclose(
            getattr(three, name), getattr(one, name) * 3.0**unit, rtol=1e-13
        )


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_padding_is_inert(lesion, smoothing):
    state = lesion("dome")
    live = np.asarray(state.membrane.vertex_alive)
    noise = 50 * np.random.default_rng(0).normal(size=(256, 3)) * ~live[:, None]
    filled = eqx.tree_at(
        lambda s: s.membrane.vertices, state, state.membrane.vertices + noise
    )
    np.testing.assert_array_equal(
        values(shape_metrics(filled, smoothing=smoothing)),
        values(shape_metrics(state, smoothing=smoothing)),
    )


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_capacity_is_irrelevant(lesion, smoothing):
    state = lesion("mushroom")

    def longer(array):
        rows = array.shape[0] // 2
        return jnp.concatenate([array, jnp.zeros_like(array[:rows])])

    of_arrays = eqx.filter(state.membrane, lambda x: x.ndim > 0)
    rest = eqx.filter(state.membrane, lambda x: x.ndim == 0)
    roomy = eqx.combine(jax.tree.map(longer, of_arrays), rest)
    np.testing.assert_allclose(
        values(
            shape_metrics(
                State(state.particles, roomy, state.frame), smoothing=smoothing
            )
        ),
        values(shape_metrics(state, smoothing=smoothing)),
        rtol=1e-8,
        atol=1e-4,
    )


def test_flat_patch_has_no_lesion(lesion):
    metrics = shape_metrics(flattened(lesion("dome")))
    others = {
        "volume_mm3",
        "intracavitary_fraction",
        "intracavitary_diameter_fraction",
        "contact_angle_deg",
    }
    for name in set(NAMES) - OF_TUMOUR - others:
        assert getattr(metrics, name) == 0, name
    np.testing.assert_allclose(metrics.contact_angle_deg, 180, atol=0.01)
    np.testing.assert_allclose(metrics.volume_mm3, 0, atol=1e-13)


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_free_cluster_has_the_metrics_of_a_tumour_only(lesion, smoothing):
    state = lesion("dome")
    free = State(
        state.particles,
        None,
        eqx.tree_at(lambda f: f.former, state.frame, None, is_leaf=lambda x: x is None),
    )
    metrics = shape_metrics(free, smoothing=smoothing)
    assert metrics.tumour_diameter_mm > 1
    others = set(NAMES) - OF_TUMOUR
    assert all(np.isfinite(getattr(metrics, name)) for name in OF_TUMOUR)
    assert all(np.isnan(getattr(metrics, name)) for name in others)


@pytest.mark.parametrize("smoothing", [-0.1, float("nan"), float("inf")])
def test_smoothing_is_a_length(lesion, smoothing):
    with pytest.raises(ValueError, match=r"smoothing is .* give a length in r0"):
        shape_metrics(lesion("dome"), smoothing=smoothing)


@pytest.mark.parametrize("smoothing", [0.01, 0.1, 1.0])
@pytest.mark.parametrize("name", list(PROFILES))
def test_smooth_lengths_are_as_near_as_stated(lesion, name, smoothing):
    mm = 2.0
    for seed in range(5):
        state = bumpy(lesion(name, mm=mm), seed, size=0.2)
        exact, smooth = shape_metrics(state), shape_metrics(state, smoothing=smoothing)
        error = {n: (getattr(smooth, n) - getattr(exact, n)) / mm for n in LENGTHS}
        for length in LENGTHS - {"neck_width_mm"}:
            assert -1e-12 <= error[length] <= smoothing, length
        assert -2 / 3 * smoothing <= error["neck_width_mm"] <= smoothing
        for other in set(NAMES) - LENGTHS - FOLLOWING:
            assert getattr(smooth, other) == getattr(exact, other), other
