"""Entries of TOML files: read, validated, and their mistakes told in words."""

import difflib
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, get_args, TypeAlias, TypeVar

import pydantic


Positive: TypeAlias = Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)]

_Model = TypeVar("_Model", bound=pydantic.BaseModel)


class Model(pydantic.BaseModel):
    """A table of a file: frozen, strict, and without entries that are not known."""

    model_config = pydantic.ConfigDict(
        frozen=True, strict=True, extra="forbid", arbitrary_types_allowed=True
    )


class SceneError(ValueError):
    """A scene that cannot be grown; its message is the sentence for the user."""


def read_toml(path: Path, kind: str, error: type[ValueError]) -> dict[str, Any]:
    """The entries of a file as they stand there, unchecked.

    Args:
        path: of the file.
        kind: what it is, for the message.
        error: the class to raise.

    Raises:
        ValueError: an `error`; the file cannot be read, or is no TOML.
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
    """A model from nested entries.

    Args:
        model: whose fields the entries are.
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
    """Refuse a name that is not known.

    Raises:
        ValueError: with the one that may have been meant.
    """
    known = list(known)
    for name in given:
        if name not in known:
            raise ValueError(_unknown(name, name, known))


def _reason(cause: OSError | ValueError) -> str:
    """Why a file is of no use, in words."""
    if isinstance(cause, OSError):
        return f"cannot be read: {cause.strerror or type(cause).__name__}"
    if isinstance(cause, UnicodeDecodeError):
        return "cannot be read: it is no UTF-8 text"
    return f"is not valid TOML: {cause}"


def _explain(problem: Any, model: type[pydantic.BaseModel]) -> str:
    """One mistake in words: where, what came, what is wanted."""
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
    """Where an entry stands in the file: pydantic adds the kind of its table."""
    if len(location) > 1 and model.model_fields[location[0]].discriminator:
        return [location[0], *location[2:]]
    return location


def _table(
    model: type[pydantic.BaseModel], location: list[str]
) -> type[pydantic.BaseModel]:
    """The model of the table that an entry is in."""
    if len(location) == 1:
        return model
    field = model.model_fields[location[0]]
    tables = _models(field.annotation)
    if isinstance(kind := field.discriminator, str):
        return next(t for t in tables if t.model_fields[kind].default == location[1])
    return tables[0]


def _models(annotation: Any) -> list[type[pydantic.BaseModel]]:
    """All models that an annotation names."""
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def _unknown(where: str, name: str, known: Iterable[str]) -> str:
    """That an entry is unknown, with a near miss or all that is known."""
    known = list(known)
    near = [other for other in known if other.startswith(name)]
    near += difflib.get_close_matches(name, known, n=1)
    if near:
        return f"{where} is unknown; did you mean {near[0]}"
    return f"{where} is unknown; known are {', '.join(known)}"
