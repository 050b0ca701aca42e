"""Sources of the discrete choices of a growth: drawn, or recorded.

A growth, its replay, its derivative and its continuation are the same loop
(`jaxgrow.growth.loop`); they differ in the source of the discrete choices. `Drawn`
draws them from a generator and records them; `Recorded` repeats a record.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxgrow.growth.boundary import BoundaryCheck
from jaxgrow.growth.events import Event, Events, InitialRecord
from jaxgrow.growth.history import StepRecord
from jaxgrow.growth.initial_state import (
    InitialState,
    make_free_cluster,
    make_initial_state,
    relax_layout,
)
from jaxgrow.growth.patch_enlargement import enlarge_again, enlarge_patch
from jaxgrow.growth.settling import FairingResult, settle, settle_again
from jaxgrow.growth.setup import GrowthState, Setup
from jaxgrow.growth.stopping import stagnates, STAGNATION, stop_reason, Stopping
from jaxgrow.lesions.division import Division
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.timer import Clock
from jaxgrow.transfer.device import get_positions


ENLARGEMENTS = 5
"""Largest number of enlargements of the patch for a force on its boundary, or for a
tumour near it."""


class EnlargeOutcome(NamedTuple):
    """Outcome of enlarging the patch.

    Attributes:
        now: state of the growth after it.
        result: CONVERGED, or the reason why there is no valid state.
        times: number of enlargements.
    """

    now: GrowthState
    result: Result
    times: int


@runtime_checkable
class Choices(Protocol):
    """Source of the discrete choices of a growth."""

    checks_boundary: bool
    """Whether the reaction on the patch's boundary is checked after a step."""

    draws: bool
    """Whether a step that failed may be made again, of other divisions."""

    def start(self, setup: Setup) -> InitialState:
        """Return the state that growth starts from."""
        ...

    def stop(self, setup: Setup, stopping: Stopping) -> Result:
        """Return the stopping criterion met before the next step.

        CONVERGED if there is none, and the growth continues.
        """
        ...

    def foci(self, setup: Setup, now: GrowthState) -> tuple[int, ...]:
        """Return the vertices at which foci of hyperplasia begin; mostly none."""
        ...

    def divisions(
        self, setup: Setup, now: GrowthState, count: int
    ) -> tuple[Division, ...] | None:
        """Return the divisions of the next step; None if there is no room for any."""
        ...

    def settle(self, setup: Setup, now: GrowthState, clock: Clock) -> FairingResult:
        """Find the equilibrium after a division, and fair it."""
        ...

    def after_failure(self, result: Result, history: Sequence[StepRecord]) -> Result:
        """Return the result of a growth after the result of its last step."""
        ...

    def enlarge(
        self,
        setup: Setup,
        now: GrowthState,
        check: BoundaryCheck | None,
        history: Sequence[StepRecord],
        clock: Clock,
    ) -> EnlargeOutcome | None:
        """Enlarge the patch after a step, or after the start.

        Args:
            setup: of the growth.
            now: state of the growth.
            check: of the boundary; None if it was not checked.
            history: of the steps before.
            clock: counts the seconds.

        Returns:
            The outcome; None if the patch is not enlarged.
        """
        ...

    def keep(self, event: Event) -> None:
        """Keep the choices of a step that succeeded."""
        ...

    def mark(self) -> None:
        """Store the state of the choices before a step."""
        ...

    def rewind(self) -> None:
        """Reset the choices to the mark, after an interrupted step."""
        ...

    def events(self, setup: Setup, result: Result) -> Events:
        """Return all choices."""
        ...


