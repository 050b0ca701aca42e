"""Growth: iterate until the lesion has its size, or cannot (paper §4)."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrow.clock import Clock
from jaxgrow.compilations import count_compilations
from jaxgrow.growth import Event, Growth, Progress
from jaxgrow.lesion import size_of
from jaxgrow.parameters import Parameters
from jaxgrow.planting import plant
from jaxgrow.results import Result
from jaxgrow.scene import Polyp, Scene
from jaxgrow.settling import bound_on_quality, Step
from jaxgrow.state import Species
from jaxgrow.step import enlarge_patch, is_below, iterate, Iteration
from jaxgrow.transfer import get


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
    parameters: Parameters | None = None,
    tolerance: float = 1e-3,
    max_divisions: int = 3000,
    max_seconds: float | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Growth:
    """Grow a lesion until it has the size, or the number of divisions, asked for.

    Every iteration makes the paper's steps in its order: one tumour particle divides,
    tissue and surface come to equilibrium (here together, see `jaxgrow.relax`), the
    surface is faired, and its springs get their current length as new rest length.

    What goes wrong is mended where it can be: an equilibrium that is not found, or
    that threw particles out, is tried again from its start with shorter steps; lists
    that overflow are made larger; a fairing that fails the exact check is left out;
    sheets that meet begin to repel each other; a patch that feels the lesion is
    enlarged. `Growth.mended` counts it. Otherwise the growth ends with its name.

    Args:
        scene: what to grow, and where.
        seed: of all random choices; the same seed gives the same growth.
        parameters: of the mechanics, instead of the scene's.
        tolerance: largest force left in every equilibrium, in F(0).
        max_divisions: bound on the divisions, for a size that is never reached.
        max_seconds: bound on the time; checked between divisions.
        progress: called after every division.

    Returns:
        The growth. Its result is REACHED, or says why it ended before that, with the
        last equilibrium as its state: DIVISION_LIMIT, TIME_LIMIT, CAVITY_FULL (against
        its walls the lesion no longer grows), PATCH_TOO_SMALL (the organ has no more
        surface), INTERSECTION, SLIVER, EVAPORATED, STEP_LIMIT, NON_FINITE or
        ON_MEMBRANE.

    Raises:
        OrganError: the organ or the site cannot be used.
        ValueError: JAX computes in 32 bits, or the tolerance is not positive.
    """
    if jnp.zeros(()).dtype != jnp.float64:
        raise ValueError(
            "JAX computes in 32 bits here, and growth needs 64; put "
            'jax.config.update("jax_enable_x64", True) before it, or set '
            "JAX_ENABLE_X64=1."
        )
    if max_seconds is not None and not max_seconds > 0:
        raise ValueError(f"max_seconds is {max_seconds}; it must be positive.")
    parameters = parameters or scene.parameters
    rng = np.random.default_rng(seed)
    clock = Clock()
    with count_compilations() as compilations:
        with clock.phase("plant"):
            planted = plant(scene, parameters, tolerance=tolerance, rng=rng)
        lists, result = None, Result.CONVERGED
        if planted.outcome is not None:
            lists, result = planted.outcome.lists, planted.outcome.result
        step = Step(
            planted.state,
            planted.organ_index,
            lists,
            planted.ground,
            border=planted.border,
            least_quality=bound_on_quality(planted.state),
        )
        events: list[Event] = []
        history: list[dict[str, Any]] = []
        size = size_of(scene, step.state) * scene.r0_mm
        while result is Result.CONVERGED:
            result = end_of(scene, size, len(events), history, max_divisions)
            if result is not Result.CONVERGED:
                break
            if max_seconds is not None and clock.elapsed > max_seconds:
                result = Result.TIME_LIMIT
                break
            made = iterate(scene, step, parameters, tolerance, rng, clock)
            step, result = made.step, made.result
            number = len(events) + 1
            if result is Result.CONVERGED:
                events.append(made.event)
                with clock.phase("measure"):
                    size = size_of(scene, step.state) * scene.r0_mm
            elif result is Result.STEP_LIMIT and _stagnates(history, STAGNATION // 2):
                result = Result.CAVITY_FULL
            record = _record(number, size, made, clock)
            place = _tight_place(scene, made, history)
            if place is not None:
                wider = enlarge_patch(
                    scene, step, parameters, tolerance, rng, place, clock
                )
                result = Result.CONVERGED
                if isinstance(wider, Result):
                    result = wider
                else:
                    step = wider
                    record["mended"] = {**record["mended"], "patch_enlarged": 1}
            history.append(record)
            if progress is not None:
                progress(_progress(scene, record, clock))
    return Growth(
        scene=scene,
        seed=seed,
        tolerance=tolerance,
        state=step.state,
        result=result,
        size_mm=size,
        events=tuple(events),
        history=tuple(history),
        seconds=dict(clock.total),
        compilations=compilations.count,
        ground=step.ground,
        organ_index=step.organ_index,
    )


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
    size: float,
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
    window = max(STAGNATION, len(history) // 4)
    if target is not None and _stagnates(history, window):
        return Result.CAVITY_FULL
    return Result.CONVERGED


def _stagnates(history: list[dict[str, Any]], window: int) -> bool:
    """Whether so many divisions, all against a wall, hardly enlarged the lesion.

    A quarter more particles enlarge a free lesion by 7 % in diameter at least.
    """
    if len(history) <= window:
        return False
    recent = history[-window:]
    before = max(record["size_mm"] for record in history[:-window])
    stuck = max(record["size_mm"] for record in recent) <= ENLARGING * before
    return stuck and all(record.get("colliding") for record in recent)


def _record(
    division: int, size: float, made: Iteration, clock: Clock
) -> dict[str, Any]:
    """What is written about one division."""
    particles, membrane = made.step.state.particles, made.step.state.membrane
    stats = made.settled.adapted.relaxation.stats
    alive = get(particles.alive)
    record: dict[str, Any] = {
        "division": division,
        "size_mm": size,
        "residual": stats.residual,
        "steps": stats.steps,
        "method": stats.method,
        "result": made.result.name,
        "particles": int(alive.sum()),
        "tumour": int((alive & (get(particles.species) == Species.TUMOUR)).sum()),
    }
    if membrane is not None:
        record["vertices"] = int(get(membrane.vertex_alive).sum())
        record["faces"] = int(get(membrane.face_alive).sum())
        record["colliding"] = made.settled.adapted.colliding
        record["quality"] = made.settled.quality
    if made.felt is not None:
        record["border_force"] = made.felt.force
        record["border_distance"] = made.felt.distance
    if made.event.remeshing is not None:
        record["operations"] = dict(made.event.remeshing.counts)
    record["mended"] = made.settled.mended
    record["seconds"] = clock.lap()
    return record


def _progress(scene: Scene, record: dict[str, Any], clock: Clock) -> Progress:
    return Progress(
        divisions=record["division"],
        size_mm=record["size_mm"],
        target_mm=scene.lesion.target_mm,
        target_divisions=scene.lesion.divisions,
        residual=record["residual"],
        seconds=clock.elapsed,
    )
