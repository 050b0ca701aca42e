"""One iteration of the growth loop, in the paper's phases and order (paper §4)."""

from dataclasses import dataclass, field, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxgrow.adaptation import adapt_tissue_and_surface, Adapted, Laws
from jaxgrow.border import beside_patch, Border, border_of, Feeling, feeling
from jaxgrow.clock import Clock
from jaxgrow.division import choose_myoma, divide_myoma, divide_polyp, Division
from jaxgrow.enlargement import enlarge_ground
from jaxgrow.equilibrium.problem import Lists
from jaxgrow.equilibrium.relax import stale
from jaxgrow.growth import Event
from jaxgrow.mesh.fairing import fair
from jaxgrow.mesh.proximity import nearest_on_mesh
from jaxgrow.mesh.sheet import join, Walls
from jaxgrow.mesh.surface import Remeshing, Surface
from jaxgrow.mesh.swept import swept_points
from jaxgrow.organ import OrganError
from jaxgrow.parameters import Parameters
from jaxgrow.planting import Ground, meeting_distance, SPARE
from jaxgrow.results import Result
from jaxgrow.scene import Myoma, Scene
from jaxgrow.state import Particles, Species, State
from jaxgrow.transfer import (
    get,
    get_particles,
    get_surface,
    put_remeshed,
    reset_springs,
    with_capacity,
)


WALL_DISTANCE = 3.0
"""Walls up to this distance (r0) from the surface are looked at by fairing."""


@dataclass(frozen=True, eq=False)
class Step:
    """The state between two divisions, with what is carried along on the host.

    Attributes:
        state: an equilibrium, springs reset.
        organ_index: of each vertex alive the organ's vertex that it is, or -1.
        lists: of the last relaxation; None before the first.
        ground: what is around; None for a free cluster.
        colliding: whether sheets of the surface have come near each other.
        border: what is held around the patch, before growth; None for a free cluster.
    """

    state: State
    organ_index: Int[np.ndarray, " m"]
    lists: Lists | None
    ground: Ground | None
    colliding: bool = False
    border: Border | None = None

    @property
    def walls(self) -> Walls | None:
        """The rest of the organ."""
        return None if self.ground is None else self.ground.walls


@dataclass(frozen=True, eq=False)
class Iteration:
    """Outcome of `iterate`.

    Attributes:
        step: after it; the one before it, if the result is not CONVERGED.
        event: the discrete choices.
        adapted: the equilibrium, and how it was come to.
        result: CONVERGED, or why there is no valid step.
        felt: how the patch's border feels the lesion; None without a patch.
        mended: what went wrong and was mended, how often.
    """

    step: Step
    event: Event
    adapted: Adapted
    result: Result
    felt: Feeling | None = None
    mended: dict[str, int] = field(default_factory=dict)


def laws_of(scene: Scene, step: Step, parameters: Parameters, tolerance: float) -> Laws:
    """What the equilibria of a growth have in common, as of this step."""
    return Laws(parameters, tolerance, scene.surroundings.collisions, step.walls)


def iterate(
    scene: Scene,
    step: Step,
    parameters: Parameters,
    tolerance: float,
    rng: np.random.Generator,
    clock: Clock,
) -> Iteration:
    """Divide, adapt, fair, reset; the step before it comes back if that fails."""
    laws = laws_of(scene, step, parameters, tolerance)
    with clock.phase("divide"):
        state, division = divide_tumour(scene, step.state, parameters, rng)
    colliding = step.colliding
    while True:
        with clock.phase("adapt"):
            adapted = adapt_tissue_and_surface(
                state, step.organ_index, laws, step.lists, colliding=colliding
            )
        mended = dict(adapted.mended)
        if adapted.result is not Result.CONVERGED:
            event = Event(division, None)
            return Iteration(step, event, adapted, adapted.result, mended=mended)
        if state.membrane is None:
            after = replace(
                step, state=adapted.state, lists=stale(adapted.relaxation.lists)
            )
            event = Event(division, None)
            return Iteration(after, event, adapted, adapted.result, mended=mended)
        with clock.phase("fair"):
            faired = fair_surface(scene, adapted.state, step.organ_index, step.walls)
        if faired is not None:
            break
        if adapted.colliding or laws.collisions == "off":
            event = Event(division, None)
            return Iteration(step, event, adapted, Result.INTERSECTION, mended=mended)
        colliding = True
    surface_state, remeshing = faired
    if remeshing.counts.get("fairing_rejected"):
        mended["fairing_rejected"] = 1
    assert step.border is not None
    border = border_of(adapted.relaxation, step.organ_index)
    assert step.walls is not None
    particles, membrane = adapted.state.particles, adapted.state.membrane
    assert membrane is not None
    reach = float(get(jnp.asarray(parameters.contact_range)))
    beside = beside_patch(particles, get_surface(membrane), step.walls, reach)
    felt = feeling(border, step.border, particles, beside)
    if felt.crossed:
        event = Event(division, None)
        return Iteration(step, event, adapted, Result.PATCH_TOO_SMALL, felt, mended)
    after = replace(
        step,
        state=surface_state,
        organ_index=_renamed(step.organ_index, remeshing),
        lists=stale(adapted.relaxation.lists),
        colliding=adapted.colliding,
    )
    event = Event(division, remeshing)
    return Iteration(after, event, adapted, Result.CONVERGED, felt, mended)


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
) -> Step | Result:
    """A larger patch around the same lesion, in equilibrium, springs reset.

    Args:
        scene: what grows.
        step: where it stands.
        parameters: of the mechanics.
        tolerance: of the equilibrium, in F(0).
        rng: draws the new tissue.
        place: where its border feels the lesion, in r0: near the axis the layer of
            tissue becomes thicker, elsewhere the patch wider.

    Returns:
        The step, or PATCH_TOO_SMALL if the organ has no more to give, or why the wider
        patch did not come to equilibrium.
    """
    ground = step.ground
    assert ground is not None
    below = is_below(ground, place)
    radius = ground.radius + (0.0 if below else WIDER)
    try:
        wider = enlarge_ground(
            step.state,
            ground,
            step.organ_index,
            radius=radius,
            thickness=ground.thickness + (DEEPER if below else 0.0),
            meeting_distance=meeting_distance(scene, radius),
            surroundings=scene.surroundings,
            contact_range=float(get(jnp.asarray(parameters.contact_range))),
            rng=rng,
        )
    except OrganError:
        return Result.PATCH_TOO_SMALL
    step = replace(
        step,
        state=wider.state,
        organ_index=wider.organ_index,
        ground=wider.ground,
        lists=None,
    )
    adapted = adapt_tissue_and_surface(
        step.state,
        step.organ_index,
        laws_of(scene, step, parameters, tolerance),
        None,
        colliding=step.colliding,
    )
    if adapted.result is not Result.CONVERGED:
        return adapted.result
    border = border_of(adapted.relaxation, step.organ_index)
    faired = fair_surface(scene, adapted.state, step.organ_index, step.walls)
    if faired is None:
        return Result.INTERSECTION
    state, remeshing = faired
    return replace(
        step,
        state=state,
        organ_index=_renamed(step.organ_index, remeshing),
        lists=stale(adapted.relaxation.lists),
        colliding=adapted.colliding,
        border=border,
    )


