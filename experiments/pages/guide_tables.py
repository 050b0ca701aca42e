"""The tables of the guides, made from the models and docstrings that they describe.

A table stands in a guide between two comments,

    <!-- table: jaxgrow.scene.scene.Polyp -->
    <!-- end of table -->

and lists the attributes of the class that the first one names.
``python experiments/pages/guide_tables.py`` writes all tables; a test holds them up to
date.
"""

import dataclasses
import importlib
import re
import sys
import types
import typing
from pathlib import Path

import pydantic

from jaxgrow.energy import parameters
from jaxgrow.lesions.myoma import Myoma
from jaxgrow.lesions.polyp import Polyp


GUIDES = Path(__file__).parents[2] / "jaxgrow" / "guides"

TABLE = re.compile(r"(<!-- table: ([\w.]+) -->\n).*?(<!-- end of table -->)", re.S)


def main() -> int:
    for path in sorted(GUIDES.glob("*.md")):
        text = path.read_text(encoding="utf-8")
        made = with_tables(text)
        if made != text:
            path.write_text(made, encoding="utf-8")
            print(f"written: {path.name}")
    return 0


def with_tables(text: str) -> str:
    """A guide's text with its tables made anew."""
    return TABLE.sub(lambda m: f"{m[1]}\n{table_of(named(m[2]))}\n{m[3]}", text)


def named(name: str) -> type:
    module, _, attribute = name.rpartition(".")
    return getattr(importlib.import_module(module), attribute)


def table_of(model: type) -> str:
    """All attributes of a class as a Markdown table."""
    if issubclass(model, pydantic.BaseModel):
        head = ("entry", "what is given", "default", "meaning")
        rows = [entry_row(model, name) for name in own_fields(model)]
    elif model is parameters.Parameters:
        head = ("parameter", "range", "default", "meaning")
        rows = [parameter_row(field) for field in dataclasses.fields(model)]
    else:
        head = ("name", "meaning")
        told = meanings(model)
        rows = [(f"`{f.name}`", told[f.name]) for f in dataclasses.fields(model)]
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def own_fields(model: type[pydantic.BaseModel]) -> list[str]:
    """Fields that a model itself states; a kind that its subclasses give is none."""
    stated = [name for name in model.__annotations__ if name in model.model_fields]
    return [n for n in stated if n != "kind" or not model.model_fields[n].is_required()]


def entry_row(model: type[pydantic.BaseModel], name: str) -> tuple[str, ...]:
    field = model.model_fields[name]
    told = meanings(model).get(name, "")
    if not told and typing.get_origin(field.annotation) is typing.Literal:
        told = f"a {field.default} (see above)"
    if not told:
        raise ValueError(f"the docstring of {model.__name__} does not tell {name}.")
    return (
        f"`{name}`",
        kind_of(field.annotation, field.metadata),
        default_of(field),
        told,
    )


def default_of(field: pydantic.fields.FieldInfo) -> str:
    if field.is_required():
        return "must be given"
    value = field.get_default(call_default_factory=True)
    if isinstance(value, bool | int | float | str):
        return f"`{as_toml(value)}`"
    if isinstance(value, tuple):
        return f"`{as_toml(value)}`"
    return "–"


def as_toml(value: object) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple):
        return f"[{', '.join(map(as_toml, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def kind_of(annotation: typing.Any, metadata: typing.Sequence[typing.Any] = ()) -> str:
    """What an annotation takes, in the words of TOML."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return kind_of(arguments[0], [*metadata, *arguments[1:]])
    if origin is typing.Literal:
        return " or ".join(f"`{as_toml(value)}`" for value in arguments)
    if origin in (typing.Union, types.UnionType):
        kinds = (kind_of(part, metadata) for part in arguments)
        return " or ".join(dict.fromkeys(kind for kind in kinds if kind))
    if origin is tuple:
        if arguments[-1] is Ellipsis:
            return f"list of {kind_of(arguments[0])}"
        return f"list of {len(arguments)} {kind_of(arguments[0])}s"
    if origin is dict:
        return "table"
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        return "table"
    words = {float: "number", int: "whole number", str: "text", Path: "text"}
    words |= {parameters.Parameters: "table"}
    if annotation not in words:  # what only Python can give
        return ""
    return words[annotation] + bounds_of(metadata)


def bounds_of(metadata: typing.Sequence[typing.Any]) -> str:
    """The bounds of a number, in words."""
    found = dict[str, float]()
    for entry in metadata:
        for part in getattr(entry, "metadata", [entry]):
            for name in ("gt", "ge", "lt", "le"):
                if getattr(part, name, None) is not None:
                    found[name] = getattr(part, name)
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
    return "".join(
        f"{',' if place else ''} {signs[name]} {bound:g}"
        for place, (name, bound) in enumerate(found.items())
    )


def parameter_row(field: dataclasses.Field) -> tuple[str, ...]:
    low, high = parameters._RANGES[field.name]
    bounds = f"≥ {low:g}" if high == float("inf") else f"{low:g} to {high:g}"
    default = f"{field.default:g}"
    for kind in (Polyp, Myoma):
        if field.name in kind.mechanics:
            default += f"; {kind.mechanics[field.name]:g} for a {kind.__name__.lower()}"
    return (
        f"`{field.name}`",
        bounds,
        default,
        meanings(parameters.Parameters)[field.name],
    )


def meanings(model: type) -> dict[str, str]:
    """What a docstring tells of each attribute, as Markdown."""
    text = (model.__doc__ or "").replace("\r", "")
    _, _, section = text.partition("Attributes:\n")
    section = re.split(r"\n\s*\n", section)[0]
    found = dict[str, str]()
    for entry in re.split(r"\n? {8}(?=\w+: )", "\n" + section):
        name, _, meaning = entry.partition(": ")
        found[name.strip()] = as_markdown(" ".join(meaning.split()))
    return found


def as_markdown(text: str) -> str:
    text = re.sub(r":math:`([^`]*)`", r"`\1`", text).replace("``", "`")
    return text.replace("|", r"\|")


if __name__ == "__main__":
    sys.exit(main())
