r"""Loss of parameters, and its estimate from all grown lesions.

.. math:: L(p) = \frac12 \sum_t \Big(\frac{\bar m_t(p) - m_t}{\sigma_t}\Big)^2

with the mean :math:`\bar m_t` of a metric over the seeds. It is the loss of the mean,
not the mean of losses: that one is larger by the variance over seeds, and would prefer
parameters under which lesions differ less over those that give the right shape.

*Estimates.* A parameter that changes by a fraction of a per cent changes the packing of
a lesion as another seed does. So the metrics of two evaluations scatter, and the point
with the least loss is in part the luckiest one; and the derivative of a growth, which
is that of its frozen choices, lacks the response of the choices. Both are corrected by
the other evaluations: with their distances :math:`\Delta u_k` in the unconstrained
coordinates, the residuals :math:`r_{ks} = (m_{ks} - m)/\sigma` of each seed, and the
frozen sensitivities :math:`J_0`, a local linear regression (Cleveland 1979) takes, with
:math:`w_k = e^{-|\Delta u_k|^2}`,

.. math:: \min_{a_s, J_s}\; \sum_k w_k |r_{ks} - a_s - J_s \Delta u_k|^2
          + \mu |J_s - J_0|^2 .

:math:`\bar a` are the residuals and :math:`\bar J` the sensitivities of the mean
lesion. For an isolated point they are its own and the frozen ones. Since every seed has
its own regression, their spread is the error of the estimate, whether or not lesions of
one seed are alike.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrow.calibration.coordinates import Coordinates
from jaxgrow.calibration.evaluations import Growths, Values
from jaxgrow.calibration.spec import Task


RIDGE = 0.03
"""μ, the weight of the frozen derivatives, in squared unconstrained coordinates."""

SLOPES = 4
"""Seeds whose derivatives are averaged, at most; they differ less than the metrics."""


class Evaluation(NamedTuple):
    """Evaluation of the loss at a point.

    Attributes:
        u: unconstrained coordinates of the parameters.
        values: the parameters.
        loss: of the lesions of this point alone; infinite if a growth failed.
        metrics: of every seed; None if a growth failed.
        failure: the seed and the result of that growth, in words; None if none failed.
    """

    u: Float[np.ndarray, " p"]
    values: Values
    loss: float
    metrics: Float[np.ndarray, "s t"] | None
    failure: str | None


class Estimate(NamedTuple):
    """Residuals and sensitivities at a point, estimated by all evaluations.

    Attributes:
        residuals: (metric - target) / uncertainty, for every seed.
        jacobians: their sensitivities, in the unconstrained coordinates.
        informed: whether evaluations determine the sensitivities better than the frozen
            ones do, in every direction.
    """

    residuals: Float[np.ndarray, "s t"]
    jacobians: Float[np.ndarray, "s t p"]
    informed: bool

    @property
    def residual(self) -> Float[np.ndarray, " t"]:
        """Residual of the mean over the seeds."""
        return self.residuals.mean(axis=0)

    @property
    def jacobian(self) -> Float[np.ndarray, "t p"]:
        """Jacobian of the mean over the seeds."""
        return self.jacobians.mean(axis=0)

    @property
    def loss(self) -> float:
        """Loss of the mean over the seeds."""
        return float(np.sum(self.residual**2) / 2)

    @property
    def gradient(self) -> Float[np.ndarray, " p"]:
        """Gradient of the loss."""
        return self.jacobian.T @ self.residual

    @property
    def curvature(self) -> Float[np.ndarray, "p p"]:
        """Gauss-Newton curvature JᵀJ."""
        return self.jacobian.T @ self.jacobian

    @property
    def information(self) -> Float[np.ndarray, "p p"]:
        """JᵀJ less what the error of J is expected to add to it; not negative."""
        expected = sum(_error(rows) for rows in self.jacobians.transpose(1, 0, 2))
        values, vectors = np.linalg.eigh(self.curvature - expected)
        return (vectors * np.maximum(values, 0)) @ vectors.T

    @property
    def residual_error(self) -> Float[np.ndarray, "t t"]:
        """Covariance of the mean residual; 0 (unknown) for one seed."""
        return _error(self.residuals)

    @property
    def gradient_error(self) -> Float[np.ndarray, "p p"]:
        """Covariance of the gradient that comes from the sensitivities' error."""
        return _error(np.einsum("stp,t->sp", self.jacobians, self.residual))

    @property
    def compatible(self) -> bool:
        """Whether every target is within its uncertainty and two standard errors."""
        error = np.sqrt(np.diag(self.residual_error))
        return bool(np.all(np.abs(self.residual) <= 1 + 2 * error))

    @property
    def reached(self) -> bool:
        """Whether every target is within its uncertainty."""
        return bool(np.all(np.abs(self.residual) <= 1))


