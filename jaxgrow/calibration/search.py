r"""The search: an optimiser's steps along gradients, then a derivative-free method.

1. The optimiser (any of optax) proposes a step from the gradient at the best point. It
   is that of the growths there, until other evaluations tell more of it.
2. The lesions are grown anew there. Only if the loss falls, as all lesions grown so far
   tell it (`jaxgrow.calibration.loss.Estimate`), the step is accepted; else the next is
   half as long. The derivative is that of a growth with frozen choices (see
   `jaxgrow.grow`), so it may well propose what is no improvement; what a refused point
   shows corrects it.
3. If `REFUSALS` steps in turn are refused, or the derivative does not exist, or it
   vanishes where a target is not reached and the evaluations do not tell why, Nelder
   and Mead's simplex (SciPy) goes on from the best point.

It ends when a step promises less than `GAIN`, or less than a quarter of what the
scatter over the seeds leaves open; when the simplex has shrunk; or when the evaluations
are used up. The fit is the point where the estimated loss is least.
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
from jaxgrow.calibration.loss import Estimate, Evaluation, Loss


REFUSALS = 6
"""Steps in turn that may be refused."""

GAIN = 1e-3
"""Loss that a further step must promise; the loss is 1/2 at one standard deviation."""

SETTLED = 1 / 16
"""The same, as a share of what the scatter over the seeds lets a step seem to promise:
a step is then half as long as it is uncertain."""

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
        accepted: whether the search went on from it: the loss, as all lesions grown
            so far tell it, is less than before ("derivative-free": its own loss is).
        loss: of the lesions of this point alone; infinite if a growth failed.
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
        best: the point with the least estimated loss; the start if nothing grew.
        estimate: of what all lesions say of it; None if nothing grew.
        end: why it ended.
        history: all points, in their order.
    """

    best: Evaluation
    estimate: Estimate | None
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
        params: Any = None,  # noqa: ARG001  (as optax calls it)
        **extra: Any,
    ) -> tuple[Any, Any]:
        damped = extra["curvature"] + damping * jnp.eye(len(updates))
        return jnp.linalg.solve(damped, updates), state

    preconditioned = optax.GradientTransformationExtraArgs(init, update)
    return optax.chain(
        preconditioned, optax.clip_by_global_norm(largest), optax.scale(-1.0)
    )


class _Trail:
    """Evaluations in their order, within the allowed number.

    Attributes:
        history: all of them.
        points: those that grew to their end.
        best: the one with the least loss of its own, or the start.
        frozen: the sensitivities that were asked for last; 0 before.
    """

    def __init__(
        self, loss: Loss, evaluations: int, progress: Callable[[Tried], None] | None
    ) -> None:
        self.loss, self._allowed, self._progress = loss, evaluations, progress
        self._known: dict[bytes, Evaluation] = {}
        self.history: list[Tried] = []
        self.points: list[Evaluation] = []
        self.best: Evaluation | None = None
        self.frozen = np.zeros((len(loss.target), len(loss.coordinates.low)))

    def evaluate(
        self, u: Float[np.ndarray, " p"], how: str, at: Evaluation | None = None
    ) -> tuple[Evaluation, bool]:
        """The loss at a point, which counts unless it was there before.

        Args:
            u: the point.
            how: "start", "gradient" or "derivative-free".
            at: the point whose estimated loss must fall; if None, the loss as measured
                must be less than all before.

        Returns:
            The evaluation, and whether it is accepted.
        """
        u = np.clip(np.round(u, _DIGITS), -FURTHEST, FURTHEST)
        if u.tobytes() in self._known:
            return self._known[u.tobytes()], False
        if len(self.history) == self._allowed:
            raise _Exhausted
        found = self._known[u.tobytes()] = self.loss(u)
        least = self.best is None or found.loss < self.best.loss
        if least:
            self.best = found
        if found.metrics is None:
            accepted = False
        elif at is None:
            accepted = least
        else:
            accepted = self.estimate(found).loss < self.estimate(at).loss
        if found.metrics is not None:
            self.points.append(found)
        self._tell(found, how, accepted=accepted)
        return found, accepted

    def estimate(self, at: Evaluation) -> Estimate:
        """What all evaluations say of a point that grew."""
        return self.loss.estimate(at.u, self.frozen)

    def _tell(self, found: Evaluation, how: str, *, accepted: bool) -> None:
        metrics = None
        if found.metrics is not None:
            metrics = tuple(found.metrics.mean(axis=0).tolist())
        number = len(self.history)
        tried = Tried(
            number, how, accepted, found.loss, found.values, metrics, found.failure
        )
        self.history.append(tried)
        if self._progress is not None:
            self._progress(tried)


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
        evaluations: at most; derivatives come on top.
        optimiser: proposes steps; `gauss_newton` if None. An optimiser that takes
            extra arguments is given `curvature`.
        progress: called after every evaluation.
    """
    trail = _Trail(loss, evaluations, progress)
    at, _ = trail.evaluate(start, "start")
    try:
        end = _along_gradients(trail, at, optimiser or gauss_newton())
        if end is None:
            end = _without_derivatives(trail)
    except _Exhausted:
        end = End.EXHAUSTED
    if not trail.points:
        return Search(at, None, end, tuple(trail.history))
    best = min(trail.points, key=lambda point: trail.estimate(point).loss)
    return Search(best, trail.estimate(best), end, tuple(trail.history))


def _along_gradients(
    trail: _Trail, at: Evaluation, optimiser: optax.GradientTransformation
) -> End | None:
    """The end if there is nothing left to gain; None if the gradients fail."""
    if at.metrics is None:
        return None
    extended = optax.with_extra_args_support(optimiser)
    state, share, refused = extended.init(jnp.asarray(at.u)), 1.0, 0
    while refused < REFUSALS:
        here = trail.estimate(at)
        if not here.informed:
            frozen = trail.loss.frozen(at)
            if frozen is None:
                return None
            trail.frozen = frozen
            here = trail.estimate(at)
        if _is_settled(here):
            return End.CONVERGED if here.reached or here.informed else None
        update, proposed = extended.update(
            jnp.asarray(here.gradient),
            state,
            jnp.asarray(at.u),
            curvature=jnp.asarray(here.curvature),
        )
        step = share * np.asarray(jax.tree.leaves(update)[0])
        found, accepted = trail.evaluate(at.u + step, "gradient", at)
        if accepted:
            # what was too far this time is likely to be so again
            at, state, share, refused = found, proposed, min(1.0, 2 * share), 0
        else:
            share, refused = share / 2, refused + 1
    return None


def _is_settled(here: Estimate) -> bool:
    """Whether a Gauss-Newton step promises nothing that the seeds' scatter would show.

    Were all linear, it would lower the loss by gᵀH⁻¹g/2; the scatter of the mean over
    seeds alone lets a step seem to promise tr(H⁻¹ Jᵀ S/N J)/2.
    """
    damped = here.curvature + DAMPING * np.eye(len(here.gradient))
    promised = here.gradient @ np.linalg.solve(damped, here.gradient) / 2
    noise = here.jacobian.T @ here.scatter @ here.jacobian
    open_ = np.trace(np.linalg.solve(damped, noise)) / 2
    return bool(promised < max(GAIN, SETTLED * open_))


def _without_derivatives(trail: _Trail) -> End:
    """Nelder and Mead's simplex around the best point."""
    assert trail.best is not None
    start = trail.best.u

    def value(u: Float[np.ndarray, " p"]) -> float:
        return min(trail.evaluate(u, "derivative-free")[0].loss, _WORST)

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
