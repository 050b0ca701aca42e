"""Targets, bounds and effort: read, validated and explained."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.calibration.spec import Bounds, FitError, load_task, make_task, Target


GOOD = """
[targets]
height_to_width = {value = 1.8, uncertainty = 0.2}
neck_to_width = [0.4, 0.1]

[parameters]
spring_stiffness = {low = 0.005, high = 0.5, start = 0.04}
contact_adhesion = [0, 1]

[fit]
seeds = [3, 4]
"""


def entries(**changed):
    good = {"targets": {"height_mm": (9, 1)}, "parameters": {"adhesion": (0.1, 0.3)}}
    return {**good, **changed}


def test_a_file_is_read(tmp_path):
    path = tmp_path / "targets.toml"
    path.write_text(GOOD)
    task = load_task(path)
    assert task.targets["height_to_width"] == Target(value=1.8, uncertainty=0.2)
    assert task.targets["neck_to_width"] == Target(value=0.4, uncertainty=0.1)
    assert task.parameters["contact_adhesion"] == Bounds(low=0, high=1)
    assert task.parameters["spring_stiffness"].start == 0.04
    assert task.fit.seeds == (3, 4)
    assert task.fit.evaluations == 30


@pytest.mark.parametrize(
    "changed, sentence",
    [
        ({"targets": {}}, "targets is empty"),
        ({"targets": {"height": (9, 1)}}, "did you mean height_mm"),
        ({"targets": {"height_mm": (9, 0)}}, "targets.height_mm.uncertainty is 0"),
        ({"targets": {"height_mm": (9,)}}, "give value and uncertainty, for example"),
        (
            {"targets": {"height_mm": 9.0}},
            r"targets.height_mm is 9.0: give value and uncertainty, for example \[9.0,",
        ),
        ({"targets": 3}, "targets is 3: give names with two numbers each"),
        ({"targets": {3: (9, 1)}}, "targets: 3 is unknown"),
        (
            {"parameters": ("spring_stiffness",)},
            "parameters is .'spring_stiffness',.: give names with two numbers each, "
            r'for example {"spring_stiffness": \[0.01, 0.4\]}',
        ),
        ({"parameters": {"adhesion": 0.2}}, "give low and high, for example"),
        ({"targets": {"height_mm": {"value": 9}}}, "uncertainty is missing"),
        (
            {"targets": {"height_mm": {"value": 9, "uncertainty": 1, "sigma": 2}}},
            "targets.height_mm.sigma is unknown; known are value, uncertainty",
        ),
        ({"parameters": {"stiffness": (1, 2)}}, "stiffness is unknown"),
        ({"parameters": {"adhesion": (0.3, 0.1)}}, "low must be less"),
        ({"parameters": {"pretension": (0.1, 2)}}, "a number from 0 to 0.9"),
        (
            {"parameters": {"adhesion": {"low": 0.1, "high": 0.3, "start": 0.3}}},
            "start is 0.3; it must lie between 0.1 and 0.3",
        ),
        ({"fit": {"seeds": np.arange(0)}}, r"fit.seeds is \[\]: give whole numbers"),
        ({"fit": {"seeds": 3}}, "fit.seeds is 3: give whole numbers, for example"),
        ({"fit": {"seeds": np.eye(1)}}, r"fit.seeds.0 is \[1.0\]: input should be a"),
        ({"fit": {"seeds": [0, 1.5]}}, "fit.seeds.1 is 1.5: input should be a valid i"),
        ({"fit": {"seeds": [1, 1]}}, "a seed is given twice"),
        ({"fit": {"steps": 3}}, "fit.steps is unknown"),
        ({"fit": {"evaluations": 0}}, "fit.evaluations is 0"),
        ({"goals": {}}, "goals is unknown"),
    ],
)
def test_a_wrong_entry_is_named(changed, sentence):
    with pytest.raises(FitError, match=sentence) as caught:
        make_task(entries(**changed), source="here")
    assert str(caught.value).startswith("here: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "seeds", [range(4), np.arange(4), list(np.arange(4)), jnp.arange(4), iter(range(4))]
)
def test_whole_numbers_of_any_kind_are_seeds(seeds):
    task = make_task(entries(fit={"seeds": seeds}), source="here")
    assert task.fit.seeds == (0, 1, 2, 3)
    assert all(type(seed) is int for seed in task.fit.seeds)


def test_there_are_eight_seeds_by_default():
    assert make_task(entries(), source="here").fit.seeds == tuple(range(8))


def test_numbers_and_pairs_of_numpy_are_taken():
    targets = {"height_mm": np.array([9.0, 1.0]), "width_mm": (np.float32(3), 1)}
    task = make_task(
        entries(targets=targets, fit={"evaluations": np.int64(3)}), source="here"
    )
    assert task.targets["height_mm"] == Target(value=9.0, uncertainty=1.0)
    assert task.targets["width_mm"] == Target(value=3.0, uncertainty=np.float64(1))
    assert task.fit.evaluations == 3


def test_a_file_that_is_absent_or_no_toml_is_refused(tmp_path):
    with pytest.raises(FitError, match="cannot be read: No such file"):
        load_task(tmp_path / "absent.toml")
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("targets =")
    with pytest.raises(FitError, match="is not valid TOML"):
        load_task(wrong)
