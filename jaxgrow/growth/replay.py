"""Growth along the recorded choices of another one."""

from collections.abc import Callable
from typing import Any

import jax

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.methods import exact_tolerance
from jaxgrow.equilibrium.problem import ExtraTerms
from jaxgrow.equilibrium.transformations import is_differentiated
from jaxgrow.growth.events import Events
from jaxgrow.growth.history import make_progress, make_record
from jaxgrow.growth.initial_state import plant_free, plant_layout, Planted
from jaxgrow.growth.lesion import size_of
from jaxgrow.growth.result import Progress
from jaxgrow.growth.settling import Step
from jaxgrow.growth.step import first_step, repeat, widen
from jaxgrow.runtime.compilations import forget_now_and_then
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.timer import Clock
from jaxgrow.scene.scene import Scene
from jaxgrow.transfer.device import get_number


def numbers(parameters: Parameters) -> Parameters:
    """The parameters as numbers, without derivatives."""
    return jax.tree.map(get_number, parameters)


def tolerance_of_replay(
    events: Events, parameters: Parameters, tolerance: float | None
) -> float:
    """The tolerance asked for, or the recorded one; exact for other parameters.

    With the recorded parameters every recorded equilibrium is one again. With others
    a tolerance like the recorded one would find that they still are, unmoved.
    """
    wanted = events.tolerance if tolerance is None else tolerance
    same = numbers(parameters) == events.parameters
    if same and not is_differentiated(parameters):
        return wanted
    return min(wanted, exact_tolerance())


def plant_again(
    scene: Scene,
    events: Events,
    parameters: Parameters,
    tolerance: float,
    terms: ExtraTerms = (),
) -> Planted:
    """The recorded start, relaxed again.

    Raises:
        ValueError: the events are those of another scene.
    """
    kind, r0_mm = scene.lesion.kind, scene.r0_mm
    if (kind, r0_mm) != (events.lesion, events.particle_mm):
        raise ValueError(
            f"the events are those of a {events.lesion} with particles of "
            f"{events.particle_mm:g} mm, and the scene asks for a {kind} with "
            f"{r0_mm:g} mm; replay a growth in its own scene."
        )
    layout, positions = events.start.layout, events.start.positions
    if layout is None:
        return plant_free(scene)
    return plant_layout(scene, layout, parameters, tolerance, positions, terms)


def replay(
    scene: Scene,
    events: Events,
    planted: Planted,
    parameters: Parameters,
    tolerance: float,
    clock: Clock,
    progress: Callable[[Progress], None] | None,
    terms: ExtraTerms = (),
) -> tuple[Step, list[dict[str, Any]], Result]:
    """Make all recorded steps.

    Returns:
        The last equilibrium, a record of every step, and the recorded result, or why an
        equilibrium was not found.
    """
    step = first_step(planted, terms)
    history: list[dict[str, Any]] = []
    if planted.outcome is not None and planted.outcome.result is not Result.CONVERGED:
        return step, history, planted.outcome.result
    for widening in events.start.widenings:
        settled = widen(step, widening, parameters, tolerance, clock)
        if settled.result is not Result.CONVERGED:
            return step, history, settled.result
        step = settled.step
    number = 0
    for index, event in enumerate(events):
        forget_now_and_then(index)
        number += len(event.divisions)
        settled = repeat(step, event, parameters, tolerance, clock)
        with clock.phase("measure"):
            size = size_of(scene, settled.step.state) * scene.r0_mm
        record = make_record(number, size, settled.step.state, settled, clock)
        if event.widenings:
            record["mended"]["patch_enlarged"] = len(event.widenings)
        history.append(record)
        if settled.result is not Result.CONVERGED:
            return step, history, settled.result
        step = settled.step
        if progress is not None:
            progress(make_progress(scene, record, clock))
    return step, history, events.result
