"""Growth loop: steps until the growth ends (paper §4)."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from jaxgrow.growth.choices import Choices
from jaxgrow.growth.history import make_record, StepRecord
from jaxgrow.growth.progress import make_progress, Progress
from jaxgrow.growth.setup import GrowthState, Setup
from jaxgrow.growth.step import grow_step, StepResult
from jaxgrow.growth.stopping import GrowthLimits, last_result, Stopping
from jaxgrow.runtime.compilations import forget_now_and_then
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.timer import Clock
from jaxgrow.runtime.types import Scalar


REDRAWS = 3
"""Largest number of times that a step without a valid equilibrium is made again."""

REDRAWN = frozenset(
    {Result.STEP_LIMIT, Result.NON_FINITE, Result.EVAPORATED, Result.INTERSECTION}
)
"""Results of a step after which it is made again, of fewer or of other divisions."""

Watch = Callable[[Progress], object]
"""Called after every step; True ends the growth."""


@dataclass(frozen=True, eq=False)
class Reached:
    """State of a growth between two steps, with its history.

    Attributes:
        now: the last equilibrium.
        result: CONVERGED if it may continue; else why it ended.
        history: of its steps.
        divisions: number made so far.
    """

    now: GrowthState
    result: Result
    history: tuple[StepRecord, ...] = ()
    divisions: int = 0


def start_growth(setup: Setup, choices: Choices, clock: Clock) -> Reached:
    """Make the initial state, on a patch that is large enough.

    Args:
        setup: of the growth.
        choices: drawn or recorded.
        clock: counts the seconds.
    """
    with clock.phase("plant"):
        start = choices.start(setup)
    now = start.growth_state()
    if start.outcome is not None and start.outcome.result is not Result.CONVERGED:
        return Reached(now, start.outcome.result)
    wider = choices.enlarge(setup, now, None, (), clock)
    return Reached(now, Result.CONVERGED) if wider is None else Reached(*wider[:2])


def run_loop(
    setup: Setup,
    reached: Reached,
    choices: Choices,
    bounds: GrowthLimits,
    clock: Clock,
    watch: Watch | None,
) -> Reached:
    """Make steps until the growth ends.

    Args:
        setup: of the growth.
        reached: its state; it continues if its result is CONVERGED.
        choices: drawn or recorded.
        bounds: of divisions and time.
        clock: counts the seconds.
        watch: called after every step; it may end the growth.
    """
    size = measure(setup, reached.now, clock)
    share = setup.lesion.share_reached(reached.now.state, size, reached.divisions)
    choices.mark()
    try:
        while reached.result is Result.CONVERGED:
            forget_now_and_then(len(reached.history))
            made = (reached.divisions, reached.history)
            stopping = Stopping(share, *made, bounds, clock.elapsed)
            result = choices.stop(setup, stopping)
            if result is not Result.CONVERGED:
                return replace(reached, result=result)
            after, record = _next(setup, reached, choices, bounds, clock)
            choices.mark()
            reached = after
            if record is None:
                return reached
            share = record.share
            if watch is not None:
                told = make_progress(setup.scene, reached.now.state, record, clock)
                if watch(told) is True and reached.result is Result.CONVERGED:
                    return replace(reached, result=Result.STOPPED)
    except KeyboardInterrupt:
        choices.rewind()
        return replace(reached, result=Result.INTERRUPTED)
    return reached


def _next(
    setup: Setup, reached: Reached, choices: Choices, bounds: GrowthLimits, clock: Clock
) -> tuple[Reached, StepRecord | None]:
    """Make one step; its record is None if there is no room for a division."""
    lesion, history = setup.lesion, reached.history
    left = min(lesion.divisions or bounds.divisions, bounds.divisions)
    count = min(lesion.divisions_per_step, left - reached.divisions)
    step, redrawn = _make_step(setup, reached, choices, clock, count, bounds)
    now, result, mended = step.now, step.result, dict[str, int]()
    if redrawn:
        mended["step_redrawn"] = redrawn
    if step.event is None or step.settled is None:
        return replace(reached, result=result), None
    number = reached.divisions + len(step.event.divisions)
    kept = reached.divisions
    if result is Result.CONVERGED:
        choices.keep(step.event)
        kept = number
    size = measure(setup, now, clock)
    result = choices.after_failure(result, history)
    if step.event.redirected:
        mended["daughter_redirected"] = 1
    if result is Result.CONVERGED or (step.check is not None and step.check.crossed):
        wider = choices.enlarge(setup, now, step.check, history, clock)
        if wider is not None:
            now, result, times = wider
            mended |= {"patch_enlarged": times} if times else {}
    share = lesion.share_reached(now.state, size, kept)
    if choices.draws:
        result = last_result(lesion, result, share)
    record = make_record(
        now.state,
        step.settled,
        step.check,
        division=number,
        size_mm=size,
        share=share,
        result=step.result.name,
        mended=mended,
        seconds=clock.lap(),
    )
    return Reached(now, result, (*history, record), kept), record


def _make_step(
    setup: Setup,
    reached: Reached,
    choices: Choices,
    clock: Clock,
    count: int,
    bounds: GrowthLimits,
) -> tuple[StepResult, int]:
    """Make a step; after a failure again, with half as many divisions.

    Returns:
        The step, and how often it was made again.
    """
    step, redrawn = grow_step(setup, reached.now, choices, clock, count), 0
    while choices.draws and step.result in REDRAWN and redrawn < REDRAWS:
        if bounds.seconds is not None and clock.elapsed > bounds.seconds:
            break
        if choices.after_failure(step.result, reached.history) is not step.result:
            break  # the cavity is full
        count, redrawn = max(1, count // 2), redrawn + 1
        step = grow_step(setup, reached.now, choices, clock, count)
    return step, redrawn


def measure(setup: Setup, now: GrowthState, clock: Clock) -> Scalar:
    """Measure the largest diameter of the lesion, in mm."""
    with clock.phase("measure"):
        return setup.lesion.size(now.state) * setup.scene.r0_mm
