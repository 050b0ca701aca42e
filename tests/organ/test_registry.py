"""Organs of one's own by name: in scenes, files and the command."""

import numpy as np
import pytest
import trimesh

import jaxgrow as jg
from jaxgrow.calibration.fit import _identity
from jaxgrow.cli.main import combine, main
from jaxgrow.growth.initial_state import find_organ


@pytest.fixture
def ball(registries):
    @jg.register_organ
    def ball():
        sphere = trimesh.creation.icosphere(subdivisions=3, radius=20.0)
        vertices, faces = np.asarray(sphere.vertices), np.asarray(sphere.faces)
        top = {"top": np.array([0.0, 0.0, 20.0])}
        return jg.Organ("ball", vertices, faces, "inside", top)

    return ball


def test_scene_names_a_registered_organ(ball):
    found = find_organ(jg.Scene(organ="ball"))
    assert found is not None
    assert found.name == "ball"
    assert found.tissue == "inside"


def test_scene_file_and_command_name_a_registered_organ(ball, tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text("organ = 'ball'\n[lesion]\nkind = 'polyp'\nsite = 'top'\n")
    assert jg.load_scene(file).organ == "ball"
    wanted = {"organ": "ball", "lesion": {"kind": "myoma"}}
    assert find_organ(combine(None, wanted)).name == "ball"


def test_command_lists_the_sites_of_a_registered_organ(ball, capsys):
    assert main(["sites", "--organ", "ball"]) == 0
    assert "top" in capsys.readouterr().out


def test_name_that_is_not_registered_is_the_path_of_a_file(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text("organ = 'ball'\n")
    assert jg.load_scene(file).organ == str(tmp_path / "ball")


def test_fit_in_another_organ_of_the_same_name_is_another_fit(ball):
    before = _identity("ball")

    def larger():
        organ = ball()
        return jg.Organ("ball", 1.5 * organ.vertices, organ.faces, "inside")

    larger.__name__ = "ball"
    jg.register_organ(larger)
    assert _identity("ball") != before


def test_function_that_makes_no_organ_is_told(registries):
    @jg.register_organ
    def nothing():
        return None

    with pytest.raises(TypeError, match=r"'nothing' returned NoneType"):
        find_organ(jg.Scene(organ="nothing"))


@pytest.mark.parametrize("given", [lambda: None, "ball"])
def test_what_has_no_name_is_no_organ(unchecked, given):
    with pytest.raises(TypeError, match="function without arguments"):
        unchecked(jg.register_organ)(given)
