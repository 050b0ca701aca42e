"""Registry of metrics: those of the package, and those of a user's own."""

from collections.abc import Callable, Iterable
from dataclasses import fields
from typing import TypeAlias, TypeVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.metrics.shape import shape_metrics, ShapeMetrics
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import State


Metric: TypeAlias = Callable[[State], Scalar]
"""Number that a state has; its unit is in its name, as in ``bulge_mm``."""

METRICS: dict[str, Metric] = {}
"""Registered metrics, by name, besides the fields of `ShapeMetrics`."""

_Own = TypeVar("_Own", bound=Metric)


def register_metric(metric: _Own) -> _Own:
    """Register a metric for targets of fits and for reports.

    It may be used as a decorator of the function, whose name is that of the metric and
    ends with its unit, if it has one: ``_mm``, ``_mm2``, ``_mm3``, ``_per_mm``. A
    metric of the same name is replaced.

    Args:
        metric: a function of a `jaxgrow.State` that returns one real number, NaN where
            it has none. A fit takes its derivative, so it is written with
            `jax.numpy`.

    Raises:
        TypeError: it is not a function with a name.
        ValueError: the name is one of `ShapeMetrics`.
    """
    name = getattr(metric, "__name__", "")
    if not (callable(metric) and name.isidentifier()):
        raise TypeError(
            f"{metric!r} is no metric; give a function of a state whose name is that "
            "of the metric."
        )
    if name in _of_shape():
        raise ValueError(
            f"the metric {name} is one of jaxgrow's ShapeMetrics; choose another name."
        )
    METRICS[name] = metric
    return metric


def _of_shape() -> tuple[str, ...]:
    return tuple(field.name for field in fields(ShapeMetrics))


def metric_names() -> tuple[str, ...]:
    """Return the names of all metrics that there are."""
    return (*_of_shape(), *METRICS)


def measure(
    state: State, names: Iterable[str] | None = None, *, smoothing: float = 0.0
) -> dict[str, Float[Array, ""]]:
    """Compute metrics of a grown lesion, by their names.

    Args:
        state: of a growth.
        names: of `metric_names`; None for all.
        smoothing: of those of `jaxgrow.shape_metrics`, in r0.

    Raises:
        TypeError: a registered metric did not return one real number.
    """
    names = metric_names() if names is None else tuple(names)
    shape = shape_metrics(state, smoothing=smoothing)
    own = {name: _number(name, state) for name in names if name in METRICS}
    return {n: own[n] if n in own else getattr(shape, n) for n in names}


def _number(name: str, state: State) -> Float[Array, ""]:
    """Compute a registered metric, with the dtype of the state."""
    value = jnp.asarray(METRICS[name](state))
    if value.shape != () or jnp.iscomplexobj(value):
        raise TypeError(
            f"the metric {name} returned an array of {value.dtype} with the shape "
            f"{value.shape}; it must return one real number."
        )
    return value.astype(state.frame.particle_mm.dtype)