def _error(rows: Float[np.ndarray, "s k"]) -> Float[np.ndarray, "k k"]:
    """Compute the covariance of the mean of rows; 0 for one row."""
    seeds, number = rows.shape
    if seeds == 1:
        return np.zeros((number, number))
    return np.cov(rows, rowvar=False).reshape(number, number) / seeds


class Loss:
    """Loss of a task.

    Args:
        task: the targets.
        coordinates: of its parameters.
        growths: source of the growths.

    Attributes:
        grown: all evaluations whose growths succeeded.
    """

    def __init__(self, task: Task, coordinates: Coordinates, growths: Growths) -> None:
        self.coordinates = coordinates
        self._growths, self._seeds = growths, task.fit.seeds
        self.grown: list[Evaluation] = []
        self.target = np.array([t.value for t in task.targets.values()], float)
        self.uncertainty = np.array(
            [t.uncertainty for t in task.targets.values()], float
        )

    def __call__(self, u: Float[np.ndarray, " p"]) -> Evaluation:
        """Grow every seed; the first failed growth makes the loss infinite."""
        values = tuple(self.coordinates.parameters(jnp.asarray(u)).tolist())
        metrics = list[Sequence[float]]()
        for seed in self._seeds:
            measured = self._growths.measure(seed, values)
            if not measured.success:
                failure = f"seed {seed} ended with {measured.result}"
                return Evaluation(u, values, math.inf, None, failure)
            metrics.append(measured.metrics)
        rows = np.array(metrics, float)
        loss = float(np.sum(self._residuals(rows).mean(axis=0) ** 2) / 2)
        found = Evaluation(u, values, loss, rows, None)
        self.grown.append(found)
        return found

    def frozen(self, at: Evaluation) -> Float[np.ndarray, "t p"] | None:
        """Return mean sensitivities at frozen choices; None if none exist."""
        if at.metrics is None:
            return None
        seeds = self._seeds[:SLOPES]
        slopes = [self._growths.slopes(seed, at.values) for seed in seeds]
        found = [np.array(rows, float) for rows in slopes if rows]
        if not found:
            return None
        in_u = np.asarray(self.coordinates.slopes(jnp.asarray(at.u)))
        return np.mean(found, axis=0) * in_u / self.uncertainty[:, None]

    def estimate(
        self, u: Float[np.ndarray, " p"], frozen: Float[np.ndarray, "t p"]
    ) -> Estimate:
        """Estimate a point from all evaluations; at least one must have grown."""
        number = len(u)
        square = np.diag([0.0, *[RIDGE] * number])
        prior = np.vstack([np.zeros(len(frozen)), RIDGE * frozen.T])
        mixed = np.repeat(prior[None], len(self._seeds), axis=0)
        for other in self.grown:
            assert other.metrics is not None
            away = other.u - u
            line = np.array([1.0, *away])
            weighted = math.exp(-float(away @ away)) * line
            square += np.outer(weighted, line)
            mixed += weighted[:, None] * self._residuals(other.metrics)[:, None]
        found = np.linalg.solve(square, mixed)
        # information on the slopes with the intercept eliminated
        told = square[1:, 1:] - np.outer(square[0, 1:], square[0, 1:]) / square[0, 0]
        told = told - RIDGE * np.eye(number)
        informed = float(np.linalg.eigvalsh(told)[0]) > RIDGE
        return Estimate(found[:, 0], found[:, 1:].transpose(0, 2, 1), informed)

    def _residuals(self, metrics: Float[np.ndarray, "s t"]) -> Float[np.ndarray, "s t"]:
        return (metrics - self.target) / self.uncertainty
