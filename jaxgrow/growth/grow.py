"""Growth: iterate until the lesion has its size, or cannot (paper §4)."""

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrow.energy.parameters import as_arrays, Parameters
from jaxgrow.equilibrium.methods import exact_tolerance
from jaxgrow.equilibrium.problem import ExtraTerms
from jaxgrow.equilibrium.transformations import (
    check_transformations,
    is_differentiated,
)
from jaxgrow.growth.events import Event, Events, Start
from jaxgrow.growth.history import add_feeling, make_progress, make_record
from jaxgrow.growth.initial_state import plant, Planted
from jaxgrow.growth.lesion import size_of
from jaxgrow.growth.replay import numbers, plant_again, replay, tolerance_of_replay
from jaxgrow.growth.result import Growth, Progress
from jaxgrow.growth.settling import Step
from jaxgrow.growth.step import enlarge_patch, first_step, is_below, iterate, Iteration
from jaxgrow.runtime.compilations import count_compilations, forget_now_and_then
from jaxgrow.runtime.descents import count_descents
from jaxgrow.runtime.forks import refuse_forked
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.timer import Clock
from jaxgrow.runtime.types import Scalar
from jaxgrow.scene.entries import check_names
from jaxgrow.scene.scene import Polyp, Scene
from jaxgrow.transfer.device import get_number, get_positions


ENLARGEMENTS = 5
"""How often the patch follows a force on its border, or a tumour that comes near it."""

STAGNATION = 60
"""Divisions against a wall (or a quarter of all) that must enlarge the lesion, or its
cavity is full; half as many if no equilibrium is found any more."""

ENLARGING = 1.02
"""Factor of its diameter that counts as an enlargement."""


