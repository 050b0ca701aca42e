"""One step of a growth, in the paper's phases and order (paper §4)."""

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
        check: what the patch's border feels of the lesion; None if nobody looked.
    """

    now: GrowthState
    result: Result
    event: Event | None = None
    settled: FairingResult | None = None
    check: BoundaryCheck | None = None


def grow_step(
    setup: Setup, now: GrowthState, choices: Choices, clock: Clock, count: int
) -> StepResult:
    """Divide, adapt, fair, reset; the state before it comes back if that fails.

    Args:
        setup: of the growth.
        now: where it stands.
        choices: drawn or recorded.
        clock: counts the seconds.
        count: number of divisions; fewer are made if there are fewer particles to
            divide, or no room for so many.
    """
    with clock.phase("divide"):
        divisions = choices.divisions(setup, now, count)
        if divisions is None:
            return StepResult(now, Result.ON_MEMBRANE)
        divided = divide(setup.lesion, now.state, divisions, setup.parameters)
    settled = choices.settle(setup, replace(now, state=divided), clock)
    event = Event(divisions, settled.record)
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
    """1. Make divisions that have been chosen.

    Args:
        lesion: whose rule it is.
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
    """Find what the border of the patch feels at an equilibrium.

    Args:
        setup: of the growth.
        now: before the step, with the border before growth.
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
