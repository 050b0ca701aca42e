"""Entries of TOML files: parsing, validation and error messages."""

import difflib
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, get_args, TypeAlias, TypeVar

import pydantic


Positive: TypeAlias = Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)]

_Model = TypeVar("_Model", bound=pydantic.BaseModel)


class Model(pydantic.BaseModel):
    """Table of a file: frozen, strict, and without unknown entries."""

    model_config = pydantic.ConfigDict(
        frozen=True, strict=True, extra="forbid", arbitrary_types_allowed=True
    )


class SceneError(ValueError):
    """Error in a scene; its message is the sentence for the user."""


def read_toml(path: Path, kind: str, error: type[ValueError]) -> dict[str, Any]:
    """Read the entries of a TOML file, without validation.

    Args:
        path: of the file.
        kind: of the file, for the message.
        error: the class to raise.

    Raises:
        ValueError: an `error`; the file cannot be read, or is not valid TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as cause:
        raise error(f"the {kind} {path} {_reason(cause)}.") from cause


def validated(
    model: type[_Model],
    entries: dict[str, Any],
    *,
    source: str,
    error: type[ValueError],
) -> _Model:
    """Validate nested entries, and make a model of them.

    Args:
        model: class with the entries as fields.
        entries: as TOML has them.
        source: where they come from, for the message.
        error: the class to raise.

    Raises:
        ValueError: an `error` that names every wrong entry with what is wanted.
    """
    try:
        return model(**entries)
    except pydantic.ValidationError as cause:
        problems = "; ".join(_explain(problem, model) for problem in cause.errors())
        raise error(f"{source}: {problems}.") from cause


def check_names(given: Iterable[str], known: Iterable[str]) -> None:
    """Refuse an unknown name.

    Raises:
        ValueError: with the closest known name.
    """
    known = list(known)
    for name in given:
        if name not in known:
            raise ValueError(_unknown(name, name, known))


def _reason(cause: OSError | ValueError) -> str:
    """Describe why a file cannot be used."""
    if isinstance(cause, OSError):
        return f"cannot be read: {cause.strerror or type(cause).__name__}"
    if isinstance(cause, UnicodeDecodeError):
        return "cannot be read: it is no UTF-8 text"
    return f"is not valid TOML: {cause}"


def _explain(problem: Any, model: type[pydantic.BaseModel]) -> str:
    """Describe one validation error: its entry, what came, what is wanted."""
    location = [str(part) for part in problem["loc"]]
    where = ".".join(_keys(model, location))
    if problem["type"] == "missing":
        return f"{where} is missing"
    if problem["type"] == "extra_forbidden":
        return _unknown(where, location[-1], _table(model, location).model_fields)
    if problem["type"] == "union_tag_invalid":
        tag = problem["ctx"]
        return f"{where}.kind is {tag['tag']!r}; known are {tag['expected_tags']}"
    if problem["type"] == "too_short" and not problem["input"]:
        return f"{where} is empty"
    if problem["type"] == "value_error":
        sentence = str(problem["ctx"]["error"]).rstrip(".")
        return f"{where}: {sentence}" if where else sentence
    message = problem["msg"]
    message = message[0].lower() + message[1:]
    return f"{where} is {problem['input']!r}: {message}"


def _keys(model: type[pydantic.BaseModel], location: list[str]) -> list[str]:
    """Convert a location of pydantic into the keys of the file.

    Pydantic inserts the kind of a table.
    """
    if len(location) > 1 and model.model_fields[location[0]].discriminator:
        return [location[0], *location[2:]]
    return location


def _table(
    model: type[pydantic.BaseModel], location: list[str]
) -> type[pydantic.BaseModel]:
    """Find the model of the table that an entry is in."""
    if len(location) == 1:
        return model
    field = model.model_fields[location[0]]
    tables = _models(field.annotation)
    if isinstance(kind := field.discriminator, str):
        return next(t for t in tables if t.model_fields[kind].default == location[1])
    return tables[0]


def _models(annotation: Any) -> list[type[pydantic.BaseModel]]:
    """List all models that an annotation names."""
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def _unknown(where: str, name: str, known: Iterable[str]) -> str:
    """Describe an unknown entry, with a near miss or all known names."""
    known = list(known)
    near = [other for other in known if other.startswith(name)]
    near += difflib.get_close_matches(name, known, n=1)
    if near:
        return f"{where} is unknown; did you mean {near[0]}"
    return f"{where} is unknown; known are {', '.join(known)}"
