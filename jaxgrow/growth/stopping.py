"""Stopping criteria of a growth: its size, a bound, or a full cavity."""

from collections.abc import Sequence
from dataclasses import dataclass

from jaxgrow.growth.history import StepRecord
from jaxgrow.lesions.lesion import Lesion
from jaxgrow.runtime.results import Result


STAGNATION = 60
"""Number of divisions against a wall (or a quarter of all, if that is more) without an
enlargement of the lesion after which its cavity is full; half as many if no equilibrium
is found any more."""

ENLARGING = 1.02
"""Factor of the lesion's diameter above which it counts as enlarged."""


@dataclass(frozen=True)
class GrowthLimits:
    """Bounds of a growth whose lesion does not reach its size.

    Attributes:
        divisions: largest number.
        seconds: largest number; None for no bound.
    """

    divisions: int
    seconds: float | None = None


@dataclass(frozen=True, eq=False)
class Stopping:
    """Quantities that the stopping criteria use.

    Attributes:
        share: share of the request that is reached.
        divisions: number made so far.
        history: of the steps so far.
        bounds: of divisions and time.
        seconds: since the start.
    """

    share: float
    divisions: int
    history: Sequence[StepRecord]
    bounds: GrowthLimits
    seconds: float = 0.0


def stop_reason(lesion: Lesion, now: Stopping) -> Result:
    """Return the stopping criterion that is met; CONVERGED if there is none."""
    bounds = now.bounds
    if now.share >= 1:
        return Result.REACHED
    if now.divisions >= bounds.divisions:
        return Result.DIVISION_LIMIT
    window = max(STAGNATION, now.divisions // 4)
    if lesion.target_mm is not None and stagnates(now.history, window):
        return Result.CAVITY_FULL
    if bounds.seconds is not None and now.seconds > bounds.seconds:
        return Result.TIME_LIMIT
    return Result.CONVERGED


def stagnates(history: Sequence[StepRecord], window: int) -> bool:
    """Return whether growth stagnates against a wall.

    It does if all recent steps had collisions and the share of the request that is
    reached rose by a factor of `ENLARGING` at most. A quarter more particles enlarge a
    free lesion by 7 % in diameter at least.

    Args:
        history: of the steps so far.
        window: number of recent divisions.
    """
    former = history[-1].division - window if history else 0
    before = [record for record in history if record.division <= former]
    if not before:
        return False
    recent = history[len(before) :]
    old, new = (max(record.share for record in some) for some in (before, recent))
    stuck = new <= ENLARGING * old
    return stuck and all(record.colliding for record in recent)
