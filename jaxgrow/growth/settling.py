"""Between two divisions: adapt tissue and surface, fair the surface, reset its springs.

Phases 2 to 4 of the paper's loop (§4), with what is mended on the way.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.problem import ExtraTerms
from jaxgrow.equilibrium.refresh_lists import stale
from jaxgrow.equilibrium.relax import relax
from jaxgrow.growth.adaptation import adapt_tissue_and_surface, Adapted, Laws
from jaxgrow.growth.boundary import Border
from jaxgrow.growth.collision_broad_phase import CollisionFinder
from jaxgrow.growth.events import Settling
from jaxgrow.growth.initial_state import Ground
from jaxgrow.mesh.collision_mesh import join, Walls
from jaxgrow.mesh.fairing import fair
from jaxgrow.mesh.quality import radius_ratio
from jaxgrow.mesh.surface import Remeshing, Surface
from jaxgrow.mesh.swept_volume import swept_points
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.timer import Clock
from jaxgrow.scene.scene import Scene
from jaxgrow.state import State
from jaxgrow.transfer.device import (
    get_particles,
    get_positions,
    get_surface,
    put_positions,
    put_remeshed,
)


WALL_DISTANCE = 3.0
"""Walls up to this distance (r0) from the surface are looked at by fairing."""

LEAST_QUALITY = 0.01
"""Least radius ratio 2 r_in / r_circ of a triangle of a valid surface; half of the
organ's least, if that is less. Repair sets in at 0.15, see `jaxgrow.mesh.repair`."""


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
        least_quality: radius ratio that no triangle may fall below.
        terms: of the energy, besides those of jaxgrow.
    """

    state: State
    organ_index: Int[np.ndarray, " m"]
    lists: Lists | None
    ground: Ground | None
    colliding: bool = False
    border: Border | None = None
    least_quality: float = LEAST_QUALITY
    terms: ExtraTerms = ()

    @property
    def walls(self) -> Walls | None:
        """The rest of the organ."""
        return None if self.ground is None else self.ground.walls


@dataclass(frozen=True, eq=False)
class Settled:
    """Outcome of `settle`.

    Attributes:
        step: settled; the state that was given, if the result is not CONVERGED.
        result: CONVERGED, or why it could not settle.
        adapted: the equilibrium, and how it was come to.
        remeshing: what fairing did; None without a membrane, and if that failed.
        quality: least radius ratio of the surface's triangles; 1 without a membrane.
    """

    step: Step
    result: Result
    adapted: Adapted
    remeshing: Remeshing | None = None
    quality: float = 1.0

    @property
    def settling(self) -> Settling:
        """What is needed to do it again."""
        state = self.adapted.state
        positions = get_positions(state.particles, state.membrane)
        return Settling(positions, self.adapted.colliding, self.remeshing)

    @property
    def mended(self) -> dict[str, int]:
        """What went wrong and was mended, how often."""
        counts = {} if self.remeshing is None else self.remeshing.counts
        rejected = {n: c for n, c in counts.items() if n == "fairing_rejected"}
        return {**self.adapted.mended, **rejected}


def settle(
    scene: Scene, step: Step, parameters: Parameters, tolerance: float, clock: Clock
) -> Settled:
    """2., 3. and 4. Equilibrium, fairing, and reset of the springs.

    If the equilibrium intersects itself, it is sought again with collisions.

    Args:
        scene: what grows.
        step: after a division or an enlargement.
        parameters: of the mechanics.
        tolerance: of the equilibrium, in F(0).
        clock: counts the seconds of the phases "adapt" and "fair".
    """
    collisions = scene.surroundings.collisions
    laws = Laws(parameters, tolerance, collisions, step.walls, step.terms)
    colliding = step.colliding
    while True:
        with clock.phase("adapt"):
            adapted = adapt_tissue_and_surface(
                step.state, step.organ_index, laws, step.lists, colliding=colliding
            )
        if adapted.result is not Result.CONVERGED:
            return Settled(step, adapted.result, adapted)
        after = replace(
            step,
            state=adapted.state,
            lists=stale(adapted.relaxation.lists),
            colliding=adapted.colliding,
        )
        if adapted.state.membrane is None:
            return Settled(after, Result.CONVERGED, adapted)
        with clock.phase("fair"):
            remeshing = choose_fairing(
                scene, adapted.state, step.organ_index, step.walls
            )
        if remeshing is not None:
            break
        if adapted.colliding:
            return Settled(step, Result.INTERSECTION, adapted)
        colliding = True
    after = faired(after, remeshing)
    quality = quality_of(after.state)
    if quality < step.least_quality:
        return Settled(step, Result.SLIVER, adapted, remeshing, quality)
    return Settled(after, Result.CONVERGED, adapted, remeshing, quality)


def settle_again(
    step: Step,
    settling: Settling,
    parameters: Parameters,
    tolerance: float,
    clock: Clock,
) -> Settled:
    """The same from a recorded equilibrium, with the recorded fairing.

    Args:
        step: after the recorded division or enlargement.
        settling: the record.
        parameters: of the mechanics, not those of the record, maybe.
        tolerance: of the equilibrium, in F(0).
        clock: counts the seconds of the phases "adapt" and "fair".
    """
    state = step.state
    finder = None
    if settling.colliding and state.membrane is not None:
        finder = CollisionFinder.of(
            state.membrane, step.organ_index, step.walls, parameters
        )
    with clock.phase("adapt"):
        start = put_positions(state.particles, state.membrane, settling.positions)
        relaxation = relax(
            *start,
            parameters=parameters,
            tolerance=tolerance,
            lists=step.lists,
            collide=finder,
            terms=step.terms,
        )
    particles, membrane = relaxation.state
    assert particles is not None
    state = State(particles, membrane, state.frame)
    adapted = Adapted(state, relaxation.result, relaxation, settling.colliding)
    if relaxation.result is not Result.CONVERGED:
        return Settled(step, relaxation.result, adapted)
    lists = stale(relaxation.lists)
    after = replace(step, state=state, lists=lists, colliding=settling.colliding)
    if settling.remeshing is None:
        return Settled(after, Result.CONVERGED, adapted)
    with clock.phase("fair"):
        after = faired(after, settling.remeshing)
    quality = quality_of(after.state)
    return Settled(after, Result.CONVERGED, adapted, settling.remeshing, quality)


def faired(step: Step, remeshing: Remeshing) -> Step:
    """The step after a fairing; all springs are assigned their current length."""
    assert step.state.membrane is not None
    membrane = put_remeshed(step.state.membrane, remeshing)
    return replace(
        step,
        state=State(step.state.particles, membrane, step.state.frame),
        organ_index=_renamed(step.organ_index, remeshing),
    )


def quality_of(state: State) -> float:
    """Least radius ratio of the surface's triangles; 1 if there is none."""
    if state.membrane is None:
        return 1.0
    surface = get_surface(state.membrane)
    corners = surface.vertices[surface.faces]
    return float(radius_ratio(corners).min(initial=1.0))


