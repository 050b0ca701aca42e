"""Adapt tissues and surface (paper §4), and mend what goes wrong with it.

An equilibrium is accepted if the relaxation converged and did not throw particles out.
Otherwise it is tried again from where it started, with shorter steps. Where sheets of
the surface come into each other's range, the energy of their collision joins in, from
then on in this growth: as long as none do it is zero, and a growth does not pay for it.
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
        result: CONVERGED, or what the last attempt failed with.
        relaxation: the last one.
        colliding: whether the collision energy is part of it.
        mended: how often what was mended, by name.
    """

    state: State
    result: Result
    relaxation: Relaxation
    colliding: bool
    mended: dict[str, int] = field(default_factory=dict)


def equilibrate(
    setup: Setup, now: GrowthState, *, colliding: bool
) -> EquilibrationResult:
    """2. and 3. Adapt tissues and surface: find their common equilibrium.

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
    """Return what finds sheets that may meet; None without a membrane."""
    membrane = now.state.membrane
    if membrane is None:
        return None
    return CollisionFinder.of(membrane, now.organ_index, now.walls, setup.parameters)


def equilibrate_from(
    setup: Setup, now: GrowthState, start: Positions, *, colliding: bool
) -> EquilibrationResult:
    """Find the equilibrium whose basin a recorded one is in.

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
    """Number of particles, two at least, without a neighbour that they feel."""
    return kernels.loops("company").alone(np.asarray(points, float), CUTOFF)


JUMP, LEAST_JUMP = 1.2, 0.25
"""Factor of its radius of gyration, and at least so many r0, by which no relaxation
after a division enlarges the whole."""


LARGEST_SHARE_LOST = 0.02
"""Of the particles, which may lose all of their neighbours."""


def _flew_apart(before: Particles, after: Particles) -> bool:
    """Whether particles that had neighbours lost them all, or the whole flew apart.

    A relaxation with too long steps throws particles out of each other's reach, where
    no force is left and everything seems to be at rest.
    """
    alive = get(before.alive)
    old, new = (get(particles.position)[alive] for particles in (before, after))
    if len(new) < 2:
        return False
    radius = [float(np.sqrt(points.var(axis=0).sum())) for points in (old, new)]
    jumped = radius[1] > max(JUMP * radius[0], radius[0] + LEAST_JUMP)
    return jumped or _lost(old, new)


def _lost(old: Float[np.ndarray, "n 3"], new: Float[np.ndarray, "n 3"]) -> bool:
    """Whether many more have no neighbour than had none.

    Of very many they are counted near those that moved: only there can it be another
    number. What was before is counted only where they are many now.
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
    """How many of some of the points have no neighbour."""
    around = near_seeds(points, points[some], CUTOFF)
    if around.sum() < 2:
        return int(some.sum())
    distance, _ = KDTree(points[around]).query(points[some], k=2)
    return int(np.count_nonzero(distance[:, 1] >= CUTOFF))
