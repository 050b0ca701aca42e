"""Adaptation of tissues and surface (paper §4), with failure recovery.

An equilibrium is accepted if the relaxation converged and did not eject particles.
Otherwise it is tried again from the same start, with shorter steps. As soon as sheets
of the surface are within the collision range of each other, the collision energy is
added, for the rest of this growth. Until then it is zero, and is not computed.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from jaxgrow import kernels
from jaxgrow.energy.a2 import CUTOFF
from jaxgrow.equilibrium.problem import LARGEST_STEP
from jaxgrow.equilibrium.relax import relax, Relaxation
from jaxgrow.growth.collision_broad_phase import CollisionFinder
from jaxgrow.growth.setup import GrowthState, Setup
from jaxgrow.neighbors.verlet_list import FEW
from jaxgrow.neighbors.within_radius import near_seeds
from jaxgrow.runtime.results import Result
from jaxgrow.state import Particles, State
from jaxgrow.transfer.device import get, Positions, put_positions


ATTEMPTS = ((LARGEST_STEP, 1500), (LARGEST_STEP / 4, 4000))
"""Longest step (r0) and bound on the steps of each method, attempt after attempt."""


@dataclass(frozen=True, eq=False)
class EquilibrationResult:
    """Outcome of `equilibrate`.

    Attributes:
        state: the equilibrium, if the result is CONVERGED.
        result: CONVERGED, or the failure of the last attempt.
        relaxation: the last one.
        colliding: whether the collision energy is part of it.
        mended: number of recoveries of each kind, by name.
    """

    state: State
    result: Result
    relaxation: Relaxation
    colliding: bool
    mended: dict[str, int] = field(default_factory=dict)


def equilibrate(
    setup: Setup, now: GrowthState, *, colliding: bool
) -> EquilibrationResult:
    """Find the common equilibrium of tissues and surface.

    These are phases 2 (adapt the tissues) and 3 (adapt the surface) of the paper's §4.

    Args:
        setup: of the growth.
        now: after a division; its springs were reset.
        colliding: whether sheets have met before.
    """
    state, lists, mode = now.state, now.lists, setup.scene.surroundings.collisions
    finder = collision_finder(setup, now) if mode != "off" else None
    colliding = finder is not None and (colliding or mode == "on")
    mended: dict[str, int] = {}
    attempts = list(ATTEMPTS)
    while True:
        largest, max_steps = attempts.pop(0)
        relaxation = relax(
            state.particles,
            state.membrane,
            parameters=setup.parameters,
            tolerance=setup.tolerance,
            max_steps=max_steps,
            largest_step=largest,
            lists=lists,
            collide=finder if colliding else None,
            terms=setup.terms,
        )
        if relaxation.stats.overflows:
            count = mended.get("overflows", 0) + relaxation.stats.overflows
            mended["overflows"] = count
        lists = relaxation.lists
        particles, membrane = relaxation.state
        assert particles is not None
        result = relaxation.result
        if result is Result.CONVERGED and _flew_apart(state.particles, particles):
            result = Result.EVAPORATED
        converged = result is Result.CONVERGED
        if converged and finder is not None and not colliding:
            assert membrane is not None
            if math.isfinite(finder.gap(get(membrane.vertices))):
                colliding, attempts = True, list(ATTEMPTS)
                mended["collisions_joined"] = 1
                continue
        if converged or not attempts:
            found = State(particles, membrane, state.frame)
            return EquilibrationResult(found, result, relaxation, colliding, mended)
        name = f"retried_after_{result.name.lower()}"
        mended[name] = mended.get(name, 0) + 1


def collision_finder(setup: Setup, now: GrowthState) -> CollisionFinder | None:
    """Return the collision broad phase of the state; None without a membrane."""
    membrane = now.state.membrane
    if membrane is None:
        return None
    return CollisionFinder.of(membrane, now.organ_index, now.walls, setup.parameters)


def equilibrate_from(
    setup: Setup, now: GrowthState, start: Positions, *, colliding: bool
) -> EquilibrationResult:
    """Find the equilibrium in the basin of a recorded one.

    Args:
        setup: of the growth.
        now: after the recorded division or enlargement.
        start: the recorded equilibrium.
        colliding: whether the collision energy was part of it.
    """
    state = now.state
    relaxation = relax(
        *put_positions(state.particles, state.membrane, start),
        parameters=setup.parameters,
        tolerance=setup.tolerance,
        lists=now.lists,
        collide=collision_finder(setup, now) if colliding else None,
        terms=setup.terms,
    )
    particles, membrane = relaxation.state
    assert particles is not None
    found = State(particles, membrane, state.frame)
    return EquilibrationResult(found, relaxation.result, relaxation, colliding)


def _alone(points: Float[np.ndarray, "n 3"]) -> int:
    """Count particles without a neighbour within the cutoff, of two at least."""
    return kernels.loops("company").alone(np.asarray(points, float), CUTOFF)


JUMP, LEAST_JUMP = 1.2, 0.25
"""Largest factor by which a relaxation after a division may enlarge the radius of
gyration; increases below the second number (r0) are always allowed."""


LARGEST_SHARE_LOST = 0.02
"""Largest share of the particles that may lose all of their neighbours."""


def _flew_apart(before: Particles, after: Particles) -> bool:
    """Return whether the cluster evaporated: as a whole, or single particles.

    It is so if the radius of gyration jumped, or if many particles lost all of their
    neighbours. A relaxation with too long steps moves particles out of the range of
    the pair potential, where no force is left and the state seems to be at rest.
    """
    alive = get(before.alive)
    old, new = (get(particles.position)[alive] for particles in (before, after))
    if len(new) < 2:
        return False
    radius = [float(np.sqrt(points.var(axis=0).sum())) for points in (old, new)]
    jumped = radius[1] > max(JUMP * radius[0], radius[0] + LEAST_JUMP)
    return jumped or _lost(old, new)


def _lost(old: Float[np.ndarray, "n 3"], new: Float[np.ndarray, "n 3"]) -> bool:
    """Return whether many more particles are isolated than before.

    The limit of the increase is `LARGEST_SHARE_LOST`. In large systems only particles
    near those that moved are counted: the number can change only there. The number
    before is counted only if that after is above the limit.
    """
    most = LARGEST_SHARE_LOST * len(new)
    if len(new) <= FEW:
        alone = _alone(new)
        return alone > most and alone - _alone(old) > most
    moved = np.any(old != new, axis=1)
    seeds = np.concatenate([old[moved], new[moved]])
    near = near_seeds(old, seeds, CUTOFF) | near_seeds(new, seeds, CUTOFF) | moved
    alone = _count_alone(new, near)
    return alone > most and alone - _count_alone(old, near) > most


def _count_alone(points: Float[np.ndarray, "n 3"], some: Bool[np.ndarray, " n"]) -> int:
    """Count those of some points that have no neighbour within the cutoff."""
    around = near_seeds(points, points[some], CUTOFF)
    if around.sum() < 2:
        return int(some.sum())
    distance, _ = KDTree(points[around]).query(points[some], k=2)
    return int(np.count_nonzero(distance[:, 1] >= CUTOFF))
