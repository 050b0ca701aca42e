r"""Uncertainty of the fitted parameters, and reasons for missed targets.

In the unconstrained coordinates, with the Jacobian J of the residuals in units of their
uncertainty, the posterior is taken to be normal around the fit (Laplace), with the
variance :math:`\pi^2/3` of a coordinate of which only the bounds are known:

.. math:: C = \Big(J^T J + \frac{3}{\pi^2} I\Big)^{-1},

with :math:`J^T J` less the expected contribution of the error of J over the seeds, so
that a parameter without effect is not mistaken for a determined one.

A mean over N seeds is uncertain as well. With the covariance S of the residuals over
the seeds, as all evaluations together estimate them (`jaxgrow.calibration.loss`), it
moves the fit by

.. math:: C_\text{seeds} = (C J^T)\, \frac{S}{N}\, (C J^T)^T .

The two are independent, and their variances add.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrow.calibration.coordinates import Coordinates, PRIOR_VARIANCE
from jaxgrow.calibration.loss import Estimate, Evaluation
from jaxgrow.calibration.search import End, Search
from jaxgrow.calibration.spec import Task


AT_BOUND = 3.5
"""Coordinate beyond which a parameter is at its bound: less than 3 % of the way are
left."""

UNDETERMINED = 0.5
"""Share of its prior variance above which a parameter is not determined."""


class Fitted(NamedTuple):
    """Fitted parameter with its uncertainties.

    Attributes:
        value: of the least loss.
        low: one standard deviation less, all uncertainties together; NaN for one seed.
        high: one standard deviation more; never beyond the bounds.
        from_targets: standard deviation that comes from the targets' uncertainties.
        from_seeds: standard deviation that comes from the number of seeds; NaN for one.
        determined: whether the targets constrain it more than its bounds do.
    """

    value: float
    low: float
    high: float
    from_targets: float
    from_seeds: float
    determined: bool


class Achieved(NamedTuple):
    """Target with the value that the fit achieves.

    Attributes:
        target: the wanted value.
        uncertainty: the expert's.
        achieved: mean of lesions with the fitted parameters, as the lesions of all
            evaluations estimate it.
        grown: mean of those that were grown with them.
        spread: standard deviation of one lesion, over the seeds; NaN for one.
        residual: (achieved - target) / uncertainty.
        reason: why it is not reached within its uncertainty; None if it is.
    """

    target: float
    uncertainty: float
    achieved: float
    grown: float
    spread: float
    residual: float
    reason: str | None

    @property
    def reached(self) -> bool:
        """Whether it is within the uncertainty."""
        return abs(self.residual) <= 1


def fitted_parameters(
    coordinates: Coordinates, at: Evaluation, estimate: Estimate | None
) -> list[Fitted]:
    """Compute the parameters of a fit with their uncertainties.

    If nothing grew, only the bounds constrain them.
    """
    number = len(at.u)
    precision = np.eye(number) / PRIOR_VARIANCE
    if estimate is not None:
        precision = precision + estimate.information
    covariance = np.linalg.inv(precision)
    variance, sampling = np.diag(covariance), np.zeros(number)
    if estimate is not None:
        influence = covariance @ estimate.jacobian.T
        sampling = np.diag(influence @ estimate.residual_error @ influence.T)
        if len(estimate.residuals) == 1:
            sampling = np.full(number, math.nan)
    deviation = np.sqrt(variance + sampling)
    slopes = np.asarray(coordinates.slopes(jnp.asarray(at.u)))
    low, high = (
        np.asarray(coordinates.parameters(jnp.asarray(at.u + side * deviation)))
        for side in (-1, 1)
    )
    return [
        Fitted(
            at.values[i],
            float(low[i]),
            float(high[i]),
            float(np.sqrt(variance[i]) * slopes[i]),
            float(np.sqrt(sampling[i]) * slopes[i]),
            bool(variance[i] < UNDETERMINED * PRIOR_VARIANCE),
        )
        for i in range(number)
    ]


def achieved_targets(task: Task, found: Search) -> list[Achieved]:
    """Compare the targets with the values that the fit achieves.

    The list is empty if nothing grew.
    """
    metrics, estimate = found.best.metrics, found.estimate
    if metrics is None or estimate is None:
        return []
    residual = estimate.residual
    wanted = task.targets.values()
    mean = [t.value + t.uncertainty * r for t, r in zip(wanted, residual, strict=True)]
    spread = np.full(len(mean), math.nan)
    if len(metrics) > 1:
        spread = metrics.std(axis=0, ddof=1)
    rows = list[Achieved]()
    for i, (name, target) in enumerate(task.targets.items()):
        reason = None
        if abs(residual[i]) > 1:
            seen = [tried.metrics[i] for tried in found.history if tried.metrics]
            side = "above" if residual[i] > 0 else "below"
            reason = (
                f"{name} is {mean[i]:.3g}, {abs(residual[i]):.1f} uncertainties {side} "
                f"its target {target.value:g} ± {target.uncertainty:g}; it was "
                f"{min(seen):.3g} to {max(seen):.3g} in all evaluations: "
                f"{_why(task, found, estimate, i)}"
            )
        rows.append(
            Achieved(
                target.value,
                target.uncertainty,
                float(mean[i]),
                float(metrics[:, i].mean()),
                float(spread[i]),
                float(residual[i]),
                reason,
            )
        )
    return rows


def _why(task: Task, found: Search, estimate: Estimate, index: int) -> str:
    """Explain why a target is missed, as far as the sensitivities show."""
    if not np.any(estimate.jacobian):
        return f"there is no derivative; {_ended(found)}"
    residual = estimate.residual
    metrics, names = list(task.targets), list(task.parameters)
    u = found.best.u
    share = 1 / (1 + np.exp(-u))
    # linear change over the whole way between the bounds
    whole = estimate.jacobian / (share * (1 - share))
    towards = -np.sign(residual[index]) * whole[index]
    within = np.abs(towards).sum()
    if within < abs(residual[index]):
        return (
            f"from bound to bound, {_listed(names)} {_verb(names, 'change')} it by "
            f"about {within:.2g} uncertainties."
        )
    held = (np.abs(u) > AT_BOUND) & (towards * u > 0)
    limits = [
        f"{names[p]} is at its {'upper' if u[p] > 0 else 'lower'} bound"
        for p in np.flatnonzero(held)
    ]
    moved = whole @ np.where(held, 0, towards)
    against = [
        metrics[k]
        for k in range(len(metrics))
        if k != index and moved[k] * residual[k] > 0.1 * abs(moved[index])
    ]
    if against:
        limits.append(f"what would move it there moves {_listed(against)} away")
    if limits:
        return f"{'; '.join(limits)}."
    return _ended(found)


def _ended(found: Search) -> str:
    sentence = found.end.value[0].lower() + found.end.value[1:]
    return f"{sentence[:-1]}; allow more." if found.end is End.EXHAUSTED else sentence


def _listed(names: list[str]) -> str:
    if len(names) == 1:
        return names[0]
    return f"{', '.join(names[:-1])} and {names[-1]}"


def _verb(names: list[str], verb: str) -> str:
    return f"{verb}s" if len(names) == 1 else verb
