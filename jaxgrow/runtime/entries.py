"""Entries of TOML files: parsing, validation and error messages."""

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, get_args, TypeAlias, TypeVar

import pydantic


Positive: TypeAlias = Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)]

UNKNOWN_KIND = "unknown_kind"
"""Type of the error of a table whose kind is unknown."""

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
    tables: Mapping[str, type[pydantic.BaseModel]] | None = None,
) -> _Model:
    """Validate nested entries, and make a model of them.

    Args:
        model: class with the entries as fields.
        entries: as TOML has them.
        source: where they come from, for the message.
        error: the class to raise.
        tables: models of tables that are more than their fields' annotations say.

    Raises:
        ValueError: an `error` that names every wrong entry with what is wanted.
    """
    try:
        return model(**entries)
    except pydantic.ValidationError as cause:
        own = {name: field.annotation for name, field in model.model_fields.items()}
        own |= tables or {}
        problems = "; ".join(_explain(each, model, own) for each in cause.errors())
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


def _explain(
    problem: Any, model: type[pydantic.BaseModel], tables: Mapping[str, Any]
) -> str:
    """Describe one validation error: its entry, what came, what is wanted."""
    location = [str(part) for part in problem["loc"]]
    where = ".".join(location)
    if problem["type"] == "missing":
        return f"{where} is missing"
    if problem["type"] == "extra_forbidden":
        return _unknown(where, location[-1], _fields(model, location, tables))
    if problem["type"] == UNKNOWN_KIND:
        return f"{where} is {problem['input']!r}; {problem['msg']}"
    if problem["type"] == "too_short" and not problem["input"]:
        return f"{where} is empty"
    if problem["type"] == "value_error":
        sentence = str(problem["ctx"]["error"]).rstrip(".")
        return f"{where}: {sentence}" if where else sentence
    message = problem["msg"]
    message = message[0].lower() + message[1:]
    return f"{where} is {problem['input']!r}: {message}"


def _fields(
    model: type[pydantic.BaseModel], location: list[str], tables: Mapping[str, Any]
) -> Iterable[str]:
    """Return the names that the table of an entry knows."""
    if len(location) == 1:
        return model.model_fields
    return _models(tables[location[0]])[0].model_fields


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
