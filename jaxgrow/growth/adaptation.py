"""Adapt tissues and surface (paper §4), and mend what goes wrong with it.

An equilibrium is accepted if the relaxation converged and did not throw particles out.
Otherwise it is tried again from where it started, with shorter steps. Where sheets of
the surface come into each other's range, the energy of their collision joins in, from
then on in this growth: as long as none do it is zero, and a growth does not pay for it.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from jaxgrow import kernels
from jaxgrow.energy.a2 import CUTOFF
from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.problem import ExtraTerms, LARGEST_STEP
from jaxgrow.equilibrium.relax import relax, Relaxation
from jaxgrow.growth.collision_broad_phase import CollisionFinder
from jaxgrow.mesh.collision_mesh import Walls
from jaxgrow.neighbors.verlet_list import FEW
from jaxgrow.neighbors.within_radius import near_seeds
from jaxgrow.runtime.results import Result
from jaxgrow.state import Particles, State
from jaxgrow.transfer.device import get


ATTEMPTS = ((LARGEST_STEP, 1500), (LARGEST_STEP / 4, 4000))
"""Longest step (r0) and bound on the steps of each method, attempt after attempt."""


@dataclass(frozen=True, eq=False)
class Laws:
    """What all equilibria of a growth have in common.

    Attributes:
        parameters: of the energy.
        tolerance: largest force left, in F(0).
        collisions: whether sheets of the surface repel each other: "on", "off", or
            "auto" for as soon as they meet.
        walls: the rest of the organ; None without one.
        terms: of the energy, besides those of jaxgrow.
    """

    parameters: Parameters
    tolerance: float
    collisions: str = "auto"
    walls: Walls | None = None
    terms: ExtraTerms = ()


@dataclass(frozen=True, eq=False)
class Adapted:
    """Outcome of `adapt_tissue_and_surface`.

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


def adapt_tissue_and_surface(
    state: State,
    organ_index: Int[np.ndarray, " m"],
    laws: Laws,
    lists: Lists | None,
    *,
    colliding: bool,
) -> Adapted:
    """2. and 3. Adapt tissues and surface: their common equilibrium.

    Args:
        state: after a division; the springs were reset in it.
        organ_index: of each vertex alive the organ's vertex that it is, or -1.
        laws: energy and tolerance.
        lists: of an earlier relaxation.
        colliding: whether sheets have met before.
    """
    finder = None
    if state.membrane is not None and laws.collisions != "off":
        finder = CollisionFinder.of(
            state.membrane, organ_index, laws.walls, laws.parameters
        )
    colliding = finder is not None and (colliding or laws.collisions == "on")
    mended: dict[str, int] = {}
    attempts = list(ATTEMPTS)
    while True:
        largest, max_steps = attempts.pop(0)
        relaxation = relax(
            state.particles,
            state.membrane,
            parameters=laws.parameters,
            tolerance=laws.tolerance,
            max_steps=max_steps,
            largest_step=largest,
            lists=lists,
            collide=finder if colliding else None,
            terms=laws.terms,
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
            adapted = State(particles, membrane, state.frame)
            return Adapted(adapted, result, relaxation, colliding, mended)
        name = f"retried_after_{result.name.lower()}"
        mended[name] = mended.get(name, 0) + 1


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
