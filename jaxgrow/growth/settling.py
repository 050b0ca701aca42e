"""Between two divisions: adapt tissue and surface, fair the surface, reset its springs.

Phases 2 to 4 of the paper's loop (§4), chosen here or repeated from a record.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int

from jaxgrow.equilibrium.refresh_lists import stale
from jaxgrow.growth.adaptation import (
    equilibrate,
    equilibrate_from,
    EquilibrationResult,
)
from jaxgrow.growth.events import EquilibriumRecord
from jaxgrow.growth.setup import GrowthState, min_radius_ratio, Setup
from jaxgrow.mesh.collision_mesh import join, Walls
from jaxgrow.mesh.fairing import fair
from jaxgrow.mesh.surface import Remeshing, Surface
from jaxgrow.mesh.swept_volume import swept_points
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.timer import Clock
from jaxgrow.scene.scene import Surroundings
from jaxgrow.state import State
from jaxgrow.transfer.device import (
    get_particles,
    get_positions,
    get_surface,
    put_remeshed,
)


WALL_DISTANCE = 3.0
"""Walls up to this distance (r0) from the surface are looked at by fairing."""


@dataclass(frozen=True, eq=False)
class FairingResult:
    """An equilibrium that was faired.

    Attributes:
        now: afterwards; what was given, if the result is not CONVERGED.
        result: CONVERGED, or why there is no valid state.
        found: the equilibrium, and how it was found.
        remeshing: what fairing did; None without a membrane, and if that failed.
        quality: least radius ratio of the surface's triangles; 1 without a membrane.
    """

    now: GrowthState
    result: Result
    found: EquilibrationResult
    remeshing: Remeshing | None = None
    quality: float = 1.0

    @property
    def record(self) -> EquilibriumRecord:
        """What is needed to do it again."""
        state = self.found.state
        positions = get_positions(state.particles, state.membrane)
        return EquilibriumRecord(positions, self.found.colliding, self.remeshing)

    @property
    def mended(self) -> dict[str, int]:
        """What went wrong and was mended, how often."""
        counts = {} if self.remeshing is None else self.remeshing.counts
        rejected = {n: c for n, c in counts.items() if n == "fairing_rejected"}
        return {**self.found.mended, **rejected}


def settle(setup: Setup, now: GrowthState, clock: Clock) -> FairingResult:
    """2., 3. and 4. Find the equilibrium, fair the surface, reset its springs.

    If the equilibrium intersects itself, it is sought again with collisions.

    Args:
        setup: of the growth.
        now: after a division or an enlargement.
        clock: counts the seconds of the phases "adapt" and "fair".
    """
    colliding = now.colliding
    while True:
        with clock.phase("adapt"):
            found = equilibrate(setup, now, colliding=colliding)
        if found.result is not Result.CONVERGED:
            return FairingResult(now, found.result, found)
        if found.state.membrane is None:
            return _faired(now, found, None, 0.0)
        with clock.phase("fair"):
            around = setup.scene.surroundings
            remeshing = choose_fairing(around, found.state, now.organ_index, now.walls)
        if remeshing is not None:
            return _faired(now, found, remeshing, now.least_quality)
        if found.colliding:
            return FairingResult(now, Result.INTERSECTION, found)
        colliding = True


def settle_again(
    setup: Setup, now: GrowthState, record: EquilibriumRecord, clock: Clock
) -> FairingResult:
    """Find a recorded equilibrium again, with the recorded fairing.

    Args:
        setup: of the growth; its parameters may differ from those of the record.
        now: after the recorded division or enlargement.
        record: of the equilibrium.
        clock: counts the seconds of the phases "adapt" and "fair".
    """
    with clock.phase("adapt"):
        start, colliding = record.positions, record.colliding
        found = equilibrate_from(setup, now, start, colliding=colliding)
    if found.result is not Result.CONVERGED:
        return FairingResult(now, found.result, found)
    with clock.phase("fair"):
        return _faired(now, found, record.remeshing, 0.0)


def _faired(
    now: GrowthState,
    found: EquilibrationResult,
    remeshing: Remeshing | None,
    least_quality: float,
) -> FairingResult:
    """Fair an equilibrium; all springs are assigned their current length."""
    after = replace(
        now,
        state=found.state,
        lists=stale(found.relaxation.lists),
        colliding=found.colliding,
    )
    if remeshing is None:
        return FairingResult(after, Result.CONVERGED, found)
    assert found.state.membrane is not None
    membrane = put_remeshed(found.state.membrane, remeshing)
    after = replace(
        after,
        state=State(found.state.particles, membrane, found.state.frame),
        organ_index=_renamed(now.organ_index, remeshing),
    )
    quality = min_radius_ratio(after.state)
    if quality < least_quality:
        return FairingResult(now, Result.SLIVER, found, remeshing, quality)
    return FairingResult(after, Result.CONVERGED, found, remeshing, quality)


def choose_fairing(
    surroundings: Surroundings,
    state: State,
    organ_index: Int[np.ndarray, " m"],
    walls: Walls | None,
) -> Remeshing | None:
    """Choose how to fair the surface, on the host.

    Every operation is tested before it is made; the whole is tested once more here,
    exactly and independently: that no particle lies in the volume between the surface
    before and after, and that the surface meets neither itself nor a wall. If that
    fails, the surface stays as it is ("fairing_rejected" in the counts).

    Args:
        surroundings: size of the triangles, and whether collisions are looked at.
        state: with a membrane.
        organ_index: of each vertex the organ's vertex that it is, or -1.
        walls: the rest of the organ.

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
        max_area=surroundings.max_area,
        min_area=surroundings.min_area,
        walls=near,
    )
    if surroundings.collisions == "off":
        return remeshing
    index = _renamed(organ_index, remeshing)
    sound = not swept_points(before, surface, position).any()
    if sound and not _intersects(surface, index, walls):
        return remeshing
    if _intersects(before, organ_index, walls):
        return None
    return Remeshing.unchanged(before, {"fairing_rejected": 1})


def _renamed(
    organ_index: Int[np.ndarray, " m"], remeshing: Remeshing
) -> Int[np.ndarray, " k"]:
    """Return the organ's vertex that each vertex is after a remeshing, or -1."""
    origin = remeshing.origin()
    return np.where(origin >= 0, organ_index[origin], -1)


def _intersects(
    surface: Surface, index: Int[np.ndarray, " m"], walls: Walls | None
) -> bool:
    """Return whether triangles of the surface meet each other, or a wall."""
    return len(join(surface, index, walls, 0.0).self_intersections()) > 0
