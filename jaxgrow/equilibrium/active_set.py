"""Relaxation of the disturbed part (active set), with the rest held.

A division disturbs its surroundings: the forces that it leaves on a shell at distance R
fall as about R^-2.5. In a dense ball 800 particles are enough for 1e-3 F(0), and 11 000
for 1e-4, whatever the total number. So the nodes around those with a force above the
tolerance are relaxed in a problem of their own, whose border is held; then the forces
on *all* nodes are evaluated, and the part is enlarged by those with too large a force
now, until there is none. The criterion at the end is that of every method: the largest
force on any free node.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.energy.term import MembraneTerm
from jaxgrow.equilibrium.force_cache import evaluated, renewed
from jaxgrow.equilibrium.lbfgs import LBFGS
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.loops import with_loops
from jaxgrow.equilibrium.methods import Limits, MethodResult, run_stage, Stage
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import (
    allocate_contacts,
    allocate_lists,
    prepared,
    with_contacts,
)
from jaxgrow.equilibrium.subproblem import (
    able,
    around,
    cut,
    Mask,
    none_of,
    Part,
    Sizes,
)
from jaxgrow.neighbors.verlet_list import of_part
from jaxgrow.numerics.guards import safe_norm
from jaxgrow.runtime.results import Result
from jaxgrow.state import Nodes


FEWEST = 16_384
"""Number of nodes from which on `relax` uses this method automatically: a smaller
problem is relaxed as a whole in the time that it takes to cut out parts of it."""

RADIUS = 4.0
"""Nodes within this distance (r0) of one with too large a force may move."""

LITTLE = 2.0
"""Largest force, in tolerances, up to which half of `RADIUS` is used."""

SLIGHT = 1e-2
"""Largest force, in F(0), up to which the smaller of the `MARGINS` is tried."""

MARGINS = 0.25, 1.0
"""Distance that a node may move, in r0, before it could meet nodes outside the part:
for slight forces, and for all."""

INSIDE = 0.85
"""Tolerance of a part over that of the whole: parts that are relaxed later disturb it
slightly."""

SMALL_SHARE = 0.25
"""Share of the moving nodes: if at most so many are around those with too large a
force, as at the border of the part, only these are relaxed next."""

LARGEST_SHARE = 0.25
"""Share of all free nodes beyond which the whole is relaxed instead."""


class Chosen(NamedTuple):
    """Active set of a round.

    Attributes:
        moving: nodes that may move in this round.
        moved: these and those that could move in earlier rounds.
    """

    moving: Mask
    moved: Mask

    @classmethod
    def nothing(cls, problem: Problem) -> "Chosen":
        """Return the empty active set, before the first round."""
        return cls(none_of(problem), none_of(problem))

    def following(self, near: Mask, free: Mask) -> "Chosen | None":
        """Return the next active set; None if the whole must be relaxed.

        All nodes that moved so far move again, except if only a few around the border
        are added: those move alone, and if this disturbs the rest, all move next.

        Args:
            near: nodes around those with too large a force.
            free: nodes that may move at all.
        """
        moved = near.joined(self.moved)
        grows = moved.size > self.moved.size
        alone = grows and near.size <= SMALL_SHARE * moved.size
        again = self.moving.size < self.moved.size
        if moved.size > LARGEST_SHARE * free.size or not (grows or again):
            return None
        return Chosen(near if alone else moved, moved)


class Judged(NamedTuple):
    """Forces on all nodes, with the lists that they were found by.

    Attributes:
        force: on every node.
        size: its norm, on free nodes.
        lists: contacts that are valid for it, and the cached pair forces; the
            neighbour list is rebuilt only if the forces on all particles were
            evaluated.
    """

    force: Nodes
    size: Sizes
    lists: Lists


@eqx.filter_jit
def _forces(problem: Problem, lists: Lists) -> Nodes:
    return problem.forces(problem.nodes(), lists)


def _judge(problem: Problem, lists: Lists, free: Mask) -> Judged:
    """Compute the forces on all nodes, with cached pair forces updated."""
    kept = None
    if problem.particles is None:
        lists = with_contacts(problem, lists)
    else:
        kept = renewed(lists.kept, problem.particles, problem.parameters)
        if kept is None:
            lists = prepared(problem, lists, None)
            assert lists.neighbors is not None
            kept = evaluated(problem.particles, lists.neighbors, problem.parameters)
        else:
            lists = with_contacts(problem, lists)
    if problem.membrane is None:
        assert kept is not None
        force = Nodes(kept.force, None)
    else:
        others = Lists(None, lists.contacts)
        force = _forces(with_loops(problem, others), others)
        if kept is not None:
            assert force.particles is not None
            force = Nodes(force.particles + kept.force, force.vertices)
    lists = Lists(lists.neighbors, lists.contacts, lists.candidates, kept=kept)
    return Judged(force, Sizes.of(force, free), lists)


def is_local(problem: Problem) -> bool:
    """Return whether the range of all energies is known."""
    own = all(isinstance(term, MembraneTerm) for term in problem.terms)
    return own and not problem.functions


def may_pay(problem: Problem) -> bool:
    """Return whether a problem is large enough for local relaxation."""
    if not is_local(problem):
        return False
    count = 0
    if problem.particles is not None:
        count += problem.particles.position.shape[0]
    if problem.membrane is not None:
        count += problem.membrane.vertices.shape[0]
    return count >= FEWEST


def relax_locally(problem: Problem, lists: Lists, limits: Limits) -> MethodResult:
    """Relax a growing part around too large forces, by L-BFGS.

    Args:
        problem: without collisions.
        lists: of matching shapes.
        limits: tolerance, steps and longest step of every round.

    Returns:
        The nodes and the forces on all of them; STEP_LIMIT if the part became too large
        a share of the whole, or could not be relaxed separately.
    """
    within = limits._replace(tolerance=INSIDE * limits.tolerance)
    stage = Stage("lbfgs", LBFGS(), within.tolerance)
    chosen = Chosen.nothing(problem)
    steps = rebuilds = overflows = 0
    free = able(problem)
    judged = _judge(problem, lists, free)
    while True:
        residual = judged.size.largest
        ended = MethodResult(
            problem.nodes(),
            judged.force,
            judged.lists,
            Result.CONVERGED if residual <= limits.tolerance else Result.STEP_LIMIT,
            residual,
            steps,
            rebuilds,
            overflows,
        )
        if not residual > limits.tolerance:  # NaN too: the whole diagnoses it
            return ended
        large = judged.size.above(limits.tolerance)
        little = residual <= LITTLE * limits.tolerance
        near = around(problem, large, free, RADIUS / 2 if little else RADIUS)
        chosen = chosen.following(near, free)
        if chosen is None:
            return ended
        for margin in MARGINS if residual <= SLIGHT else MARGINS[-1:]:
            part = cut(problem, chosen.moving, margin)
            own = _lists_of(part, judged.lists)
            found = run_stage(part.problem, own, stage, within, None, None)
            steps, rebuilds = steps + found.steps, rebuilds + found.rebuilds
            overflows += found.overflows
            went = _farthest(found.nodes, part.problem.nodes())
            if found.result is Result.CONVERGED and went <= margin:
                break
        else:
            return ended._replace(steps=steps, rebuilds=rebuilds, overflows=overflows)
        problem = problem.at(part.put(found.nodes, problem.nodes()))
        judged = _judge(problem, judged.lists, free)


def _lists_of(part: Part, lists: Lists) -> Lists:
    """Allocate the lists of a part, with the capacities of the whole's."""
    particles = part.problem.particles
    if particles is None or lists.neighbors is None:
        return allocate_lists(part.problem)
    neighbors = of_part(particles.position, ~particles.free, lists.neighbors)
    return allocate_contacts(part.problem, neighbors)


@jax.jit
def _farthest_move(new: Nodes, old: Nodes) -> Float[Array, ""]:
    far = jax.tree.map(lambda a, b: jnp.max(safe_norm(a - b)), new, old)
    return jnp.max(jnp.stack(jax.tree.leaves(far)))


def _farthest(new: Nodes, old: Nodes) -> float:
    """Return the longest displacement of a node, in r0."""
    return float(_farthest_move(new, old))