def grow(
    scene: Scene,
    *,
    seed: int = 0,
    parameters: Parameters | Mapping[str, Scalar] | None = None,
    tolerance: float | None = None,
    max_divisions: int = 3000,
    max_seconds: float | None = None,
    progress: Callable[[Progress], None] | None = None,
    events: Events | None = None,
    terms: ExtraTerms = (),
) -> Growth:
    """Grow a lesion until it has the size, or the number of divisions, asked for.

    Every iteration makes the paper's steps in its order: one tumour particle divides
    (or several, see `Lesion.divisions_per_step`), tissue and surface come to
    equilibrium (here together, see `jaxgrow.relax`), the surface is faired, and its
    springs get their current length as new rest length.

    What goes wrong is mended where it can be: an equilibrium that is not found, or
    that threw particles out, is tried again from its start with shorter steps; lists
    that overflow are made larger; a fairing that fails the exact check is left out;
    sheets that meet begin to repel each other; a patch that feels the lesion is
    enlarged. `Growth.mended` counts it. Otherwise the growth ends with its name.

    *Derivatives.* `jax.grad`, `jax.jvp`, `jax.jacfwd` and `jax.jacrev` of any function
    of the state, and of `size_mm`, go through all of it, with respect to the
    parameters: `jacfwd` solves once for each of them in every equilibrium, `jacrev`
    for each result. The discrete choices (who divides, which
    edge is split, which packing an equilibrium is in) are frozen, and each equilibrium
    has its implicit derivative (`jaxgrow.relax`), for which it is relaxed to 1e-10 at
    least. `events` replays the choices of a growth: with its parameters bit for bit,
    with others as the frozen path along which the derivative is taken.

    *Gradient behaviour.* The choices do change with the parameters, so the response of
    a growth is piecewise smooth, with small pieces: lesions of 20 divisions whose
    spring stiffness differs by a quarter differ in height by 0.15 mm, while lesions
    scatter around their trend by 0.19 mm. The gradient is that of the piece, and misses
    what other choices do: averaged over 4 seeds and a decade of stiffness it is 0.2
    (sphericity) to 0.4 (height, area) times the slope of the trend. Its sign is that of
    the trend at all but 0 to 11 % of the values for one seed, and for the mean of 4 at
    all that have 4. So take its direction, averaged over seeds, and let lesions that
    are grown anew tell the length of a step, as `jaxgrow.fit` does. Figures are those
    of ``experiments/gradient_quality.py sweep``.

    Args:
        scene: what to grow, and where.
        seed: of all random choices; the same seed gives the same growth.
        parameters: of the mechanics: by name, those that differ from the scene's (so
            that a myoma keeps the others of its kind), or all of them.
        tolerance: largest force left in every equilibrium, in F(0); 1e-3 if None, or
            that of the growth whose events are replayed.
        max_divisions: bound on the divisions, for a size that is never reached.
        max_seconds: bound on the time; checked between divisions.
        progress: called after every iteration.
        events: of a growth to replay; then seed and bounds do not matter. Record it at
            `tolerance=1e-10` if you replay it with other parameters.
        terms: energies besides those of jaxgrow, see `jaxgrow.relax`.

    Returns:
        The growth. Its result is REACHED, or says why it ended before that, with the
        last equilibrium as its state: DIVISION_LIMIT, TIME_LIMIT, CAVITY_FULL (against
        its walls the lesion no longer grows), PATCH_TOO_SMALL (the organ has no more
        surface), INTERSECTION, SLIVER, EVAPORATED, STEP_LIMIT, NON_FINITE or
        ON_MEMBRANE.

    Raises:
        OrganError: the organ or the site cannot be used.
        ValueError: JAX computes in 32 bits, the tolerance is not positive, the
            events are those of another scene, or a second derivative is taken
            (`jax.hessian`) or values are withheld (`jax.jit`, `jax.checkpoint`,
            `jax.vmap`).
        RuntimeError: this process was forked from one that had grown something.
    """
    refuse_forked()
    if jnp.zeros(()).dtype != jnp.float64:
        raise ValueError(
            "JAX computes in 32 bits here, and growth needs 64; put "
            'jax.config.update("jax_enable_x64", True) before it, or set '
            "JAX_ENABLE_X64=1."
        )
    if max_seconds is not None and not max_seconds > 0:
        raise ValueError(f"max_seconds is {max_seconds}; it must be positive.")
    parameters = as_arrays(_parameters(scene, parameters), jnp.float64)
    check_transformations(parameters)
    clock = Clock()
    with count_compilations() as compilations, count_descents() as descents:
        if events is None:
            tolerance = 1e-3 if tolerance is None else tolerance
            if is_differentiated((parameters, terms)):
                tolerance = min(tolerance, exact_tolerance())
            limits = Limits(max_divisions, max_seconds)
            step, events, history = _grow(
                scene, seed, parameters, tolerance, limits, clock, progress, terms
            )
            result = events.result
        else:
            tolerance = tolerance_of_replay(events, parameters, tolerance)
            with clock.phase("plant"):
                planted = plant_again(scene, events, parameters, tolerance, terms)
            step, history, result = replay(
                scene, events, planted, parameters, tolerance, clock, progress, terms
            )
    return Growth(
        scene=scene,
        seed=seed,
        tolerance=tolerance,
        state=step.state,
        result=result,
        size_mm=size_of(scene, step.state) * scene.r0_mm,
        events=events,
        history=tuple(history),
        seconds=dict(clock.total),
        compilations=compilations.count,
        descents=descents,
        ground=step.ground,
        organ_index=step.organ_index,
    )


def _parameters(
    scene: Scene, given: Parameters | Mapping[str, Scalar] | None
) -> Parameters:
    """The scene's parameters, or those given instead of some or all of them."""
    if isinstance(given, Mapping):
        check_names(given, [field.name for field in fields(Parameters)])
        return replace(scene.parameters, **given)
    return scene.parameters if given is None else given


class Limits(NamedTuple):
    """Where a growth ends if its lesion never has its size.

    Attributes:
        divisions: at most.
        seconds: at most; None for no bound.
    """

    divisions: int
    seconds: float | None


