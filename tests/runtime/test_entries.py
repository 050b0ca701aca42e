"""Mistakes in tables that may be of several kinds; the others are those of scenes."""

from typing import Literal

import pydantic
import pytest

from jaxgrow.runtime.entries import validated


class DrawingError(ValueError):
    pass


class Table(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid")


class Circle(Table):
    kind: Literal["circle"] = "circle"
    radius: float


class Box(Table):
    kind: Literal["box"] = "box"
    width: float


class Drawing(Table):
    shape: Table

    @pydantic.field_validator("shape", mode="plain")
    @classmethod
    def _shape(cls, entries):
        kind = Box if entries["kind"] == "box" else Circle
        return kind.model_validate(entries)


def drawn(entries):
    tables = {"shape": Box}
    error = DrawingError
    return validated(Drawing, entries, source="here", error=error, tables=tables)


@pytest.mark.parametrize(
    "shape, sentence",
    [
        ({"kind": "box"}, "shape.width is missing"),
        ({"kind": "box", "width": "a"}, "shape.width is 'a': input should be"),
        (
            {"kind": "box", "width": 1, "radius": 1},
            "shape.radius is unknown; known are kind, width",
        ),
        (
            {"kind": "box", "width": 1, "box": 1},
            "shape.box is unknown; known are kind, width",
        ),
    ],
)
def test_mistake_is_told_by_the_fields_of_the_kind(shape, sentence):
    with pytest.raises(DrawingError, match=sentence):
        drawn({"shape": shape})


def test_entry_named_like_a_kind_is_unknown():
    with pytest.raises(DrawingError, match="here: box is unknown; known are shape"):
        drawn({"shape": {"kind": "box", "width": 1}, "box": 1})
