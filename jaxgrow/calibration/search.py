r"""The search: an optimiser's steps along gradients, then a derivative-free method.

1. The optimiser (any of optax) proposes a step from the gradient at the best point.
2. The lesions are grown anew there. Only if the loss falls the step is accepted; else
   it is halved, up to `HALVINGS` times. The derivative is that of a growth with frozen
   choices (see `jaxgrow.grow`), so it may well propose what is no improvement. What
   the refused points show corrects it (`jaxgrow.calibration.loss`), for another step.
3. If `STEPS` such steps in turn are refused, or the derivative does not exist, or it
   vanishes where a target is not reached, or the start cannot be grown, Nelder and
   Mead's simplex (SciPy) goes on from the best point.

It ends when all targets are reached and a Gauss-Newton step promises less than `GAIN`,
when the simplex has shrunk, or when the evaluations are used up.
"""

import enum
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Float
from scipy.optimize import minimize

from jaxgrow.calibration.growths import Values
from jaxgrow.calibration.loss import Evaluation, Loss, Slope


HALVINGS = 2
"""How often a step that does not lower the loss is halved."""

STEPS = 2
"""Steps from one point that may be refused, with all their halves."""

GAIN = 1e-3
"""Loss that a further step must promise; the loss is 1/2 at one standard deviation."""

LARGEST = 1.0
"""Length of a step, in unconstrained coordinates."""

DAMPING = 0.05
"""Added to the Gauss-Newton curvature: a twentieth of a target's whole uncertainty."""

SIMPLEX = 0.4
"""Sides of the first simplex, in unconstrained coordinates."""

FAR = 2.0
"""The same, from a start that does not grow."""

SHRUNK = 0.02
"""Sides of a simplex at which the search ends."""

FURTHEST = 6.0
"""Coordinate that is not passed: a quarter of a per cent before the bound."""

_WORST = 1e300  # for infinity: SciPy takes differences
_DIGITS = 6  # of coordinates, so that points that a simplex comes back to are the same


class Tried(NamedTuple):
    """One point of the search, for its history.

    Attributes:
        number: of the evaluation, from 0.
        how: "start", "gradient" or "derivative-free".
        accepted: whether it was better than all before.
        loss: infinite if a growth failed.
        values: the parameters.
        metrics: means over the seeds, in the order of the targets; None if a growth
            failed.
        failure: which growth, and how; None if none did.
    """

    number: int
    how: str
    accepted: bool
    loss: float
    values: Values
    metrics: tuple[float, ...] | None
    failure: str | None


class End(enum.Enum):
    """Why a search ended; the value is the sentence that a user reads."""

    CONVERGED = "No step along the gradient promises a noticeably smaller loss."
    SHRUNK = "The derivative-free search has narrowed down to one point."
    EXHAUSTED = "The allowed number of evaluations was used up."


class Search(NamedTuple):
    """What a search found.

    Attributes:
        best: the point with the least loss.
        end: why it ended.
        history: all points, in their order.
    """

    best: Evaluation
    end: End
    history: tuple[Tried, ...]


class _Exhausted(Exception):  # noqa: N818  (it ends a search, it is no error)
    pass


def gauss_newton(
    damping: float = DAMPING, largest: float = LARGEST
) -> optax.GradientTransformationExtraArgs:
    r"""The default optimiser: :math:`-(J^T J + \lambda)^{-1} g`, of bounded length.

    Args:
        damping: :math:`\lambda`.
        largest: length of a step.
    """

    def init(params: Any) -> optax.EmptyState:  # noqa: ARG001  (optax's names)
        return optax.EmptyState()

    def update(
        updates: Any,
        state: Any,
        params: Any = None,  # noqa: ARG001
        **extra: Any,
    ) -> tuple[Any, Any]:
        damped = extra["curvature"] + damping * jnp.eye(len(updates))
        return jnp.linalg.solve(damped, updates), state

    preconditioned = optax.GradientTransformationExtraArgs(init, update)
    return optax.chain(
        preconditioned, optax.clip_by_global_norm(largest), optax.scale(-1.0)
    )