def _grow(
    scene: Scene,
    seed: int,
    parameters: Parameters,
    tolerance: float,
    limits: Limits,
    clock: Clock,
    progress: Callable[[Progress], None] | None,
    terms: ExtraTerms,
) -> tuple[Step, Events, list[dict[str, Any]]]:
    """The last step, the choices with the result, and a record of every iteration."""
    rng = np.random.default_rng(seed)
    with clock.phase("plant"):
        planted = plant(scene, parameters, tolerance=tolerance, rng=rng, terms=terms)
    step, result = first_step(planted, terms), Result.CONVERGED
    if planted.outcome is not None:
        result = planted.outcome.result
    start, events = _start(planted), list[Event]()
    history: list[dict[str, Any]] = []
    size = size_of(scene, step.state) * scene.r0_mm
    while result is Result.CONVERGED:
        forget_now_and_then(len(events))
        divisions = sum(len(event.divisions) for event in events)
        result = end_of(scene, size, divisions, history, limits.divisions)
        if result is not Result.CONVERGED:
            break
        if limits.seconds is not None and clock.elapsed > limits.seconds:
            result = Result.TIME_LIMIT
            break
        left = min(scene.lesion.divisions or limits.divisions, limits.divisions)
        count = min(scene.lesion.divisions_per_step, left - divisions)
        made = iterate(scene, step, parameters, tolerance, rng, clock, count)
        step, result = made.step, made.result
        if made.event is None or made.settled is None:
            break
        if result is Result.CONVERGED:
            events.append(made.event)
            with clock.phase("measure"):
                size = size_of(scene, step.state) * scene.r0_mm
        elif result is Result.STEP_LIMIT and _stagnates(history, STAGNATION // 2):
            result = Result.CAVITY_FULL
        divisions += len(made.event.divisions)
        record = make_record(divisions, size, step.state, made.settled, clock)
        add_feeling(record, made.felt)
        record["result"] = made.result.name
        if made.event.redirected:
            record["mended"]["daughter_redirected"] = 1
        place = _tight_place(scene, made, history)
        if place is not None:
            wider = enlarge_patch(scene, step, parameters, tolerance, rng, place, clock)
            result = Result.CONVERGED
            if isinstance(wider, Result):
                result = wider
            else:
                step, widening = wider
                last = events[-1] if events else start
                last = last._replace(widenings=(*last.widenings, widening))
                if isinstance(last, Event):
                    events[-1] = last
                else:
                    start = last
                record["mended"]["patch_enlarged"] = 1
        history.append(record)
        if progress is not None:
            progress(make_progress(scene, record, clock))
    recorded = Events(
        start,
        tuple(events),
        numbers(parameters),
        tolerance,
        scene.lesion.kind,
        scene.r0_mm,
        result,
    )
    return step, recorded, history


def _start(planted: Planted) -> Start:
    """What to keep of the start for a replay."""
    if planted.layout is None:
        return Start(None, None)
    positions = get_positions(planted.state.particles, planted.state.membrane)
    return Start(planted.layout, positions)


def _tight_place(
    scene: Scene, made: Iteration, history: list[dict[str, Any]]
) -> Float[np.ndarray, "3"] | None:
    """Where the patch is to be enlarged before the next iteration, in r0, if it is.

    If a particle left it, there is no other way. A border that feels the lesion is
    followed a few times; what then is felt still is a stiff surface or a dense tissue.
    """
    if made.felt is None or made.felt.place is None:
        return None
    enlarged = sum("patch_enlarged" in record["mended"] for record in history)
    assert made.step.ground is not None
    bottom = is_below(made.step.ground, made.felt.place)
    # under a polyp the bottom of the layer is what it pushes itself off from
    ignored = enlarged >= ENLARGEMENTS or (bottom and isinstance(scene.lesion, Polyp))
    return made.felt.place if made.felt.crossed or not ignored else None


def end_of(
    scene: Scene,
    size: Scalar,
    divisions: int,
    history: list[dict[str, Any]],
    max_divisions: int,
) -> Result:
    """Why growth ends here; CONVERGED if it goes on."""
    target = scene.lesion.target_mm
    if target is None:
        if divisions >= (scene.lesion.divisions or 0):
            return Result.REACHED
    elif size >= target:
        return Result.REACHED
    if divisions >= max_divisions:
        return Result.DIVISION_LIMIT
    window = max(STAGNATION, divisions // 4)
    if target is not None and _stagnates(history, window):
        return Result.CAVITY_FULL
    return Result.CONVERGED


def _stagnates(history: list[dict[str, Any]], window: int) -> bool:
    """Whether so many divisions, all against a wall, hardly enlarged the lesion.

    A quarter more particles enlarge a free lesion by 7 % in diameter at least.
    """
    former = history[-1]["division"] - window if history else 0
    before = [r for r in history if r["division"] <= former]
    if not before:
        return False
    recent = history[len(before) :]
    old, new = (
        max(get_number(r["size_mm"]) for r in some) for some in (before, recent)
    )
    stuck = new <= ENLARGING * old
    return stuck and all(record.get("colliding") for record in recent)
