"""Relaxation of the part that is disturbed, while the rest stays where it is.

A division disturbs what is around it: forces that it leaves on a shell at distance R
fall as about R^-2.5: in a dense ball 800 particles are enough for 1e-3 F(0), and 11 000
for 1e-4, of however many there are. So nodes around those that feel more than
the tolerance are relaxed in a problem of their own, whose border is held; then the
forces on *everything* are evaluated, and the part is enlarged by what feels too much
now, until nothing does. The end is judged as that of every method: by the largest force
on any free node.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.equilibrium.lbfgs import LBFGS
from jaxgrow.equilibrium.listing import allocate_contacts, allocate_lists, prepared
from jaxgrow.equilibrium.part import (
    count_free,
    cut,
    enlarged_by,
    MARGIN,
    none_of,
    Part,
)
from jaxgrow.equilibrium.problem import Lists, Problem
from jaxgrow.equilibrium.stages import Found, Limits, run_stage, Stage
from jaxgrow.neighbors import part_of
from jaxgrow.numerics import safe_norm
from jaxgrow.results import Result
from jaxgrow.state import Nodes


FEWEST = 16_384
"""Nodes from which on `relax` tries this by itself: a smaller problem is relaxed as a
whole in the time that it takes to cut out parts of it."""

RADIUS = 4.0
"""What is within this distance (r0) of a node with too large a force may move."""

LARGEST_SHARE = 0.25
"""Of all nodes, beyond which the whole is relaxed instead."""


@eqx.filter_jit
def _judge(problem: Problem, lists: Lists) -> tuple[Nodes, Nodes]:
    """The force on every node, and how large it is where it counts."""
    force = problem.forces(problem.nodes(), lists)
    size = jax.tree.map(lambda f, on: safe_norm(f) * on[:, 0], force, problem.free())
    return force, size


def may_pay(problem: Problem) -> bool:
    """Whether a problem is large enough to look for the part that is disturbed."""
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
    # each round goes below the tolerance: what comes later disturbs it again a little
    within = limits._replace(tolerance=0.5 * limits.tolerance)
    stage = Stage("lbfgs", LBFGS(), within.tolerance)
    moving, steps, rebuilds, overflows = none_of(problem), 0, 0, 0
    limit = LARGEST_SHARE * count_free(problem)
    lists = prepared(problem, lists, None)
    force, size = _judge(problem, lists)
    while True:
        residual = max(float(jnp.max(each)) for each in jax.tree.leaves(size))
        ended = Found(
            problem.nodes(),
            force,
            lists,
            Result.CONVERGED if residual <= limits.tolerance else Result.STEP_LIMIT,
            residual,
            steps,
            rebuilds,
            overflows,
        )
        if not residual > limits.tolerance:  # NaN too: the whole tells what it is
            return ended
        enlarged = enlarged_by(problem, moving, size, limits.tolerance, RADIUS)
        if enlarged.size > limit or enlarged.size == moving.size:
            return ended
        moving = enlarged
        part = cut(problem, moving)
        found = run_stage(
            part.problem, _lists_of(part, lists), stage, within, None, None
        )
        steps, rebuilds = steps + found.steps, rebuilds + found.rebuilds
        overflows += found.overflows
        whole = part.put(found.nodes, problem.nodes())
        sound = found.result is Result.CONVERGED
        if not sound or _farthest(whole, problem.nodes()) > MARGIN:
            return ended._replace(steps=steps, rebuilds=rebuilds, overflows=overflows)
        problem = problem.at(whole)
        lists = prepared(problem, lists, None)
        force, size = _judge(problem, lists)


def _lists_of(part: Part, lists: Lists) -> Lists:
    """Lists of a part, its neighbours from those of the whole."""
    if part.problem.particles is None or lists.neighbors is None:
        return allocate_lists(part.problem)
    position = part.problem.particles.position
    neighbors = part_of(lists.neighbors, part.particles, position)
    return allocate_contacts(part.problem, neighbors)


@jax.jit
def _farthest_move(new: Nodes, old: Nodes) -> Float[Array, ""]:
    far = jax.tree.map(lambda a, b: jnp.max(safe_norm(a - b)), new, old)
    return jnp.max(jnp.stack(jax.tree.leaves(far)))


def _farthest(new: Nodes, old: Nodes) -> float:
    """The longest way that a node went, in r0."""
    return float(_farthest_move(new, old))
