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


NEARLY = 0.97
"""Share of the size asked for from which on a growth that cannot continue has reached
it. A step may make the lesion as much larger than asked for."""

ENDS = frozenset(
    {
        Result.STEP_LIMIT,
        Result.NON_FINITE,
        Result.EVAPORATED,
        Result.INTERSECTION,
        Result.ON_MEMBRANE,
        Result.PATCH_TOO_SMALL,
        Result.SLIVER,
        Result.CAVITY_FULL,
    }
)
"""Results after which a growth cannot continue."""


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
        return last_result(lesion, Result.CAVITY_FULL, now.share)
    if bounds.seconds is not None and now.seconds > bounds.seconds:
        return Result.TIME_LIMIT
    return Result.CONVERGED


def last_result(lesion: Lesion, result: Result, share: float) -> Result:
    """Return the result of a growth whose next step has a result.

    It is REACHED if the growth cannot continue and the last valid state has nearly the
    size asked for, or the lesion accepts that end (`Lesion.accepts`).

    Args:
        lesion: with the request.
        result: of the step.
        share: share of the request that the last valid state reaches.
    """
    nearly = lesion.target_mm is not None and share >= NEARLY
    if result in ENDS and (nearly or lesion.accepts(result)):
        return Result.REACHED
    return result


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
