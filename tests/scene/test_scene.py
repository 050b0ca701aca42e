"""Scenes: what is read, what is refused, and in which words."""

from pathlib import Path

import numpy as np
import pytest

from jaxgrow.energy.parameters import Parameters, UnstableAdhesionWarning
from jaxgrow.scene.scene import (
    load_scene,
    make_scene,
    Myoma,
    Polyp,
    Scene,
    SceneError,
    Surroundings,
)


WHOLE = """
organ = "womb.ply"
unit_mm = 10.0
tissue = "inside"

[lesion]
kind = "myoma"
size_mm = 12
particle_mm = 1.5
depth_mm = 4.0
site = [1, 2.5, -3]

[parameters]
adhesion = 0.1
spring_stiffness = 3

[surroundings]
radius = 9.0
density = 1.0
"""


@pytest.fixture
def write(tmp_path):
    def _write(text):
        path = tmp_path / "scene.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return _write


def test_default_scene_is_a_polyp_of_10_mm_at_the_fundus_of_the_uterus():
    scene = Scene()
    assert scene.organ == "uterus"
    assert scene.lesion == Polyp()
    assert scene.lesion.target_mm == 10.0
    assert scene.lesion.site == "fundus"


def test_every_entry_of_a_file_arrives(write):
    path = write(WHOLE)
    scene = load_scene(path)
    assert scene.organ == str(path.parent / "womb.ply")
    assert (scene.unit_mm, scene.tissue) == (10.0, "inside")
    assert scene.lesion == Myoma(
        size_mm=12.0, particle_mm=1.5, depth_mm=4.0, site=(1.0, 2.5, -3.0)
    )
    assert scene.parameters.adhesion == 0.1
    assert scene.parameters.spring_stiffness == 3
    assert scene.parameters.smoothing == Parameters().smoothing
    assert scene.surroundings == Surroundings(radius=9.0, density=1.0)


def test_built_in_organ_is_no_path(write):
    assert load_scene(write('organ = "uterus"')).organ == "uterus"


def test_absolute_organ_path_is_kept(write, tmp_path):
    organ = tmp_path / "elsewhere" / "womb.obj"
    scene = load_scene(write(f'organ = "{organ.as_posix()}"'))
    assert Path(str(scene.organ)) == organ


def test_size_decides_the_particle_diameter():
    assert Polyp(size_mm=15.0).r0_mm == pytest.approx(1.25)
    assert Myoma(size_mm=14.0).r0_mm == pytest.approx(2.0)


def test_number_of_divisions_replaces_the_size():
    lesion = Polyp(divisions=7)
    assert lesion.target_mm is None
    assert lesion.r0_mm == 1.0


def test_free_myoma_needs_no_organ():
    assert Scene(organ=None, lesion=Myoma(divisions=3)).organ is None


def test_scene_is_immutable():
    with pytest.raises(ValueError, match="frozen"):
        Scene().unit_mm = 2.0


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(SceneError, match=r"none\.toml cannot be read: .*No such file"):
        load_scene(tmp_path / "none.toml")


def test_folder_is_refused(tmp_path):
    with pytest.raises(SceneError, match=r"cannot be read: .*[Dd]irectory"):
        load_scene(tmp_path)


def test_file_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_bytes(bytes(range(128, 256)))
    with pytest.raises(SceneError, match="cannot be read"):
        load_scene(path)


def test_file_that_is_no_toml_is_refused(write):
    with pytest.raises(SceneError, match=r"is not valid TOML: .*line 1"):
        load_scene(write("[lesion\nx = 1"))


@pytest.mark.parametrize(
    "text, sentence",
    [
        ("organ_ = 1", r"organ_ is unknown; did you mean organ"),
        ("banana = 1", "banana is unknown; known are organ, unit_mm, "),
        (
            "[lesion]\nkind = 'polyp'\nsize = 3",
            "size is unknown; did you mean",
        ),
        (
            "[lesion]\nkind = 'polyp'\nsize_mm = -3",
            r"lesion\.size_mm is -3: input should be greater than 0",
        ),
        ("[lesion]\nkind = 'polyp'\nsize_mm = nan", "size_mm is nan: .*finite"),
        ("[lesion]\nkind = 'polyp'\nsize_mm = inf", "size_mm is inf: .*finite"),
        (
            "[lesion]\nkind = 'polyp'\nsize_mm = '3'",
            r"lesion\.size_mm is '3': input should be a valid number",
        ),
        (
            "[lesion]\nkind = 'polyp'\nsize_mm = 3\ndivisions = 4",
            "give size_mm or divisions, not both",
        ),
        ("[lesion]\nkind = 'polyp'\ndivisions = 0", r"lesion\.divisions is 0: "),
        ("[lesion]\nkind = 'polyp'\ndivisions = 1.5", r"lesion\.divisions is 1\.5: "),
        (
            "[lesion]\nkind = 'polyp'\ndivisions_per_step = 9",
            r"lesion\.divisions_per_step is 9: .* less than or equal to 8",
        ),
        ("[lesion]\nkind = 'wart'", "lesion.*'polyp', 'myoma'"),
        ("[lesion]\nsize_mm = 3.0", "lesion.*kind"),
        ("[lesion]\nkind = 'polyp'\ndepth_mm = 3.0", r"lesion\.depth_mm is unknown"),
        ("[lesion]\nkind = 'polyp'\nsite = [1, 2]", r"lesion\.site"),
        ("lesion = 3", "lesion"),
        ("tissue = 'above'", "tissue is 'above': .*'outside' or 'inside'"),
        ("unit_mm = 0", "unit_mm is 0: input should be greater than 0"),
        ("[surroundings]\nradus = 3.0", r"radus is unknown; .* radius"),
        (
            "[parameters]\nadhesoin = 0.1",
            "adhesoin is unknown; did you mean adhesion",
        ),
        ("[parameters]\nadhesion = 'a'", "parameter adhesion is 'a'; give a number"),
        ("[parameters]\nadhesion = true", "parameter adhesion is True; give a number"),
        (
            "[parameters]\nadhesion = -1",
            "adhesion is -1; it must be a number",
        ),
        ("[parameters]\nsmoothing = 0.6", "parameter smoothing is 0.6; .* 0 to 0.5"),
        ("[parameters]\nadhesion = nan", "parameter adhesion is nan; it must be"),
    ],
)
def test_wrong_entry_is_refused_in_words(write, text, sentence):
    with pytest.raises(SceneError, match=sentence):
        load_scene(write(text))


def test_every_wrong_entry_is_named_at_once(write):
    with pytest.raises(SceneError, match=r"unit_mm is -1.*; tissue is 'x'"):
        load_scene(write("unit_mm = -1\ntissue = 'x'"))


def test_message_is_one_line_and_names_the_file(write):
    path = write("unit_mm = -1\ntissue = 'x'")
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")


def test_polyp_without_an_organ_is_refused():
    with pytest.raises(SceneError, match="a polyp grows from a surface"):
        make_scene({"organ": None}, source="the test")


def test_adhesion_above_149_over_371_warns_by_name(write):
    with pytest.warns(UnstableAdhesionWarning, match="149/371"):
        load_scene(write("[parameters]\nadhesion = 0.5"))


def test_adhesion_below_149_over_371_does_not_warn():
    assert np.isclose(Parameters(adhesion=0.4).adhesion, 0.4)
