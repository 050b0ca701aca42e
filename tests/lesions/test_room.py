"""Myomas and the room of the lumen at their site."""

import re

import pytest

import jaxgrow as jg
from jaxgrow.organ import locate_site, room


def scene(size, **lesion):
    given = {"kind": "myoma", "site": "isthmus", "divisions_per_step": 8, **lesion}
    return jg.Scene(lesion={**given, "size_mm": size})


def refusal(size, **lesion):
    with pytest.raises(jg.OrganError) as told:
        jg.grow(scene(size, **lesion))
    return str(told.value)


def test_myoma_too_large_for_the_canal_is_refused_with_the_size_that_fits():
    text = refusal(13.3)
    assert text.startswith(
        "a myoma of 13.3 mm protrudes by some 6.7 mm, and at isthmus"
    )
    assert "the opposite wall is 5.4 mm away; ask for 9 mm or less" in text


def test_size_that_the_refusal_tells_grows():
    most = float(re.search(r"ask for ([\d.]+) mm", refusal(13.3))[1])
    growth = jg.grow(scene(most))
    assert growth.result is jg.Result.REACHED
    assert jg.audit(growth).clean
    # it protrudes as the refusal reckons with
    assert 0.4 < jg.shape_metrics(growth.state).height_mm / most < 0.55


@pytest.mark.parametrize("particle", [None, 1.0])
def test_least_size_that_is_refused_is_just_above_the_one_told(particle):
    most = float(
        re.search(r"ask for ([\d.]+) mm", refusal(13, particle_mm=particle))[1]
    )
    assert refusal(most + 0.11, particle_mm=particle)
    lesion = scene(most, particle_mm=particle).lesion
    lesion.check_site(jg.uterus(), locate_site(jg.uterus(), "isthmus"))


def test_myomas_of_18_mm_have_room_in_the_cavity():
    organ = jg.uterus()
    for name in ("fundus", "anterior", "posterior", "left-wall", "right-cornu"):
        site = locate_site(organ, name)
        scene(18.0, site=name).lesion.check_site(organ, site)
        assert room(organ, site) > 12


def test_number_of_divisions_is_no_size_that_could_be_refused():
    organ = jg.uterus()
    lesion = jg.Myoma(divisions=500, particle_mm=3.0, site="isthmus")
    lesion.check_site(organ, locate_site(organ, "isthmus"))