def _renamed(
    organ_index: Int[np.ndarray, " m"], remeshing: Remeshing
) -> Int[np.ndarray, " k"]:
    """The organ's vertex that each vertex is after a remeshing, or -1."""
    origin = remeshing.origin()
    return np.where(origin >= 0, organ_index[origin], -1)


def divide_tumour(
    scene: Scene, state: State, parameters: Parameters, rng: np.random.Generator
) -> tuple[State, Division]:
    """1. Divide one tumour particle."""
    particles = _with_room(state.particles)
    slot = int(get(particles.alive).sum())
    if isinstance(scene.lesion, Myoma):
        division = _choose(state, slot, rng)
        particles = divide_myoma(
            particles,
            jnp.asarray(division.parent),
            jnp.asarray(slot),
            jnp.asarray(division.offset),
        )
    else:
        assert state.membrane is not None
        division = Division(slot)
        particles = divide_polyp(
            particles, state.membrane, jnp.asarray(slot), parameters
        )
    return State(particles, state.membrane, state.frame), division


def fair_surface(
    scene: Scene,
    state: State,
    organ_index: Int[np.ndarray, " m"],
    walls: Walls | None,
) -> tuple[State, Remeshing] | None:
    """4. Surface fairing; all springs are assigned their current length.

    Every operation is tested before it is made; the whole is tested once more here,
    exactly and independently: that no particle lies in the volume between the surface
    before and after, and that the surface meets neither itself nor a wall. If that
    fails, the surface stays as it is ("fairing_rejected" in the counts).

    Returns:
        The state and what was done; None if the surface intersects itself or a wall
        already without fairing.
    """
    assert state.membrane is not None
    position, _ = get_particles(state.particles)
    before = get_surface(state.membrane)
    near = None
    if walls is not None:
        chosen = walls.near(before.vertices, WALL_DISTANCE)
        near = walls.vertices[walls.faces[chosen]]
    surface, remeshing = fair(
        before,
        position,
        max_area=scene.surroundings.max_area,
        min_area=scene.surroundings.min_area,
        walls=near,
    )
    names = _renamed(organ_index, remeshing)
    if scene.surroundings.collisions == "off":
        membrane = put_remeshed(state.membrane, surface, remeshing)
        return State(state.particles, membrane, state.frame), remeshing
    sound = not swept_points(before, surface, position).any()
    if sound and not len(_intersections(surface, names, walls)):
        membrane = put_remeshed(state.membrane, surface, remeshing)
        return State(state.particles, membrane, state.frame), remeshing
    if len(_intersections(before, organ_index, walls)):
        return None
    unchanged = Remeshing.unchanged(before, {"fairing_rejected": 1})
    membrane = reset_springs(state.membrane)
    return State(state.particles, membrane, state.frame), unchanged


def _intersections(
    surface: Surface, names: Int[np.ndarray, " m"], walls: Walls | None
) -> Int[np.ndarray, "p 2"]:
    """Pairs of triangles of the surface, or of surface and walls, that meet."""
    return join(surface, names, walls, 0.0).self_intersections()


def _choose(state: State, slot: int, rng: np.random.Generator) -> Division:
    """Draw a myoma's division, with the clearances that bound it."""
    particles = state.particles
    of_tumour = get(particles.species) == Species.TUMOUR
    tumour = np.flatnonzero(get(particles.alive) & of_tumour)
    clearance = np.full(len(tumour), np.inf)
    if state.membrane is not None:
        surface = get_surface(state.membrane)
        points = get(particles.position)[tumour]
        clearance, _, _ = nearest_on_mesh(points, surface.vertices, surface.faces)
    return choose_myoma(tumour, slot, clearance, rng)


def _with_room(particles: Particles) -> Particles:
    """Particles with a free slot; when they are full, half as many spare ones more."""
    capacity = particles.position.shape[0]
    if int(get(particles.alive).sum()) < capacity:
        return particles
    tumour = int((get(particles.species) == Species.TUMOUR).sum())
    return with_capacity(particles, capacity + max(SPARE, tumour))
