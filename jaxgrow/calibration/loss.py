r"""The loss of parameters, and what is known of it to second order.

.. math:: L(p) = \frac12 \sum_t \Big(\frac{\bar m_t(p) - m_t}{\sigma_t}\Big)^2

with the mean :math:`\bar m_t` of a metric over the seeds. It is the loss of the mean,
not the mean of losses: that one is larger by the variance over seeds, and would prefer
parameters under which lesions differ less over those that give the right shape. The
seeds are the same in every evaluation, so the loss is a function of the parameters
alone: it is deterministic, piecewise smooth, and jumps where a growth chooses
otherwise.

*Sensitivities.* The derivative of a growth is that of its frozen choices, and misses
how the choices respond. The evaluations show it: with the differences
:math:`\Delta u_k, \Delta m_k` to the others, weighted by
:math:`w_k = e^{-|\Delta u_k|^2}`, the sensitivities are the solution of

.. math:: \min_J\; \sum_k w_k |\Delta m_k - J \Delta u_k|^2 + \mu |J - J_0|^2,

the change from the frozen ones, :math:`J_0`, that is least for what was seen
(Broyden's update, for several differences at once). Over small steps
(:math:`|\Delta u|^2 \ll \mu`) differences are noise, and the derivative counts.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrow.calibration.coordinates import Coordinates
from jaxgrow.calibration.growths import Growths, Values
from jaxgrow.calibration.task import Task


TRUST = 0.1
"""μ, the weight of the frozen derivatives, in squared unconstrained coordinates."""


class Evaluation(NamedTuple):
    """The loss at a point.

    Attributes:
        u: unconstrained coordinates of the parameters.
        values: the parameters.
        loss: infinite if a growth failed.
        metrics: of every seed; None if a growth failed.
        failure: the seed and the result of that growth, in words; None if none failed.
    """

    u: Float[np.ndarray, " p"]
    values: Values
    loss: float
    metrics: Float[np.ndarray, "s t"] | None
    failure: str | None


class Slope(NamedTuple):
    """Derivatives at a point, in the unconstrained coordinates.

    Attributes:
        jacobian: of the residuals (mean - target) / uncertainty, corrected by what
            other evaluations show.
        frozen: the same, as the growths' derivatives alone have it.
        gradient: of the loss.
        curvature: Gauss-Newton's, JᵀJ.
        seeds: number of seeds that have a derivative; the others are left out.
    """

    jacobian: Float[np.ndarray, "t p"]
    frozen: Float[np.ndarray, "t p"]
    gradient: Float[np.ndarray, " p"]
    curvature: Float[np.ndarray, "p p"]
    seeds: int


class Loss:
    """The loss of a task.

    Args:
        task: what is asked for.
        coordinates: of its parameters.
        growths: that it is made of.
    """

    def __init__(self, task: Task, coordinates: Coordinates, growths: Growths) -> None:
        self.coordinates = coordinates
        self._growths, self._seeds = growths, task.fit.seeds
        self._seen: list[Evaluation] = []
        self.target = np.array([t.value for t in task.targets.values()], float)
        self.uncertainty = np.array(
            [t.uncertainty for t in task.targets.values()], float
        )

    def __call__(self, u: Float[np.ndarray, " p"]) -> Evaluation:
        """Grow every seed; the first growth that fails ends it, with infinite loss."""
        values = tuple(self.coordinates.parameters(jnp.asarray(u)).tolist())
        metrics = list[Sequence[float]]()
        for seed in self._seeds:
            measured = self._growths.measure(seed, values)
            if not measured.success:
                failure = f"seed {seed} ended with {measured.result}"
                return Evaluation(u, values, math.inf, None, failure)
            metrics.append(measured.metrics)
        rows = np.array(metrics, float)
        loss = float(np.sum(self.residual(rows) ** 2) / 2)
        found = Evaluation(u, values, loss, rows, None)
        self._seen.append(found)
        return found

    def residual(self, metrics: Float[np.ndarray, "s t"]) -> Float[np.ndarray, " t"]:
        """(mean - target) / uncertainty of every target."""
        return (metrics.mean(axis=0) - self.target) / self.uncertainty

    def is_reached(self, at: Evaluation) -> bool:
        """Whether every target is within its uncertainty."""
        if at.metrics is None:
            return False
        return bool(np.all(np.abs(self.residual(at.metrics)) <= 1))

    def slope(self, at: Evaluation) -> Slope | None:
        """Derivatives at a point; None if no seed has one, or a growth failed."""
        if at.metrics is None:
            return None
        slopes = [self._growths.slopes(seed, at.values) for seed in self._seeds]
        found = [np.array(rows, float) for rows in slopes if rows]
        if not found:
            return None
        in_u = np.asarray(self.coordinates.slopes(jnp.asarray(at.u)))
        frozen = np.mean(found, axis=0) * in_u / self.uncertainty[:, None]
        jacobian = self._corrected(frozen, at)
        gradient = jacobian.T @ self.residual(at.metrics)
        return Slope(jacobian, frozen, gradient, jacobian.T @ jacobian, len(found))

    def _corrected(
        self, frozen: Float[np.ndarray, "t p"], at: Evaluation
    ) -> Float[np.ndarray, "t p"]:
        """The least change of the sensitivities for the differences that were seen."""
        assert at.metrics is not None
        square = TRUST * np.eye(len(at.u))
        mixed = TRUST * frozen
        for other in self._seen:
            assert other.metrics is not None
            du = other.u - at.u
            dm = self.residual(other.metrics) - self.residual(at.metrics)
            weight = math.exp(-float(du @ du))
            square = square + weight * np.outer(du, du)
            mixed = mixed + weight * np.outer(dm, du)
        return np.linalg.solve(square, mixed.T).T
