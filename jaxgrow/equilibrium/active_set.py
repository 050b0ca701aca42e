"""Relaxation of the part that is disturbed, while the rest stays where it is.

A division disturbs what is around it: forces that it leaves on a shell at distance R
fall as about R^-2.5: in a dense ball 800 particles are enough for 1e-3 F(0), and 11 000
for 1e-4, of however many there are. So nodes around those that feel more than
the tolerance are relaxed in a problem of their own, whose border is held; then the
forces on *everything* are evaluated, and the part is enlarged by what feels too much
now, until nothing does. The end is judged as that of every method: by the largest force
on any free node.
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
from jaxgrow.equilibrium.methods import Found, Limits, run_stage, Stage
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
"""Nodes from which on `relax` tries this by itself: a smaller problem is relaxed as a
whole in the time that it takes to cut out parts of it."""

RADIUS = 4.0
"""What is within this distance (r0) of a node with too large a force may move."""

LITTLE = 2.0
"""Where no force is larger than so many tolerances, half of the distance does."""

SLIGHT = 1e-2
"""Largest force, in F(0), by which nodes do not go far."""

MARGINS = 0.25, 1.0
"""How far a node may go, in r0, before it could meet what was not cut out with it:
where only slight forces are left, and in any case."""

INSIDE = 0.85
"""How far below the tolerance a part is relaxed, as a share of it: what is relaxed
later disturbs it again a little."""

SMALL_SHARE = 0.25
"""Of what may move; where no more than so much of it is around what feels too much, as
at the border of what moved before, only that is relaxed next."""

LARGEST_SHARE = 0.25
"""Of all nodes, beyond which the whole is relaxed instead."""


class Chosen(NamedTuple):
    """What is relaxed in a round.

    Attributes:
        moving: what may move.
        moved: the same with what could move before.
    """

    moving: Mask
    moved: Mask

    @classmethod
    def nothing(cls, problem: Problem) -> "Chosen":
        """Before the first round."""
        return cls(none_of(problem), none_of(problem))

    def following(self, near: Mask, free: Mask) -> "Chosen | None":
        """The next round; None where only a relaxation of the whole goes on.

        All that moved so far moves again, but for a little around the border: that
        moves alone, and if this disturbs the rest, all of it moves next.

        Args:
            near: what is around nodes that feel too much.
            free: what may move at all.
        """
        moved = near.joined(self.moved)
        grows = moved.size > self.moved.size
        alone = grows and near.size <= SMALL_SHARE * moved.size
        again = self.moving.size < self.moved.size
        if moved.size > LARGEST_SHARE * free.size or not (grows or again):
            return None
        return Chosen(near if alone else moved, moved)


class Judged(NamedTuple):
    """What everything feels.

    Attributes:
        force: on every node.
        size: of it, where it counts.
        lists: contacts as they were found for it, and the pair forces to be kept; the
            neighbours of all particles are listed anew only where all are asked for.
    """

    force: Nodes
    size: Sizes
    lists: Lists


@eqx.filter_jit
def _forces(problem: Problem, lists: Lists) -> Nodes:
    return problem.forces(problem.nodes(), lists)


def _judge(problem: Problem, lists: Lists, free: Mask) -> Judged:
    """The force on every node: of pairs by what is another than when they were kept."""
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
    """Whether it is known how far all of its energies act."""
    own = all(isinstance(term, MembraneTerm) for term in problem.terms)
    return own and not problem.functions


def may_pay(problem: Problem) -> bool:
    """Whether a problem is large enough to look for the part that is disturbed."""
    if not is_local(problem):
        return False
    count = 0
    if problem.particles is not None:
        count += problem.particles.position.shape[0]
    if problem.membrane is not None:
        count += problem.membrane.vertices.shape[0]
    return count >= FEWEST


def relax_locally(problem: Problem, lists: Lists, limits: Limits) -> Found:
    """Relax the part around too large forces, larger and larger, by L-BFGS.

    Args:
        problem: without collisions.
        lists: that fit it.
        limits: tolerance, steps and longest step of every round.

    Returns:
        The nodes and the forces on all of them; STEP_LIMIT if the part became too large
        a share of the whole, or could not be relaxed by itself.
    """
    within = limits._replace(tolerance=INSIDE * limits.tolerance)
    stage = Stage("lbfgs", LBFGS(), within.tolerance)
    chosen = Chosen.nothing(problem)
    steps = rebuilds = overflows = 0
    free = able(problem)
    judged = _judge(problem, lists, free)
    while True:
        residual = judged.size.largest
        ended = Found(
            problem.nodes(),
            judged.force,
            judged.lists,
            Result.CONVERGED if residual <= limits.tolerance else Result.STEP_LIMIT,
            residual,
            steps,
            rebuilds,
            overflows,
        )
        if not residual > limits.tolerance:  # NaN too: the whole tells what it is
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
    """Lists of a part, with room as in those of the whole."""
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
    """The longest way that a node went, in r0."""
    return float(_farthest_move(new, old))
