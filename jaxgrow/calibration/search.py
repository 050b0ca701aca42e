r"""Search by gradient steps of an optimiser, then by a simplex method.

1. The optimiser (any of optax) proposes a step from the gradient at the best point. It
   is that of the growths there, until other evaluations determine it better.
2. The lesions are grown there. Only if the loss falls, as estimated from all lesions
   grown so far (`jaxgrow.calibration.loss.Estimate`), the step is accepted; else the
   next is half as long. The derivative is that of a growth with frozen choices (see
   `jaxgrow.grow`), so a step need not be an improvement; a refused point corrects it.
3. If `REFUSALS` steps in a row are refused, or the derivative does not exist, or it
   seems to vanish where a target is clearly missed, but is too uncertain to conclude
   that, Nelder and Mead's simplex (SciPy) continues from the best point. From a start
   whose growths fail it searches for a point at which they succeed; gradients take over
   there.

It ends when a step promises less than `GAIN`, or is shorter than a quarter of its
uncertainty by the scatter over the seeds; when the simplex has shrunk; or when the
evaluations are used up. The fit is the point where the estimated loss is least.
"""

import contextlib
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

from jaxgrow.calibration.evaluations import Values
from jaxgrow.calibration.loss import Estimate, Evaluation, Loss


REFUSALS = 6
"""Largest number of refused steps in a row."""

GAIN = 1e-3
"""Loss that a further step must promise; the loss is 1/2 at one standard deviation."""

SETTLED = 1 / 16
"""The same, as a share of the apparent gain by the scatter over the seeds: a step is
then a quarter as long as it is uncertain."""

KNOWN = 0.1
"""Largest apparent gain by the gradient's own error, as a share of the loss, with which
a target counts as unreachable by any step: sensitivities of three deviations."""

LONGEST = 1.0
"""Longest step, in unconstrained coordinates."""

DAMPING = 0.05
"""Levenberg and Marquardt's λ, added to the Gauss-Newton curvature."""

SIDE = 0.4
"""Sides of the first simplex, in unconstrained coordinates."""

SIDE_FROM_FAILURE = 2.0
"""The same, from a start whose growths fail."""

SHRUNK = 0.02
"""Sides of a simplex at which the search ends."""

FURTHEST = 6.0
"""Largest coordinate: a quarter of a per cent before the bound."""

_WORST = 1e300  # for infinity: SciPy takes differences
_DIGITS = 6  # of coordinates, so that points to which a simplex returns are the same


class Tried(NamedTuple):
    """Evaluated point of the search, for its history.

    Attributes:
        number: of the evaluation, from 0.
        how: "start", "gradient" or "derivative-free".
        accepted: whether the search continued from it: the loss, as estimated from all
            lesions grown so far, is less than before ("derivative-free": its own loss).
        loss: of the lesions of this point alone; infinite if a growth failed.
        values: the parameters.
        metrics: means over the seeds, in the order of the targets; None if a growth
            failed.
        failure: the failed growth and its result; None if none failed.
    """

    number: int
    how: str
    accepted: bool
    loss: float
    values: Values
    metrics: tuple[float, ...] | None
    failure: str | None


class End(enum.Enum):
    """End of a search; the value is the sentence that a user reads."""

    CONVERGED = "No step along the gradient promises a noticeably smaller loss."
    SHRUNK = "The derivative-free search has narrowed down to one point."
    EXHAUSTED = "The allowed number of evaluations was used up."


class Search(NamedTuple):
    """Outcome of a search.

    Attributes:
        best: the point with the least estimated loss; the start if nothing grew.
        estimate: at this point, from all lesions; None if nothing grew.
        end: why it ended.
        history: all points, in their order.
    """

    best: Evaluation
    estimate: Estimate | None
    end: End
    history: tuple[Tried, ...]


class _Exhausted(Exception):  # noqa: N818  (ends a search, not an error)
    pass


class _Grown(Exception):  # noqa: N818  (ends a simplex, not an error)
    pass


