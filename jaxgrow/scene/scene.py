"""Scene of a growth: organ, lesion and parameters, read and validated.

Lengths of a scene are in millimetres, except in `Surroundings`, where they are in r0,
the diameter of a particle, and in `Parameters`, where they are in `Lesion.unit_mm`, a
fraction of the lesion's size, which is r0 by default. So the size of the particles is a
resolution: the material is the same for all.
"""

import dataclasses
from pathlib import Path
from typing import Any, get_args, Literal

import pydantic
from pydantic_core import InitErrorDetails, PydanticCustomError, ValidationError

from jaxgrow.energy.parameters import Parameters, PRINTED
from jaxgrow.lesions.lesion import Lesion
from jaxgrow.lesions.myoma import Myoma
from jaxgrow.lesions.polyp import Polyp
from jaxgrow.organ.organ import Organ
from jaxgrow.organ.registry import ORGANS
from jaxgrow.runtime.entries import (
    check_names,
    Model,
    Positive,
    read_toml,
    SceneError,
    UNKNOWN_KIND,
    validated,
)


LESIONS: dict[str, type[Lesion]] = {"polyp": Polyp, "myoma": Myoma}
"""Registered kinds of lesion, by name; those of scene files and of the command."""


class Surroundings(Model):
    """Extent and resolution of the simulated part of the organ, in r0.

    Attributes:
        radius: of the patch of surface, along the surface; chosen from the lesion's
            size if None.
        thickness: of the layer of tissue under it; chosen from the lesion if None.
        density: of tissue particles, per r0³.
        max_area: triangles larger than this (in r0²) are subdivided.
        min_area: triangles smaller than this (in r0²) are collapsed.
        collisions: whether the surface repels itself and the rest of the organ: "auto"
            from the first time on that they are near each other, "on" always, "off"
            never. Lesions of one seed differ between "auto" and "on" as between two
            seeds: their packings do.
    """

    radius: Positive | None = None
    thickness: Positive | None = None
    density: Positive = 1.7
    max_area: Positive = 0.7
    min_area: Positive = 0.1
    collisions: Literal["auto", "on", "off"] = "auto"


class Scene(Model):
    """Full specification of a growth, except its seed and tolerance.

    Attributes:
        organ: "uterus" or another registered name, the path of a mesh file, an `Organ`,
            or None for a lesion that grows freely in space.
        unit_mm: length of one unit of the organ's file, in mm.
        tissue: side of the organ's surface on which its tissue lies: "outside" of a
            hollow organ's inner surface, "inside" of a solid one.
        lesion: a `Polyp`, a `Myoma`, or one of another registered kind.
        parameters: of the mechanics, in units of a fraction of the lesion's size (see
            `Lesion.unit_mm`); the default of each is that of the lesion's kind.
            "printed" for those of the paper alone.
        surroundings: of the lesion.
    """

    organ: Organ | Path | str | None = "uterus"
    unit_mm: Positive = 1.0
    tissue: Literal["outside", "inside"] = "outside"
    lesion: pydantic.SerializeAsAny[Lesion] = Polyp()
    parameters: Parameters = pydantic.Field(default_factory=dict, validate_default=True)
    surroundings: Surroundings = Surroundings()

    @pydantic.field_validator("lesion", mode="plain")
    @classmethod
    def _lesion(cls, value: object) -> Lesion:
        # a kind need not be registered to be used in Python
        return value if isinstance(value, Lesion) else _read_lesion(value)

    @pydantic.field_validator("parameters", mode="before")
    @classmethod
    def _parameters(cls, value: object, others: Any) -> object:
        if value == "printed":
            value = dict(PRINTED)
        if not isinstance(value, dict):
            return value
        lesion = others.data.get("lesion")  # None if it is wrong
        if isinstance(lesion, Lesion):
            twice = sorted(set(lesion.requested()) & set(value))
            if twice:
                raise ValueError(
                    f"the lesion determines {twice[0]} already; give one of both"
                )
            value = {**lesion.defaults(), **lesion.requested(), **value}
        check_names(value, [field.name for field in dataclasses.fields(Parameters)])
        for name, number in value.items():
            if isinstance(number, bool) or not isinstance(number, int | float):
                raise ValueError(f"parameter {name} is {number!r}; give a number")
        return Parameters(**value)

    @pydantic.model_validator(mode="after")
    def _some_need_a_surface(self) -> "Scene":
        if self.organ is None and self.lesion.needs_organ:
            kind = self.lesion.kind
            raise ValueError(
                f"a {kind} grows from a surface: give an organ, or a myoma"
            )
        return self

    @property
    def r0_mm(self) -> float:
        """Length of r0 in mm."""
        return self.lesion.r0_mm


