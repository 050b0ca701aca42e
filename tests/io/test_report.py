"""Reports hold nothing but what JSON has."""

import enum
import json
import math
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.parameters import Parameters
from jaxgrow.io.report import named, plain, versions


class _Colour(enum.Enum):
    red = 1


class _Pair(NamedTuple):
    one: float
    two: float


@pytest.mark.parametrize(
    "value, wanted",
    [
        (math.nan, None),
        (-math.inf, None),
        (np.float64(0.1), 0.1),
        (np.float32(math.inf), None),
        (np.int64(3), 3),
        (np.bool_(True), True),
        (jnp.asarray(2.5), 2.5),
        (np.array([[1.0, math.nan]]), [[1.0, None]]),
        ((1, "a", None), [1, "a", None]),
        (Path("a") / "b", "a/b"),
        (_Colour.red, "red"),
        ({1: {"x": np.zeros(2)}}, {"1": {"x": [0.0, 0.0]}}),
    ],
)
def test_value_becomes_what_json_has(value, wanted):
    found = plain(value)
    assert found == wanted
    assert type(found) is type(wanted)
    json.dumps(found, allow_nan=False)


def test_numbers_keep_all_their_digits():
    number = 0.1 + 0.2
    assert json.loads(json.dumps(plain(np.float64(number)))) == number


def test_fields_are_named():
    assert named(_Pair(1.0, 2.0)) == {"one": 1.0, "two": 2.0}
    assert named({"a": 1}) == {"a": 1}
    assert named(Parameters())["adhesion"] == 0.2


def test_versions_are_told_or_none():
    found = versions()
    assert found["numpy"] == np.__version__
    assert None not in (found["python"], found["jax"], found["jax-md"])