def gauss_newton(
    damping: float = DAMPING, longest: float = LONGEST
) -> optax.GradientTransformationExtraArgs:
    r"""Make the default optimiser: :math:`-(J^T J + \lambda)^{-1} g`, clipped.

    Args:
        damping: :math:`\lambda`.
        longest: length of a step.
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
        preconditioned, optax.clip_by_global_norm(longest), optax.scale(-1.0)
    )


class _Trail:
    """Evaluations in their order, within the allowed number.

    Attributes:
        history: all of them.
        best: the one with the least loss of its own, or the start.
        frozen: the sensitivities that were computed last; 0 before.
    """

    def __init__(
        self, loss: Loss, evaluations: int, progress: Callable[[Tried], None] | None
    ) -> None:
        self.loss, self._allowed, self._progress = loss, evaluations, progress
        self._known: dict[bytes, Evaluation] = {}
        self.history: list[Tried] = []
        self.best: Evaluation | None = None
        self.frozen = np.zeros((len(loss.target), len(loss.coordinates.low)))

    def evaluate(
        self, u: Float[np.ndarray, " p"], how: str, at: Evaluation | None = None
    ) -> tuple[Evaluation, bool]:
        """Evaluate the loss at a point; known points are not counted again.

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
        self._tell(found, how, accepted=accepted)
        return found, accepted

    def estimate(self, at: Evaluation) -> Estimate:
        """Estimate a point that grew from all evaluations."""
        return self.loss.estimate(at.u, self.frozen)

    def learn_slopes(self, at: Evaluation) -> bool:
        """Compute the sensitivities of a point's growths, if they exist.

        The result is whether they do.
        """
        frozen = self.loss.frozen(at)
        if frozen is not None:
            self.frozen = frozen
        return frozen is not None

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
    """Minimise the loss.

    Args:
        loss: to be minimised.
        start: unconstrained coordinates.
        evaluations: largest number, not counting derivatives.
        optimiser: proposes steps; `gauss_newton` if None. An optimiser that takes
            extra arguments is given `curvature`.
        progress: called after every evaluation.
    """
    trail = _Trail(loss, evaluations, progress)
    at, _ = trail.evaluate(start, "start")
    try:
        if at.metrics is None:
            at = _grown(trail, at)
        end: End | None = End.SHRUNK
        if at.metrics is not None:
            end = _along_gradients(trail, at, optimiser or gauss_newton())
        if end is None:
            end = _without_derivatives(trail)
    except _Exhausted:
        end = End.EXHAUSTED
    if not loss.grown:
        return Search(at, None, end, tuple(trail.history))
    best = min(loss.grown, key=lambda point: trail.estimate(point).loss)
    if not trail.estimate(best).informed:
        trail.learn_slopes(best)
    return Search(best, trail.estimate(best), end, tuple(trail.history))


def _along_gradients(
    trail: _Trail, at: Evaluation, optimiser: optax.GradientTransformation
) -> End | None:
    """Step along gradients until no gain is left; None if they fail."""
    extended = optax.with_extra_args_support(optimiser)
    state, share, refused = extended.init(jnp.asarray(at.u)), 1.0, 0
    while refused < REFUSALS:
        here = trail.estimate(at)
        if not here.informed:
            if not trail.learn_slopes(at):
                return None
            here = trail.estimate(at)
        if _is_settled(here):
            return End.CONVERGED if here.compatible or _is_known(here) else None
        update, proposed = extended.update(
            jnp.asarray(here.gradient),
            state,
            jnp.asarray(at.u),
            curvature=jnp.asarray(here.curvature),
        )
        step = share * np.asarray(jax.tree.leaves(update)[0])
        found, accepted = trail.evaluate(at.u + step, "gradient", at)
        if accepted:
            # a step that was too long is likely to be so again
            at, state, share, refused = found, proposed, min(1.0, 2 * share), 0
        else:
            share, refused = share / 2, refused + 1
    return None


def _is_settled(here: Estimate) -> bool:
    """Return whether a Gauss-Newton step promises no gain above the scatter.

    In the linear case, it would lower the loss by gᵀH⁻¹g/2; the error S of the
    residuals alone gives an apparent gain of tr(H⁻¹ Jᵀ S J)/2.
    """
    promised = _promised(here, np.outer(here.gradient, here.gradient))
    scatter = here.jacobian.T @ here.residual_error @ here.jacobian
    return promised < max(GAIN, SETTLED * _promised(here, scatter))


def _is_known(here: Estimate) -> bool:
    """Return whether the gradient is certain enough to rule out any gain."""
    one_seed = len(here.residuals) == 1
    error = _promised(here, here.gradient_error)
    return here.informed and not one_seed and error < KNOWN * here.loss


def _promised(here: Estimate, square: Float[np.ndarray, "p p"]) -> float:
    """Return tr(H⁻¹ G)/2, the expected gain along gradients with ⟨g gᵀ⟩ = G."""
    damped = here.curvature + DAMPING * np.eye(len(square))
    return float(np.trace(np.linalg.solve(damped, square)) / 2)


def _grown(trail: _Trail, at: Evaluation) -> Evaluation:
    """Search for a point whose growths succeed around one where they fail.

    If there is none, the given one is returned.
    """

    def value(u: Float[np.ndarray, " p"]) -> float:
        if trail.evaluate(u, "derivative-free")[0].metrics is not None:
            raise _Grown
        return _WORST

    with contextlib.suppress(_Grown):
        _simplex(value, at.u, SIDE_FROM_FAILURE)
    assert trail.best is not None
    return trail.best


def _without_derivatives(trail: _Trail) -> End:
    """Run Nelder and Mead's simplex from the best point."""
    assert trail.best is not None

    def value(u: Float[np.ndarray, " p"]) -> float:
        return min(trail.evaluate(u, "derivative-free")[0].loss, _WORST)

    _simplex(value, trail.best.u, SIDE)
    return End.SHRUNK


def _simplex(
    value: Callable[[Float[np.ndarray, " p"]], float],
    start: Float[np.ndarray, " p"],
    side: float,
) -> None:
    """Run Nelder and Mead's method, until the simplex has shrunk."""
    # towards the middle of the bounds, where there is more room
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
