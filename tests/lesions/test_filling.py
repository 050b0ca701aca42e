"""Polyps that fill their cavity."""

import numpy as np
import pytest
import trimesh

import jaxgrow as jg


def test_polyp_grows_until_its_cavity_is_full():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=5.0)
    organ = jg.Organ("ball", np.asarray(ball.vertices), np.asarray(ball.faces))
    lesion = jg.Polyp(
        size_mm=20.0, particle_mm=1.6, site=(0.0, 0.0, -5.0), fills_cavity=True
    )
    growth = jg.grow(jg.Scene(organ=organ, lesion=lesion), seed=0)
    assert growth.result is jg.Result.REACHED
    assert growth.size_mm < 10.0
    assert jg.audit(growth).clean
    assert jg.shape_metrics(growth.state).volume_mm3 > 0.5 * ball.volume
    # it lies against the wall opposite to its site
    top = growth.mesh().vertices[growth.surface()[2] == 1][:, 2].max()
    assert top > 4.0


@pytest.mark.parametrize("given", [{"divisions": 40}, {"size_mm": 20, "height_mm": 9}])
def test_filling_takes_a_size_alone(given):
    with pytest.raises(ValueError, match="give size_mm, 30 for the built-in uterus"):
        jg.Polyp(fills_cavity=True, **given)
