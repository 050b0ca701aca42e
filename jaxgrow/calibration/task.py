"""What a fit is asked for: targets, the parameters it may change, and its effort.

As a TOML file:

.. code-block:: toml

    [targets]                       # any of `jaxgrow.metrics.shape.ShapeMetrics`
    height_to_width = {value = 1.8, uncertainty = 0.2}
    neck_to_width = [0.4, 0.1]      # the same, shorter

    [parameters]                    # any of `jaxgrow.Parameters`
    spring_stiffness = {low = 0.005, high = 0.5, start = 0.04}
    contact_adhesion = [0.05, 1.0]  # starts at the scene's value

    [fit]
    seeds = [0, 1, 2, 3]
    evaluations = 30
"""

import dataclasses
import warnings
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import pydantic

from jaxgrow.entries import check_names, Positive, read_toml, validated
from jaxgrow.metrics import ShapeMetrics
from jaxgrow.parameters import Parameters


Finite: TypeAlias = Annotated[float, pydantic.Field(allow_inf_nan=False)]
Seed: TypeAlias = Annotated[int, pydantic.Field(ge=0)]

METRICS = tuple(field.name for field in dataclasses.fields(ShapeMetrics))
PARAMETERS = tuple(field.name for field in dataclasses.fields(Parameters))


class FitError(ValueError):
    """A fit that cannot be made; its message is the sentence for the user."""


class _Model(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(frozen=True, strict=True, extra="forbid")

    @pydantic.model_validator(mode="before")
    @classmethod
    def _from_a_pair(cls, given: Any) -> Any:
        if isinstance(given, list | tuple):
            names = list(cls.model_fields)[:2]
            if len(given) != 2:
                raise ValueError(f"give two numbers, {names[0]} and {names[1]}")
            return dict(zip(names, given, strict=True))
        return given


class Target(_Model):
    """What an expert says of a metric: value ± one standard deviation.

    Attributes:
        value: in the metric's unit.
        uncertainty: the expert's, in the same unit.
    """

    value: Finite
    uncertainty: Positive


class Bounds(_Model):
    """Between which values a parameter is sought.

    Attributes:
        low: lower bound; if positive, the parameter is sought on a logarithmic scale.
        high: upper bound.
        start: where the search begins, between them; the scene's value if None.
    """

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
    """How much a fit may grow.

    Attributes:
        seeds: of the growths whose metrics are averaged, the same in every evaluation.
        evaluations: parameter values to try, at most; each is a growth for every seed.
        smoothing: of the metrics, in r0 (see `jaxgrow.shape_metrics`).
        max_divisions: of a growth; one that needs more has failed.
    """

    seeds: Annotated[
        tuple[Seed, ...], pydantic.Field(strict=False, min_length=1)
    ] = (0, 1, 2, 3)  # fmt: skip
    evaluations: Annotated[int, pydantic.Field(ge=1)] = 30
    smoothing: Annotated[float, pydantic.Field(ge=0, allow_inf_nan=False)] = 0.1
    max_divisions: Annotated[int, pydantic.Field(ge=1)] = 1000

    @pydantic.field_validator("seeds")
    @classmethod
    def _different(cls, seeds: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(seeds)) < len(seeds):
            raise ValueError("a seed is given twice")
        return seeds


class Task(_Model):
    """All that decides a fit, but its scene.

    Attributes:
        targets: by the names of metrics.
        parameters: by the names of parameters.
        fit: its effort.
    """

    targets: Annotated[dict[str, Target], pydantic.Field(min_length=1)]
    parameters: Annotated[dict[str, Bounds], pydantic.Field(min_length=1)]
    fit: Effort = Effort()

    @pydantic.field_validator("targets", mode="before")
    @classmethod
    def _known_metrics(cls, given: Any) -> Any:
        return _all_known(given, METRICS)

    @pydantic.field_validator("parameters", mode="before")
    @classmethod
    def _known_parameters(cls, given: Any) -> Any:
        return _all_known(given, PARAMETERS)

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
    """The task of a TOML file.

    Raises:
        FitError: the file cannot be read, is no TOML, or has a wrong entry; the message
            names each with what is wanted.
    """
    entries = read_toml(Path(path), "targets file", FitError)
    return make_task(entries, source=str(path))


def make_task(entries: dict[str, Any], *, source: str) -> Task:
    """A task from nested entries as TOML has them.

    Args:
        entries: keys as the fields of `Task`.
        source: where they come from, for the message.

    Raises:
        FitError: names every wrong entry with what is wanted.
    """
    return validated(Task, entries, source=source, error=FitError)


def _all_known(given: Any, known: tuple[str, ...]) -> Any:
    if isinstance(given, dict):
        check_names(given, known)
    return given
