"""Phases between two divisions: equilibrium, fairing and spring reset.

Phases 2 (adapt the tissues), 3 (adapt the surface) and 4 (fair the surface) of the
paper's loop (§4), with choices made here or repeated from a record.
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
"""Distance (r0) from the surface up to which fairing avoids walls."""


@dataclass(frozen=True, eq=False)
class FairingResult:
    """Outcome of `settle`: an equilibrium that was faired.

    Attributes:
        now: afterwards; the given state, if the result is not CONVERGED.
        result: CONVERGED, or why there is no valid state.
        found: the equilibrium, with its relaxation.
        remeshing: operations of the fairing; None without a membrane, and after a
            failure.
        quality: least radius ratio of the surface's triangles; 1 without a membrane.
    """

    now: GrowthState
    result: Result
    found: EquilibrationResult
    remeshing: Remeshing | None = None
    quality: float = 1.0

    @property
    def record(self) -> EquilibriumRecord:
        """Record of the equilibrium and its fairing, for a replay."""
        state = self.found.state
        positions = get_positions(state.particles, state.membrane)
        return EquilibriumRecord(positions, self.found.colliding, self.remeshing)

    @property
    def mended(self) -> dict[str, int]:
        """Number of recoveries from failures, by name."""
        counts = {} if self.remeshing is None else self.remeshing.counts
        rejected = {n: c for n, c in counts.items() if n == "fairing_rejected"}
        return {**self.found.mended, **rejected}


def settle(setup: Setup, now: GrowthState, clock: Clock) -> FairingResult:
    """Find the equilibrium, fair the surface and reset its springs.

    These are phases 2 to 4 of the paper's §4. If the surface intersects itself at
    equilibrium, the equilibrium is computed again with the collision energy.

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
    """Repeat a recorded equilibrium, with the recorded fairing.

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
    """Apply a fairing, and reset all springs to their current length.

    This is phase 4 of the paper's §4.
    """
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
    """Choose the fairing operations of the surface, on the host.

    Every operation is tested before it is made. The result is tested here once more, by
    exact and independent checks: that no particle lies in the volume between the
    surface before and after, and that the surface intersects neither itself nor a wall.
    If one fails, the surface stays unchanged ("fairing_rejected" in the counts).

    Args:
        surroundings: size of the triangles, and whether collisions are checked.
        state: with a membrane.
        organ_index: for each vertex the same vertex of the organ, or -1.
        walls: the rest of the organ.

    Returns:
        The operations; None if the surface intersects itself or a wall before fairing.
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
    """Return each vertex's index in the organ after a remeshing, or -1."""
    origin = remeshing.origin()
    return np.where(origin >= 0, organ_index[origin], -1)


def _intersects(
    surface: Surface, index: Int[np.ndarray, " m"], walls: Walls | None
) -> bool:
    """Return whether the surface intersects itself, or a wall."""
    return len(join(surface, index, walls, 0.0).self_intersections()) > 0
