"""Step of a growth, in the phases and the order of the paper's §4."""

from dataclasses import dataclass, replace

from jaxgrow.energy.parameters import Parameters
from jaxgrow.growth.boundary import (
    boundary_reaction,
    BoundaryCheck,
    check_reaction,
    find_escaped,
)
from jaxgrow.growth.choices import Choices
from jaxgrow.growth.events import Event
from jaxgrow.growth.settling import FairingResult
from jaxgrow.growth.setup import GrowthState, Setup
from jaxgrow.lesions.division import Division, with_room
from jaxgrow.lesions.lesion import Lesion
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.timer import Clock
from jaxgrow.state import State
from jaxgrow.transfer.device import get_number, get_surface


@dataclass(frozen=True, eq=False)
class StepResult:
    """Outcome of `grow_step`.

    Attributes:
        now: after it; before it, if the result is not CONVERGED.
        result: CONVERGED, or why there is no valid state.
        event: the discrete choices, also of a step that failed; None if there is no
            room for a division.
        settled: the equilibrium and the fairing; None if there is no event.
        check: of the patch's boundary; None if it was not checked.
    """

    now: GrowthState
    result: Result
    event: Event | None = None
    settled: FairingResult | None = None
    check: BoundaryCheck | None = None


def grow_step(
    setup: Setup, now: GrowthState, choices: Choices, clock: Clock, count: int
) -> StepResult:
    """Divide particles, adapt tissue and surface, fair it, reset its springs.

    These are phases 1 to 4 of the paper's §4. After a failure the state before the step
    is returned.

    Args:
        setup: of the growth.
        now: its state.
        choices: drawn or recorded.
        clock: counts the seconds.
        count: number of divisions; fewer are made if there are fewer particles to
            divide, or no room for so many.
    """
    with clock.phase("divide"):
        foci = choices.foci(setup, now)
        if foci:
            given = now.state, foci, now.stage, setup.parameters
            marked = setup.lesion.place_foci(*given)
            now = replace(now, state=marked, stage=now.stage + 1)
        divisions = choices.divisions(setup, now, count)
        if divisions is None:
            return StepResult(now, Result.ON_MEMBRANE)
        divided = divide(setup.lesion, now.state, divisions, setup.parameters)
    settled = choices.settle(setup, replace(now, state=divided), clock)
    event = Event(divisions, settled.record, foci=foci)
    result, check = settled.result, None
    if result is Result.CONVERGED and choices.checks_boundary and now.border:
        check = check_boundary(setup, now, settled)
        if check.crossed:
            result = Result.PATCH_TOO_SMALL
    after = settled.now if result is Result.CONVERGED else now
    return StepResult(after, result, event, settled, check)


def divide(
    lesion: Lesion,
    state: State,
    divisions: tuple[Division, ...],
    parameters: Parameters,
) -> State:
    """Divide the particles that have been chosen.

    This is phase 1 of the paper's §4.

    Args:
        lesion: with the rule of the division.
        state: an equilibrium.
        divisions: in their order.
        parameters: of the mechanics.
    """
    for division in divisions:
        particles = with_room(state.particles)
        roomy = State(particles, state.membrane, state.frame)
        state = lesion.divide(roomy, division, parameters)
    return state


def check_boundary(
    setup: Setup, now: GrowthState, settled: FairingResult
) -> BoundaryCheck:
    """Check the reaction on the patch's boundary at an equilibrium.

    Args:
        setup: of the growth.
        now: before the step, with the boundary before growth.
        settled: the equilibrium.
    """
    state = settled.found.state
    assert state.membrane is not None
    assert now.border is not None
    assert now.walls is not None
    reach = get_number(setup.parameters.contact_range)
    surface = get_surface(state.membrane)
    beside = find_escaped(state.particles, surface, now.walls, reach)
    border = boundary_reaction(settled.found.relaxation)
    return check_reaction(border, now.border, state.particles, beside)
