"""A fit's folder: killed and resumed, refused, and read by what comes after."""

import json
import math
from dataclasses import replace

import pytest
from PIL import Image

from jaxgrow.calibration import fit
from jaxgrow.calibration.folder import scene_toml
from jaxgrow.calibration.spec import FitError
from jaxgrow.energy.parameters import Parameters
from jaxgrow.lesions.myoma import Myoma
from jaxgrow.lesions.polyp import Polyp
from jaxgrow.organ.uterus import uterus
from jaxgrow.scene.scene import load_scene, Scene, Surroundings


BOUNDS = {"spring_stiffness": (0.004, 0.4)}
TARGETS = {"height_mm": (2.1, 0.05), "width_mm": (3.1, 0.05)}


def run(grower, folder, **more):
    return fit(Scene(), TARGETS, BOUNDS, grower=grower, folder=folder, **more)


def outcome(folder):
    return json.loads((folder / "fit.json").read_text())["outcome"]


@pytest.fixture
def whole(tmp_path, formula):
    """A fit that nothing interrupted; its folder."""
    run(formula(0.3), tmp_path / "whole")
    return tmp_path / "whole"


def test_a_folder_holds_growths_scene_and_plot(whole):
    assert {file.name for file in whole.iterdir()} == {
        "fit.json",
        "fitted.toml",
        "fit.png",
    }
    kept = outcome(whole)
    assert kept["outcome"] == "REACHED"
    scene = load_scene(whole / "fitted.toml")
    value = kept["parameters"]["spring_stiffness"]["value"]
    assert scene == Scene(parameters={"spring_stiffness": value})
    with Image.open(whole / "fit.png") as picture:
        assert picture.size == (1000, 420)  # its marks: test_chart


@pytest.mark.parametrize("grows", [0, 1, 9, 10, 19])
def test_killed_and_resumed_it_ends_with_the_same_bits(grows, whole, tmp_path, formula):
    killed = tmp_path / "killed"
    with pytest.raises(KeyboardInterrupt):
        run(formula(0.3, grows=grows), killed)
    if grows:
        assert outcome(killed) is None
    rest = formula(0.3)
    run(rest, killed)
    assert outcome(killed) == outcome(whole)
    for name in ("fitted.toml", "fit.png", "fit.json"):
        assert (killed / name).read_bytes() == (whole / name).read_bytes()
    made = len(json.loads((whole / "fit.json").read_text())["growths"])
    assert len(rest.asked) == made - grows


def test_a_kill_while_the_file_is_written_leaves_the_one_before(
    whole, tmp_path, formula, monkeypatch
):
    killed = tmp_path / "killed"
    calls = []

    def fsync(_):
        calls.append(None)
        if len(calls) == 4:
            raise OSError("gone")

    with monkeypatch.context() as failing:
        failing.setattr("os.fsync", fsync)
        with pytest.raises(OSError, match="gone"):
            run(formula(0.3), killed)
    assert len(json.loads((killed / "fit.json").read_text())["growths"]) == 3
    run(formula(0.3), killed)
    assert outcome(killed) == outcome(whole)


def test_a_complete_fit_grows_nothing_again(whole, formula):
    before, again = outcome(whole), formula(0.3)
    run(again, whole)
    assert again.asked == []
    assert outcome(whole) == before


def test_more_evaluations_go_on(tmp_path, formula):
    first = run(formula(0.3), tmp_path, evaluations=2)
    assert first.end.name == "EXHAUSTED"
    rest = formula(0.3)
    found = run(rest, tmp_path, evaluations=30)
    assert found.history[:2] == first.history
    assert len(rest.asked) == len(found.growths) - 2 * len(found.task.fit.seeds)


@pytest.mark.parametrize(
    "changed, difference",
    [
        ({"targets": {**TARGETS, "width_mm": (3.1, 0.06)}}, "width_mm.uncertainty"),
        ({"parameters": {"adhesion": (0.1, 0.3)}}, "adhesion"),
        ({"seeds": [1, 2]}, "task.fit.seeds"),
        ({"scene": Scene(lesion=Polyp(size_mm=5))}, "scene.lesion.size_mm"),
    ],
)
def test_a_folder_of_another_fit_is_refused(whole, formula, changed, difference):
    given = {"scene": Scene(), "targets": TARGETS, "parameters": BOUNDS, **changed}
    with pytest.raises(FitError, match=f"another .*{difference}; give a new folder"):
        fit(**given, grower=formula(), folder=whole)