def bound_on_quality(state: State) -> float:
    """The least quality that is asked for from here on, see `LEAST_QUALITY`."""
    return min(LEAST_QUALITY, 0.5 * quality_of(state))


def choose_fairing(
    scene: Scene,
    state: State,
    organ_index: Int[np.ndarray, " m"],
    walls: Walls | None,
) -> Remeshing | None:
    """Fair the surface on the host.

    Every operation is tested before it is made; the whole is tested once more here,
    exactly and independently: that no particle lies in the volume between the surface
    before and after, and that the surface meets neither itself nor a wall. If that
    fails, the surface stays as it is ("fairing_rejected" in the counts).

    Returns:
        What to do; None if the surface intersects itself or a wall already without.
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
    if scene.surroundings.collisions == "off":
        return remeshing
    names = _renamed(organ_index, remeshing)
    sound = not swept_points(before, surface, position).any()
    if sound and not _intersects(surface, names, walls):
        return remeshing
    if _intersects(before, organ_index, walls):
        return None
    return Remeshing.unchanged(before, {"fairing_rejected": 1})


def _renamed(
    organ_index: Int[np.ndarray, " m"], remeshing: Remeshing
) -> Int[np.ndarray, " k"]:
    """The organ's vertex that each vertex is after a remeshing, or -1."""
    origin = remeshing.origin()
    return np.where(origin >= 0, organ_index[origin], -1)


def _intersects(
    surface: Surface, names: Int[np.ndarray, " m"], walls: Walls | None
) -> bool:
    """Whether triangles of the surface meet each other, or a wall."""
    return len(join(surface, names, walls, 0.0).self_intersections()) > 0
