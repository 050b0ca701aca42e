"""Kinds of lesion: one class each, also from outside of the package."""

from typing import Literal

import numpy as np
import pytest

import jaxgrow as jg
from jaxgrow.cli.main import combine
from jaxgrow.scene import scene as module


class Oldest(jg.Myoma):
    """A ball in which the first particle alone divides."""

    kind: Literal["oldest"] = "oldest"

    def choose(self, state, parameters, rng, count):
        drawn = super().choose(state, parameters, rng, 1)[0]
        first = int(np.flatnonzero(np.asarray(state.particles.species) == 1)[0])
        return (drawn._replace(parent=first),)


def test_kind_needs_no_registration_in_python():
    scene = jg.Scene(organ=None, lesion=Oldest(divisions=3))
    assert isinstance(scene.lesion, Oldest)
    assert scene.parameters.tumour_stiffness == 3.0


def test_kind_of_a_script_grows_replays_and_is_read_from_files(registries, tmp_path):
    jg.register_lesion(Oldest)
    scene = jg.Scene(organ=None, lesion=Oldest(divisions=6))
    growth = jg.grow(scene, seed=1)
    assert growth.result is jg.Result.REACHED
    parents = {d.parent for event in growth.events for d in event.divisions}
    assert parents == {0}
    again = jg.grow(scene, events=growth.events)
    np.testing.assert_array_equal(
        again.state.particles.position, growth.state.particles.position
    )
    file = tmp_path / "scene.toml"
    file.write_text("[lesion]\nkind = 'oldest'\nsize_mm = 4\ndepth_mm = 2\n")
    read = jg.load_scene(file)
    assert isinstance(read.lesion, Oldest)
    # it has the mechanics of the kind that it is derived from
    assert read.parameters.tumour_stiffness == 3.0
    told = combine(None, {"lesion": {"kind": "oldest", "size_mm": 5.0}})
    assert isinstance(told.lesion, Oldest)


def test_kind_that_is_not_registered_is_refused_with_those_that_are(registries):
    with pytest.raises(jg.SceneError, match="'polyp', 'myoma'"):
        jg.make_scene({"lesion": {"kind": "oldest"}}, source="test")
    jg.register_lesion(Oldest)
    with pytest.raises(jg.SceneError, match="'polyp', 'myoma', 'oldest'"):
        jg.make_scene({"lesion": {"kind": "wart"}}, source="test")


def test_entries_of_a_registered_kind_are_checked(registries):
    jg.register_lesion(Oldest)
    with pytest.raises(jg.SceneError, match=r"lesion\.depht_mm .*depth_mm"):
        jg.make_scene({"lesion": {"kind": "oldest", "depht_mm": 2.0}}, source="test")


def test_class_without_a_name_or_a_rule_is_no_kind(registries):
    class Nameless(jg.Myoma):
        kind: str = "nameless"

    class Ruleless(jg.Lesion):
        kind: Literal["ruleless"] = "ruleless"

    with pytest.raises(TypeError, match="Literal"):
        jg.register_lesion(Nameless)
    with pytest.raises(TypeError, match="no choose, no divide"):
        jg.register_lesion(Ruleless)
    assert set(module.LESIONS) == {"polyp", "myoma"}


def test_registered_kind_is_stated_in_the_registry_alone(registries):
    jg.register_lesion(Oldest)
    assert jg.make_scene({"lesion": {"kind": "oldest"}}, source="test")
    del module.LESIONS["oldest"]
    with pytest.raises(jg.SceneError, match="'polyp', 'myoma'"):
        jg.make_scene({"lesion": {"kind": "oldest"}}, source="test")


def test_lesion_without_a_kind_is_told():
    with pytest.raises(jg.SceneError, match=r"lesion\.kind is missing"):
        jg.make_scene({"lesion": {"size_mm": 4.0}}, source="test")
    with pytest.raises(jg.SceneError, match="lesion is 3: give a table with a kind"):
        jg.make_scene({"lesion": 3}, source="test")


@pytest.mark.parametrize("name", ["polyp", "myoma"])
def test_kind_states_its_own_name(name):
    assert module.LESIONS[name]().kind == name