def test_a_damaged_file_is_refused(whole, formula):
    text = (whole / "fit.json").read_text()
    (whole / "fit.json").write_text(text[: len(text) // 2])
    with pytest.raises(FitError, match="is damaged or no fit"):
        run(formula(), whole)


def change(folder, **entries):
    """Put other entries into a fit's file."""
    content = json.loads((folder / "fit.json").read_text())
    (folder / "fit.json").write_text(json.dumps({**content, **entries}))
    return content


def test_a_file_of_another_format_is_refused(whole, formula):
    change(whole, format=7, growths="of another kind")
    with pytest.raises(FitError, match=r"has format 7, and this .* reads 2; go on"):
        run(formula(), whole)


@pytest.mark.parametrize("damaged", [{"request": 3}, {"growths": [{}]}])
def test_entries_that_make_no_sense_are_damage(damaged, whole, formula):
    change(whole, **damaged)
    with pytest.raises(FitError, match="is damaged or no fit"):
        run(formula(), whole)


def test_growths_of_other_versions_are_refused(whole, formula):
    request = change(whole)["request"]
    here = request["versions"]
    other = {**here, "scipy": "1.0.1", "numba": None, "optax": "0.1"}
    change(whole, request={**request, "versions": other})
    with pytest.raises(FitError) as caught:
        run(formula(), whole)
    assert str(caught.value) == (
        f"{whole} holds growths made with scipy 1.0.1 and no numba and optax 0.1, and "
        f"here is scipy {here['scipy']} and numba {here['numba']} and optax "
        f"{here['optax']}, which may make others; go on with scipy 1.0.1 and no numba "
        "and optax 0.1, or give a new folder."
    )


def test_a_file_from_before_polyps_had_a_focus_is_another_one(whole, formula):
    request = change(whole)["request"]
    del request["scene"]["lesion"]["focus_mm"]
    change(whole, request=request)
    with pytest.raises(FitError, match="with another focus_mm; give"):
        run(formula(), whole)


@pytest.mark.parametrize("request_of", [{}, {"scene": 3}, {"scene": {"lesion": 3}}])
def test_a_request_without_a_lesion_is_another_one(request_of, whole, formula):
    change(whole, request=request_of)
    with pytest.raises(FitError, match="holds a fit with another"):
        run(formula(), whole)


def test_what_only_draws_may_have_another_version(whole, formula):
    request = change(whole)["request"]
    assert not {"pillow", "embreex"} & set(request["versions"])
    older = {**request["versions"], "pillow": "1.0"}  # as files once had it
    change(whole, request={**request, "versions": older})
    run(formula(0.3), whole)


def test_a_folder_is_made_with_its_first_growth(tmp_path, formula):
    folder = tmp_path / "new" / "fit"
    with pytest.raises(KeyboardInterrupt):
        run(formula(grows=0), folder)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(KeyboardInterrupt):
        run(formula(grows=1), folder)
    assert [file.name for file in folder.iterdir()] == ["fit.json"]


def test_folders_that_cannot_be_used_are_refused(tmp_path, formula):
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(FitError, match=r"there is note\.txt"):
        run(formula(), tmp_path)
    with pytest.raises(FitError, match="is a file"):
        run(formula(), tmp_path / "note.txt")
    with pytest.raises(FitError, match=r"nothing can be written .*: Not a dir"):
        run(formula(), tmp_path / "note.txt" / "fit")
    scene = Scene(organ=uterus())
    with pytest.raises(FitError, match="is in memory"):
        fit(scene, TARGETS, BOUNDS, grower=formula(), folder=tmp_path / "new")


def test_a_start_outside_of_the_bounds_is_refused(formula):
    bounds = {"spring_stiffness": (0.05, 0.4)}
    with pytest.raises(FitError, match=r"spring_stiffness is 0\.04, which"):
        fit(Scene(), TARGETS, bounds, grower=formula())


def test_a_free_cluster_has_no_height_to_fit(formula):
    scene = Scene(organ=None, lesion=Myoma(divisions=3))
    with pytest.raises(FitError, match="height_mm needs a surface"):
        fit(scene, TARGETS, BOUNDS, grower=formula())


def test_a_scene_is_written_as_it_is_read(tmp_path):
    (tmp_path / "runs").mkdir()
    scene = Scene(
        organ=str(tmp_path / 'an "organ".ply'),
        unit_mm=10.0,
        lesion=Myoma(divisions=7, site=(1.0, -2.5, 1e-7), depth_mm=2.0),
        parameters=replace(Parameters(), adhesion=1 / 3, tumour_stiffness=3.0),
        surroundings=Surroundings(radius=4.0, collisions="off"),
    )
    path = tmp_path / "runs" / "fitted.toml"
    path.write_text(scene_toml(scene, path.parent))
    again = load_scene(path)
    assert again.model_dump(exclude={"organ"}) == scene.model_dump(exclude={"organ"})
    assert (tmp_path / "runs" / again.organ).resolve() == (tmp_path / 'an "organ".ply')
    assert math.isclose(again.parameters.adhesion, 1 / 3, rel_tol=0)
