"""One iteration of the growth loop, in the paper's phases and order (paper §4)."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.problem import ExtraTerms
from jaxgrow.growth.boundary import beside_patch, border_of, Feeling, feeling
from jaxgrow.growth.division import (
    choose_myoma,
    choose_polyp,
    daughter_of_source,
    divide_myoma,
    divide_polyp,
    divide_polyp_to,
    Division,
)
from jaxgrow.growth.events import Event, Widening
from jaxgrow.growth.initial_state import Ground, HOLD, meeting_distance, Planted, SPARE
from jaxgrow.growth.patch_enlargement import enlarge_ground, Enlarged, put_enlarged
from jaxgrow.growth.settling import (
    bound_on_quality,
    settle,
    settle_again,
    Settled,
    Step,
)
from jaxgrow.mesh.proximity import nearest_on_mesh
from jaxgrow.organ import OrganError
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.timer import Clock
from jaxgrow.scene.scene import Myoma, Polyp, Scene
from jaxgrow.state import Particles, Species, State
from jaxgrow.transfer.device import get, get_number, get_surface, with_capacity


@dataclass(frozen=True, eq=False)
class Iteration:
    """Outcome of `iterate`.

    Attributes:
        step: after it; the one before it, if the result is not CONVERGED.
        event: the discrete choices, also of a step that failed; None if there is no
            room for a division.
        settled: the equilibrium and the fairing, and how they were come to; None if
            there is no event.
        result: CONVERGED, or why there is no valid step.
        felt: how the patch's border feels the lesion; None without a patch.
    """

    step: Step
    event: Event | None
    settled: Settled | None
    result: Result
    felt: Feeling | None = None


def first_step(planted: Planted, terms: ExtraTerms = ()) -> Step:
    """The step before the first division."""
    return Step(
        planted.state,
        planted.organ_index,
        None if planted.outcome is None else planted.outcome.lists,
        planted.ground,
        border=planted.border,
        least_quality=bound_on_quality(planted.state),
        terms=tuple(terms),
    )


def iterate(
    scene: Scene,
    step: Step,
    parameters: Parameters,
    tolerance: float,
    rng: np.random.Generator,
    clock: Clock,
    count: int = 1,
) -> Iteration:
    """Divide, adapt, fair, reset; the step before it comes back if that fails.

    Args:
        scene: what grows.
        step: where it stands.
        parameters: of the mechanics.
        tolerance: of the equilibrium, in F(0).
        rng: draws who divides, and where to.
        clock: counts the seconds.
        count: number of divisions; fewer are made if there are fewer particles to
            divide, or no room for so many.
    """
    if step.ground is not None and isinstance(scene.lesion, Polyp):
        count = min(count, _room(step.ground, parameters))
    with clock.phase("divide"):
        divisions = choose_divisions(scene, step.state, parameters, rng, count)
        if divisions is None:
            return Iteration(step, None, None, Result.ON_MEMBRANE)
        state = divide(step.state, divisions, parameters)
    settled = settle(scene, replace(step, state=state), parameters, tolerance, clock)
    event = Event(divisions, settled.settling)
    result, felt = settled.result, None
    if result is Result.CONVERGED and step.border is not None:
        felt = _feeling(step, settled, parameters)
        if felt.crossed:
            result = Result.PATCH_TOO_SMALL
    after = settled.step if result is Result.CONVERGED else step
    return Iteration(after, event, settled, result, felt)


DEEPEST = 0.5
"""Share of the free layer of tissue under a polyp in which its particles are born."""


def _room(ground: Ground, parameters: Parameters) -> int:
    """How many particles a polyp has room for at once, one below the other."""
    deepest = DEEPEST * (ground.thickness - HOLD)
    return max(1, int(deepest / get_number(parameters.daughter_offset)))


def _feeling(step: Step, settled: Settled, parameters: Parameters) -> Feeling:
    """What the border of the patch feels at an equilibrium."""
    state = settled.adapted.state
    assert state.membrane is not None
    assert step.border is not None
    assert step.walls is not None
    reach = get_number(parameters.contact_range)
    surface = get_surface(state.membrane)
    beside = beside_patch(state.particles, surface, step.walls, reach)
    border = border_of(settled.adapted.relaxation)
    return feeling(border, step.border, state.particles, beside)


WIDER, DEEPER = 2.0, 1.0
"""By how much radius or thickness of a patch grow when it is enlarged, in r0."""


def is_below(ground: Ground, place: Float[np.ndarray, "3"]) -> bool:
    """Whether a place on a patch's border is at its bottom rather than at its sides."""
    axis = ground.site.normal
    sideways = float(np.linalg.norm(place - (place @ axis) * axis))
    return sideways < 0.6 * ground.radius


