"""Specification of a fit: targets, fitted parameters and effort.

As a TOML file:

.. code-block:: toml

    [targets]                       # any of `jaxgrow.metrics.metric_names()`
    height_to_width = {value = 1.8, uncertainty = 0.2}
    neck_to_width = [0.4, 0.1]      # the same, shorter

    [parameters]                    # any of `jaxgrow.Parameters`
    spring_stiffness = {low = 0.005, high = 0.5, start = 0.04}
    contact_adhesion = [0.05, 1.0]  # starts at the scene's value

    [fit]
    seeds = [0, 1, 2, 3, 4, 5, 6, 7]
    evaluations = 30
"""

import dataclasses
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeAlias

import pydantic
from pydantic_core import PydanticCustomError

from jaxgrow.energy.parameters import Parameters
from jaxgrow.metrics import metric_names
from jaxgrow.runtime.entries import check_names, Positive, read_toml, validated


Finite: TypeAlias = Annotated[float, pydantic.Field(allow_inf_nan=False)]
Seed: TypeAlias = Annotated[int, pydantic.Field(ge=0)]

PARAMETERS = tuple(field.name for field in dataclasses.fields(Parameters))

_SEEDS = "whole numbers, for example [0, 1, 2]"


class FitError(ValueError):
    """Error of a fit that cannot be made; its message is for the user."""


class _Model(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(frozen=True, strict=True, extra="forbid")

    @pydantic.model_validator(mode="before")
    @classmethod
    def _prepared(cls, given: Any) -> Any:
        return _in_python(given)


class _Pair(_Model):
    """Table that may be given as its first two entries."""

    wanted: ClassVar[str]

    @pydantic.model_validator(mode="before")
    @classmethod
    def _prepared(cls, given: Any) -> Any:
        given = _in_python(given)
        if isinstance(given, cls | dict):
            return given
        if not isinstance(given, list | tuple) or len(given) != 2:
            raise _unlike(cls.wanted)
        return dict(zip(cls.model_fields, given, strict=False))


class Target(_Pair):
    """Target of a metric: value ± one standard deviation.

    Attributes:
        value: in the metric's unit.
        uncertainty: the expert's, in the same unit.
    """

    wanted: ClassVar[str] = "value and uncertainty, for example [9.0, 0.5]"

    value: Finite
    uncertainty: Positive


class Bounds(_Pair):
    """Bounds of a parameter.

    Attributes:
        low: lower bound; if positive, the parameter is sought on a logarithmic scale.
        high: upper bound.
        start: start of the search, between them; the scene's value if None.
    """

    wanted: ClassVar[str] = "low and high, for example [0.01, 0.4]"

    low: Finite
    high: Finite
    start: Finite | None = None

    @pydantic.model_validator(mode="after")
    def _in_order(self) -> "Bounds":
        if not self.low < self.high:
            raise ValueError(
                f"low is {self.low:g} and high {self.high:g}; low must be less"
            )
        if self.start is not None and not self.low < self.start < self.high:
            raise ValueError(
                f"start is {self.start:g}; it must lie between {self.low:g} "
                f"and {self.high:g}"
            )
        return self


class Effort(_Model):
    """Effort of a fit: its growths.

    Attributes:
        seeds: of the growths whose metrics are averaged, the same in every evaluation.
            With four, the uncertainties of the parameters come out too small.
        evaluations: parameter values to try, at most; each is a growth for every seed.
        smoothing: of the metrics, in r0 (see `jaxgrow.shape_metrics`).
        max_divisions: of a growth; one that needs more has failed.
    """

    seeds: tuple[Seed, ...] = tuple(range(8))
    evaluations: Annotated[int, pydantic.Field(ge=1)] = 30
    smoothing: Annotated[float, pydantic.Field(ge=0, allow_inf_nan=False)] = 0.1
    max_divisions: Annotated[int, pydantic.Field(ge=1)] = 1000

    @pydantic.field_validator("seeds", mode="before")
    @classmethod
    def _several(cls, given: Any) -> Any:
        if isinstance(given, str | Mapping) or not isinstance(given, Iterable):
            raise _unlike(_SEEDS)
        seeds = tuple(_in_python(seed) for seed in given)
        if not seeds:
            raise _unlike(_SEEDS)
        return seeds

    @pydantic.field_validator("seeds")
    @classmethod
    def _different(cls, seeds: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(seeds)) < len(seeds):
            raise ValueError("a seed is given twice")
        return seeds


class Task(_Model):
    """Task of a fit: all that decides it, except its scene.

    Attributes:
        targets: by the names of metrics.
        parameters: by the names of parameters.
        fit: its effort.
    """

    targets: Annotated[dict[str, Target], pydantic.Field(min_length=1)]
    parameters: Annotated[dict[str, Bounds], pydantic.Field(min_length=1)]
    fit: Effort = pydantic.Field(default_factory=Effort)

    @pydantic.field_validator("targets", mode="before")
    @classmethod
    def _known_metrics(cls, given: Any) -> Any:
        return _all_known(given, metric_names(), '{"height_mm": [9.0, 0.5]}')

    @pydantic.field_validator("parameters", mode="before")
    @classmethod
    def _known_parameters(cls, given: Any) -> Any:
        return _all_known(given, PARAMETERS, '{"spring_stiffness": [0.01, 0.4]}')

    @pydantic.field_validator("parameters")
    @classmethod
    def _possible(cls, given: dict[str, Bounds]) -> dict[str, Bounds]:
        for name, bounds in given.items():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of adhesion that is unstable
                for value in (bounds.low, bounds.high):
                    Parameters(**{name: value})
        return given


def load_task(path: str | Path) -> Task:
    """Read a task from a TOML file.

    Raises:
        FitError: the file cannot be read, is not TOML, or has a wrong entry; the
            message names each with what is wanted.
    """
    entries = read_toml(Path(path), "targets file", FitError)
    return make_task(entries, source=str(path))


def make_task(entries: dict[str, Any], *, source: str) -> Task:
    """Build a task from nested entries, as TOML has them.

    Args:
        entries: keys as the fields of `Task`.
        source: their origin, for the message.

    Raises:
        FitError: names every wrong entry with what is wanted.
    """
    return validated(Task, entries, source=source, error=FitError)


def _all_known(given: Any, known: tuple[str, ...], example: str) -> Any:
    if not isinstance(given, dict):
        raise _unlike(f"names with two numbers each, for example {example}")
    check_names(map(str, given), known)
    return given


def _unlike(wanted: str) -> PydanticCustomError:
    """Build the error of an entry that does not have the wanted form."""
    return PydanticCustomError("form", "give {wanted}", {"wanted": wanted})


def _in_python(given: Any) -> Any:
    """Convert numbers and arrays of NumPy and JAX to Python's."""
    if hasattr(given, "tolist"):
        return given.tolist()
    if isinstance(given, tuple):
        return tuple(_in_python(entry) for entry in given)
    if isinstance(given, list):
        return [_in_python(entry) for entry in given]
    if isinstance(given, Mapping):
        return {name: _in_python(entry) for name, entry in given.items()}
    return given