class _Trail:
    """Evaluations in their order, within the allowed number."""

    def __init__(
        self, loss: Loss, evaluations: int, progress: Callable[[Tried], None] | None
    ) -> None:
        self._loss, self._allowed, self._progress = loss, evaluations, progress
        self._known: dict[bytes, Evaluation] = {}
        self.history: list[Tried] = []
        self.best: Evaluation | None = None

    def evaluate(self, u: Float[np.ndarray, " p"], how: str) -> Evaluation:
        """The loss at a point, which counts unless it was there before."""
        u = np.clip(np.round(u, _DIGITS), -FURTHEST, FURTHEST)
        if u.tobytes() in self._known:
            return self._known[u.tobytes()]
        if len(self.history) == self._allowed:
            raise _Exhausted
        found = self._known[u.tobytes()] = self._loss(u)
        better = self.best is None or found.loss < self.best.loss
        if better:
            self.best = found
        metrics = None
        if found.metrics is not None:
            metrics = tuple(found.metrics.mean(axis=0).tolist())
        tried = Tried(
            len(self.history),
            how,
            better and math.isfinite(found.loss),
            found.loss,
            found.values,
            metrics,
            found.failure,
        )
        self.history.append(tried)
        if self._progress is not None:
            self._progress(tried)
        return found


def search(
    loss: Loss,
    start: Float[np.ndarray, " p"],
    *,
    evaluations: int,
    optimiser: optax.GradientTransformation | None = None,
    progress: Callable[[Tried], None] | None = None,
) -> Search:
    """Look for the least loss.

    Args:
        loss: to be made small.
        start: unconstrained coordinates.
        evaluations: at most; the derivatives of an accepted point come on top.
        optimiser: proposes steps; `gauss_newton` if None. An optimiser that takes
            extra arguments is given `curvature`.
        progress: called after every evaluation.
    """
    trail = _Trail(loss, evaluations, progress)
    at = trail.evaluate(start, "start")
    try:
        end = _along_gradients(loss, trail, at, optimiser or gauss_newton())
        if end is None:
            end = _without_derivatives(trail)
    except _Exhausted:
        end = End.EXHAUSTED
    assert trail.best is not None
    return Search(trail.best, end, tuple(trail.history))


def _along_gradients(
    loss: Loss, trail: _Trail, at: Evaluation, optimiser: optax.GradientTransformation
) -> End | None:
    """The end if there is nothing left to gain; None if the gradients fail."""
    extended = optax.with_extra_args_support(optimiser)
    state, share, refused = extended.init(jnp.asarray(at.u)), 1.0, 0
    while refused < STEPS:
        slope = loss.slope(at)
        if slope is None:
            return None
        if promised(slope) < GAIN:
            return End.CONVERGED if loss.is_reached(at) else None
        update, proposed = extended.update(
            jnp.asarray(slope.gradient),
            state,
            jnp.asarray(at.u),
            curvature=jnp.asarray(slope.curvature),
        )
        step = np.asarray(jax.tree.leaves(update)[0])
        for _ in range(HALVINGS + 1):
            found = trail.evaluate(at.u + share * step, "gradient")
            if found.loss < at.loss:
                # what was too far this time is likely to be so again
                at, state, share, refused = found, proposed, min(1.0, 2 * share), 0
                break
            share /= 2
        else:
            share, refused = 1.0, refused + 1
    return None


def promised(slope: Slope) -> float:
    """By how much a damped Gauss-Newton step would lower the loss, were it linear."""
    damped = slope.curvature + DAMPING * np.eye(len(slope.gradient))
    return float(slope.gradient @ np.linalg.solve(damped, slope.gradient) / 2)


def _without_derivatives(trail: _Trail) -> End:
    """Nelder and Mead's simplex around the best point."""
    assert trail.best is not None
    start = trail.best.u

    def value(u: Float[np.ndarray, " p"]) -> float:
        return min(trail.evaluate(u, "derivative-free").loss, _WORST)

    # towards the middle of the bounds, where there is more room
    side = SIMPLEX if math.isfinite(trail.best.loss) else FAR
    sides = np.diag(np.where(start > 0, -side, side))
    minimize(
        value,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": np.vstack([start, start + sides]),
            "xatol": SHRUNK,
            "fatol": math.inf,
            "maxfev": 10**6,
            "maxiter": 10**6,
        },
    )
    return End.SHRUNK