class Drawn:
    """Choices that are drawn from a generator, and recorded.

    Args:
        rng: the generator.
    """

    checks_boundary = True
    draws = True

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self._start = InitialRecord(None, None)
        self._steps: tuple[Event, ...] = ()
        self.mark()

    @classmethod
    def after(cls, events: Events, rng: np.random.Generator) -> "Drawn":
        """Make choices that continue recorded ones, with their generator."""
        drawn = cls(rng)
        drawn._start, drawn._steps = events.start, events.steps
        return drawn

    def start(self, setup: Setup) -> InitialState:
        """Make the state that growth starts from."""
        start = make_initial_state(setup, self.rng)
        if start.layout is not None:
            positions = get_positions(start.state.particles, start.state.membrane)
            self._start = InitialRecord(start.layout, positions)
        return start

    def stop(self, setup: Setup, stopping: Stopping) -> Result:
        """Return whether the size, a bound or a full cavity ends the growth."""
        return stop_reason(setup.lesion, stopping)

    def foci(self, setup: Setup, now: GrowthState) -> tuple[int, ...]:
        """Choose foci by the lesion's rule."""
        return setup.lesion.next_foci(now.state, now.stage, setup.parameters)

    def divisions(
        self, setup: Setup, now: GrowthState, count: int
    ) -> tuple[Division, ...] | None:
        """Select the dividing particles and their directions by the lesion's rule."""
        lesion = setup.lesion
        if now.ground is not None:
            most = lesion.most_at_once(now.ground.thickness, setup.parameters)
            count = min(count, most)
        return lesion.choose(now.state, setup.parameters, self.rng, count)

    def settle(self, setup: Setup, now: GrowthState, clock: Clock) -> FairingResult:
        """Find the equilibrium, and choose the operations of its fairing."""
        return settle(setup, now, clock)

    def after_failure(self, result: Result, history: Sequence[StepRecord]) -> Result:
        """Replace STEP_LIMIT by CAVITY_FULL if growth stagnated against a wall."""
        if result is Result.STEP_LIMIT and stagnates(history, STAGNATION // 2):
            return Result.CAVITY_FULL
        return result

    def enlarge(
        self,
        setup: Setup,
        now: GrowthState,
        check: BoundaryCheck | None,
        history: Sequence[StepRecord],
        clock: Clock,
    ) -> EnlargeOutcome | None:
        """Enlarge the patch where the lesion acts on its boundary."""
        place = self._tight_place(setup, now, check, history)
        if place is None:
            return None
        wider = enlarge_patch(setup, now, place, self.rng, clock)
        if isinstance(wider, Result):
            return EnlargeOutcome(now, wider, 0)
        after, record = wider
        if self._steps:
            *before, last = self._steps
            more = (*last.enlargements, record)
            self._steps = (*before, last._replace(enlargements=more))
        else:
            more = (*self._start.enlargements, record)
            self._start = self._start._replace(enlargements=more)
        return EnlargeOutcome(after, Result.CONVERGED, 1)

    @staticmethod
    def _tight_place(
        setup: Setup,
        now: GrowthState,
        check: BoundaryCheck | None,
        history: Sequence[StepRecord],
    ) -> Float[np.ndarray, "3"] | None:
        """Return the place at which the patch must be enlarged next, in r0.

        It must be if a particle left it. For a reaction on the boundary it is enlarged
        `ENLARGEMENTS` times at most; a reaction that remains then is that of a stiff
        surface or of a dense tissue.
        """
        if check is None or check.place is None:
            return None
        enlarged = sum("patch_enlarged" in record.mended for record in history)
        assert now.ground is not None
        bottom = now.ground.is_below(check.place)
        ignored = enlarged >= ENLARGEMENTS or (bottom and setup.lesion.pushes_off)
        return check.place if check.crossed or not ignored else None

    def keep(self, event: Event) -> None:
        """Keep the choices of a step that succeeded."""
        self._steps = (*self._steps, event)

    def mark(self) -> None:
        """Store the generator's state, and the choices kept so far."""
        self._mark = self.rng.bit_generator.state, self._start, self._steps

    def rewind(self) -> None:
        """Reset generator and choices to the mark, after an interrupted step."""
        self.rng.bit_generator.state, self._start, self._steps = self._mark

    def events(self, setup: Setup, result: Result) -> Events:
        """Return all choices."""
        return Events.of(setup, self._start, self._steps, result)


class Recorded:
    """Recorded choices of a growth, repeated.

    Args:
        events: of the growth.
    """

    checks_boundary = False
    draws = False

    def __init__(self, events: Events) -> None:
        self._events = events
        self._next = 0

    def start(self, setup: Setup) -> InitialState:
        """Relax the recorded start again."""
        layout, positions = self._events.start.layout, self._events.start.positions
        if layout is None:
            return make_free_cluster(setup.scene)
        return relax_layout(setup, layout, positions)

    def stop(self, setup: Setup, stopping: Stopping) -> Result:
        """Return CONVERGED before the last event, then the recorded result."""
        if self._next < len(self._events):
            return Result.CONVERGED
        return self._events.result

    def foci(self, setup: Setup, now: GrowthState) -> tuple[int, ...]:
        """Return the foci of the next event."""
        return self._events.steps[self._next].foci

    def divisions(
        self, setup: Setup, now: GrowthState, count: int
    ) -> tuple[Division, ...] | None:
        """Return the divisions of the next event."""
        self._next += 1
        return self._last.divisions

    @property
    def _last(self) -> Event:
        return self._events.steps[self._next - 1]

    def settle(self, setup: Setup, now: GrowthState, clock: Clock) -> FairingResult:
        """Find the recorded equilibrium again, with the recorded fairing."""
        return settle_again(setup, now, self._last.equilibrium, clock)

    def after_failure(self, result: Result, history: Sequence[StepRecord]) -> Result:
        """Return the result unchanged."""
        return result

    def enlarge(
        self,
        setup: Setup,
        now: GrowthState,
        check: BoundaryCheck | None,
        history: Sequence[StepRecord],
        clock: Clock,
    ) -> EnlargeOutcome | None:
        """Repeat the recorded enlargements."""
        last = self._last if self._next else self._events.start
        for record in last.enlargements:
            again = enlarge_again(setup, now, record, clock)
            if again.result is not Result.CONVERGED:
                return EnlargeOutcome(now, again.result, len(last.enlargements))
            now = again.now
        if not last.enlargements:
            return None
        return EnlargeOutcome(now, Result.CONVERGED, len(last.enlargements))

    def keep(self, event: Event) -> None:
        """Keep nothing, as the event is in the record."""

    def mark(self) -> None:
        """Store the number of the next event."""
        self._mark = self._next

    def rewind(self) -> None:
        """Reset the number of the next event to the mark."""
        self._next = self._mark

    def events(self, setup: Setup, result: Result) -> Events:
        """Return the events that were repeated."""
        return self._events