def enlarge_patch(
    scene: Scene,
    step: Step,
    parameters: Parameters,
    tolerance: float,
    rng: np.random.Generator,
    place: Float[np.ndarray, "3"],
    clock: Clock,
) -> tuple[Step, Widening] | Result:
    """A larger patch around the same lesion, in equilibrium, springs reset.

    Args:
        scene: what grows.
        step: where it stands.
        parameters: of the mechanics.
        tolerance: of the equilibrium, in F(0).
        rng: draws the new tissue.
        place: where its border feels the lesion, in r0: near the axis the layer of
            tissue becomes thicker, elsewhere the patch wider.
        clock: counts the seconds.

    Returns:
        The step and the record of it, or PATCH_TOO_SMALL if the organ has no more to
        give, or why the wider patch did not come to equilibrium.
    """
    ground = step.ground
    assert ground is not None
    below = is_below(ground, place)
    radius = ground.radius + (0.0 if below else WIDER)
    try:
        with clock.phase("enlarge"):
            wider = enlarge_ground(
                step.state,
                ground,
                step.organ_index,
                radius=radius,
                thickness=ground.thickness + (DEEPER if below else 0.0),
                meeting_distance=meeting_distance(scene, radius),
                surroundings=scene.surroundings,
                contact_range=get_number(parameters.contact_range),
                rng=rng,
            )
    except OrganError:
        return Result.PATCH_TOO_SMALL
    placed = _placed(step, wider)
    settled = settle(scene, placed, parameters, tolerance, clock)
    if settled.result is not Result.CONVERGED:
        return settled.result
    after = replace(settled.step, border=border_of(settled.adapted.relaxation))
    return after, Widening(wider.ground, wider.enlargement, settled.settling)


def _placed(step: Step, wider: Enlarged) -> Step:
    """The step on a larger patch, not in equilibrium."""
    return replace(
        step,
        state=wider.state,
        organ_index=wider.organ_index,
        ground=wider.ground,
        lists=None,
        least_quality=min(step.least_quality, bound_on_quality(wider.state)),
    )


def repeat(
    step: Step, event: Event, parameters: Parameters, tolerance: float, clock: Clock
) -> Settled:
    """An iteration again, from its record; the last settling of it.

    Args:
        step: before it.
        event: its record.
        parameters: of the mechanics, not those of the record, maybe.
        tolerance: of the equilibria, in F(0).
        clock: counts the seconds.
    """
    with clock.phase("divide"):
        state = divide(step.state, event.divisions, parameters)
    step = replace(step, state=state)
    settled = settle_again(step, event.settling, parameters, tolerance, clock)
    for widening in event.widenings:
        if settled.result is Result.CONVERGED:
            settled = widen(settled.step, widening, parameters, tolerance, clock)
    return settled


def widen(
    step: Step,
    widening: Widening,
    parameters: Parameters,
    tolerance: float,
    clock: Clock,
) -> Settled:
    """A recorded enlargement of the patch again."""
    with clock.phase("enlarge"):
        wider = Enlarged(
            put_enlarged(step.state, widening.enlargement),
            widening.ground,
            widening.enlargement.lining.organ_index,
            widening.enlargement,
        )
    placed = _placed(step, wider)
    return settle_again(placed, widening.settling, parameters, tolerance, clock)


def choose_divisions(
    scene: Scene,
    state: State,
    parameters: Parameters,
    rng: np.random.Generator,
    count: int = 1,
) -> tuple[Division, ...] | None:
    """Who divides, and where to; None if every way leads out of the tissue.

    They are fewer than `count` where a further daughter would have no place.
    """
    slot = int(get(state.particles.alive).sum())
    if isinstance(scene.lesion, Myoma):
        return _draw(state, slot, rng, count)
    assert state.membrane is not None
    surface, divisions = get_surface(state.membrane), list[Division]()
    for depth in range(1, count + 1):
        far = jnp.asarray(float(depth))
        place = get(_daughter_of_source(state.membrane, far, parameters))
        division = choose_polyp(surface, slot + depth - 1, place, depth)
        if division is None:
            break
        divisions.append(division)
    return tuple(divisions) or None


_daughter_of_source = jax.jit(daughter_of_source)


def divide(
    state: State, divisions: tuple[Division, ...], parameters: Parameters
) -> State:
    """1. The state after divisions that have been chosen."""
    particles, membrane = state.particles, state.membrane
    for division in divisions:
        particles = _with_room(particles)
        slot = jnp.asarray(division.slot)
        offset = jnp.asarray(division.offset)
        if division.parent >= 0:
            parent = jnp.asarray(division.parent)
            particles = divide_myoma(particles, parent, slot, offset)
            continue
        assert membrane is not None
        if any(division.offset):
            particles = divide_polyp_to(particles, membrane, slot, offset)
        else:
            depth = jnp.asarray(float(division.depth))
            particles = divide_polyp(particles, membrane, slot, depth, parameters)
    return State(particles, membrane, state.frame)


def _draw(
    state: State, slot: int, rng: np.random.Generator, count: int
) -> tuple[Division, ...]:
    """Draw a myoma's divisions, with the clearances that bound them.

    No particle divides twice.
    """
    particles = state.particles
    of_tumour = get(particles.species) == Species.TUMOUR
    tumour = np.flatnonzero(get(particles.alive) & of_tumour)
    clearance = np.full(len(tumour), np.inf)
    if state.membrane is not None:
        surface = get_surface(state.membrane)
        points = get(particles.position)[tumour]
        clearance, _, _ = nearest_on_mesh(points, surface.vertices, surface.faces)
    divisions = list[Division]()
    while len(tumour) and len(divisions) < count:
        division = choose_myoma(tumour, slot + len(divisions), clearance, rng)
        divisions.append(division)
        others = tumour != division.parent
        tumour, clearance = tumour[others], clearance[others]
    return tuple(divisions)


def _with_room(particles: Particles) -> Particles:
    """Particles with a free slot; when they are full, half as many spare ones more."""
    capacity = particles.position.shape[0]
    if int(get(particles.alive).sum()) < capacity:
        return particles
    tumour = int((get(particles.species) == Species.TUMOUR).sum())
    return with_capacity(particles, capacity + max(SPARE, tumour))