def _read_lesion(entries: object) -> Lesion:
    """Make a lesion of a registered kind from its entries.

    Raises:
        ValueError: one that pydantic takes apart, with the place of each error.
    """
    if not isinstance(entries, dict):
        raise PydanticCustomError("table", "give a table with a kind, or a Lesion")
    if "kind" not in entries:
        raise _at_kind(entries, "missing")
    name = entries["kind"]
    if not isinstance(name, str) or name not in LESIONS:
        known = {"known": ", ".join(map(repr, LESIONS))}
        unknown = PydanticCustomError(UNKNOWN_KIND, "known are {known}", known)
        raise _at_kind(name, unknown)
    return LESIONS[name].model_validate(entries)


def _at_kind(given: object, problem: str | PydanticCustomError) -> ValidationError:
    """Return the error of a lesion's kind."""
    line = InitErrorDetails(type=problem, loc=("kind",), input=given)
    return ValidationError.from_exception_data("Lesion", [line])


def register_lesion(kind: type[Lesion]) -> type[Lesion]:
    """Register a kind of lesion for scenes, scene files and the command.

    It may be used as a decorator of the class. A kind of the same name is replaced.

    Args:
        kind: with a field ``kind`` whose annotation is a literal of its name.

    Raises:
        TypeError: the class has no such field, or one of its methods is missing.
    """
    field = getattr(kind, "model_fields", {}).get("kind")
    name = None if field is None else field.default
    literal = None if field is None else get_args(field.annotation)
    if not isinstance(name, str) or literal != (name,):
        raise TypeError(
            f"{kind!r} is no kind of lesion; derive it from jaxgrow.Lesion, with the "
            'field kind: Literal["name"] = "name".'
        )
    if missing := getattr(kind, "__abstractmethods__", None):
        raise TypeError(f"{kind.__name__} has no {', no '.join(sorted(missing))}.")
    LESIONS[name] = kind
    return kind


def load_scene(path: str | Path) -> Scene:
    """Load the scene of a TOML file.

    A relative path of the organ is relative to that file.

    Raises:
        SceneError: the file cannot be read, is not valid TOML, or has a wrong entry;
            the message names each with what is wanted.
    """
    return make_scene(read_entries(path), source=str(path))


def read_entries(path: str | Path) -> dict[str, Any]:
    """Read the entries of a scene file, without validation.

    Raises:
        SceneError: the file cannot be read, or is not valid TOML.
    """
    path = Path(path)
    entries = read_toml(path, "scene", SceneError)
    organ = entries.get("organ")
    if isinstance(organ, str) and organ not in ORGANS:
        entries["organ"] = str(path.parent / organ)
    return entries


def make_scene(entries: dict[str, Any], *, source: str) -> Scene:
    """Make a scene from nested entries as TOML has them.

    Args:
        entries: keys as the fields of `Scene`.
        source: where they come from, for the message.

    Raises:
        SceneError: names every wrong entry with what is wanted.
    """
    lesion = entries.get("lesion")
    kind = str(lesion.get("kind")) if isinstance(lesion, dict) else ""
    tables = {"lesion": LESIONS[kind]} if kind in LESIONS else {}
    return validated(Scene, entries, source=source, error=SceneError, tables=tables)
