"""Sessile and flat polyps, asked for by their height."""

import numpy as np
import pytest

import jaxgrow as jg
from jaxgrow.lesions.polyp import SESSILE_BENDING
from jaxgrow.lesions.size import height_of


@pytest.fixture(scope="module")
def sessile():
    lesion = jg.Polyp(size_mm=6.0, height_mm=2.2, particle_mm=1.0, site="posterior")
    return jg.grow(jg.Scene(lesion=lesion), seed=1)


def test_growth_ends_at_the_height(sessile):
    assert sessile.result is jg.Result.REACHED
    height = height_of(sessile.state) * sessile.scene.r0_mm
    assert 2.2 <= height < 2.6
    *before, last = [record.share for record in sessile.history]
    assert max(before) < 1 <= last
    np.testing.assert_allclose(last, height / 2.2)
    assert sessile.size_mm > 1.5 * height


def test_height_is_the_largest_over_the_former_surface(sessile):
    # independent of the host's code: the metric of the shape is differentiable
    found = jg.shape_metrics(sessile.state).height_mm
    height = height_of(sessile.state) * sessile.scene.r0_mm
    np.testing.assert_allclose(found, height, rtol=0.15)


def test_nothing_raised_has_no_height():
    scene = jg.Scene(lesion=jg.Polyp(divisions=1, particle_mm=1.5))
    assert height_of(jg.grow(scene).state) == 0


def defaults(**lesion):
    return jg.Scene(lesion=jg.Polyp(size_mm=8.0, **lesion)).parameters


def test_height_has_a_wide_focus_and_a_stiffer_lining_by_default():
    usual, flat, high = defaults(), defaults(height_mm=2.6), defaults(height_mm=7.2)
    assert usual.focus_radius < high.focus_radius < flat.focus_radius
    assert flat.bending_stiffness == high.bending_stiffness == SESSILE_BENDING
    asked = defaults(height_mm=2.6, focus_mm=2.0)
    assert asked.focus_radius == pytest.approx(2.0 / (8.0 / 12))


@pytest.mark.parametrize(
    "lesion, told",
    [
        ({"size_mm": 8.0, "height_mm": 7.3}, "wide: give size_mm alone"),
        ({"divisions": 8, "height_mm": 3.0}, "give size_mm, its width, instead of div"),
        ({"size_mm": 8.0, "height_mm": 3.0, "lobes": 3}, "without a stalk and lobes"),
        ({"size_mm": 8.0, "height_mm": 3.0, "stalk_mm": 2.0}, "without a stalk"),
        ({"size_mm": 8.0, "height_mm": 0.0}, "height_mm"),
        ({"size_mm": 8.0, "height_mm": 0.5}, "less than one particle of 0.667 mm"),
    ],
)
def test_height_that_no_sessile_polyp_has_is_refused(lesion, told):
    with pytest.raises(ValueError, match=told):
        jg.Scene(lesion={"kind": "polyp", **lesion})
