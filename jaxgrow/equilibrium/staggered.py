r"""Staggered relaxation of tissue and surface (the paper's §4), to compare.

"Adapt tissues": the particles are relaxed with the membrane fixed. "Adapt surface": the
forces that they then exert on its vertices accumulate, and the springs are relaxed
under them as dead loads, which do not change while the membrane moves. Both are
repeated.

Its fixed points are the equilibria of particles and membrane together. It converges
only if the membrane is stiffer than the particles that press on it: after a reset of
rest lengths a flat membrane has no linear stiffness out of its plane, and dead loads
move it far away. (At a polyp's division, with springs of 0.04 F(0)/r0, it oscillates by
0.1 r0 without end; with 3 F(0)/r0 and a pretension of 0.5 it is at rest after 23
turns.) If it does not, the result is STEP_LIMIT, however many steps are allowed.

We deviate where the membrane would pass through the particles: in one sweep no vertex
moves farther than its bound, and the particles follow.
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.equilibrium.lbfgs import LBFGS
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.methods import Limits, MethodResult, run_stage, Stage
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import CollisionLister
from jaxgrow.numerics.guards import safe_norm
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Nodes


@eqx.filter_jit
def _largest_on_vertices(problem: Problem, force: Nodes) -> Float[Array, ""]:
    """Return the largest force on a free vertex, in F(0)."""
    _, membrane = problem.both()
    assert force.vertices is not None
    return jnp.max(jnp.where(membrane.free, safe_norm(force.vertices), 0))


@eqx.filter_jit
def _loaded(problem: Problem, lists: Lists, force: Nodes) -> Problem:
    """Return the membrane alone, with the particles' forces as dead loads.

    Args:
        problem: of both.
        lists: of the membrane alone.
        force: of all terms, on all nodes.
    """
    alone = problem.but(particles=None, loops=None)
    own = alone.forces(alone.nodes(), lists).vertices
    assert own is not None
    assert force.vertices is not None
    dead = force.vertices - own
    load = dead if problem.load is None else problem.load + dead
    return alone.but(load=load)


@eqx.filter_jit
def _towards(
    problem: Problem, lists: Lists, wanted: Nodes, largest: Scalar
) -> tuple[Problem, Float[Array, ""]]:
    """Move vertices towards their targets, each by no more than its bound.

    Returns:
        The problem after that, and the smallest bound of a vertex that moves.
    """
    nodes = problem.nodes()
    bound = problem.bound(nodes, lists, largest).vertices
    assert bound is not None
    assert nodes.vertices is not None
    assert wanted.vertices is not None
    move = wanted.vertices - nodes.vertices
    length = safe_norm(move)
    scale = jnp.minimum(1, bound / jnp.where(length > 0, length, 1))
    moved = Nodes(nodes.particles, nodes.vertices + scale[:, None] * move)
    return problem.at(moved), jnp.min(jnp.where(length > 0, bound, jnp.inf))


def _pinned(problem: Problem) -> Problem:
    """Return the problem with a membrane that does not move."""
    _, membrane = problem.both()
    everything = jnp.ones_like(membrane.pinned)
    return eqx.tree_at(lambda p: p.membrane.pinned, problem, everything)


def stagger(
    problem: Problem,
    lists: Lists,
    limits: Limits,
    collide: CollisionLister | None = None,
    observe: Callable[[Nodes], None] | None = None,
) -> MethodResult:
    """Relax particles and membrane in turns, until both are at rest.

    Args:
        problem: of particles and membrane.
        lists: of matching shapes.
        limits: tolerance of each part and of both, steps of all parts together, and
            longest displacement of a vertex in a sweep.
        collide: lists what the membrane may collide with.
        observe: called with the positions after every sweep.
    """

    def relax_part(part: Problem, lists: Lists) -> MethodResult:
        stage = Stage("lbfgs", LBFGS(), limits.tolerance)
        left = limits._replace(max_steps=limits.max_steps - steps)
        return run_stage(part, lists, stage, left, collide, None)

    steps = rebuilds = overflows = 0
    longest = jnp.asarray(limits.largest_step, problem.dtype)
    while True:
        tissue = relax_part(_pinned(problem), lists)
        problem, lists = problem.at(tissue.nodes), tissue.lists
        steps += tissue.steps
        rebuilds += tissue.rebuilds
        overflows += tissue.overflows
        on_vertices = float(_largest_on_vertices(problem, tissue.force))
        residual = max(tissue.residual, on_vertices)
        if observe is not None:
            observe(tissue.nodes)
        result = tissue.result
        if result is Result.CONVERGED and not residual <= limits.tolerance:
            result = Result.STEP_LIMIT
            if steps < limits.max_steps:
                own = Lists(None, None).with_collisions(
                    lists.collisions, lists.encounters
                )
                loaded = _loaded(problem, own, tissue.force)
                surface = relax_part(loaded, own)
                steps += surface.steps
                moved, room = _towards(problem, lists, surface.nodes, longest)
                if room == 0:
                    result = Result.ON_MEMBRANE
                elif surface.result not in (Result.CONVERGED, Result.STEP_LIMIT):
                    result = surface.result
                elif steps < limits.max_steps:
                    problem = moved
                    continue
        return MethodResult(
            tissue.nodes,
            tissue.force,
            lists,
            result,
            residual,
            steps,
            rebuilds,
            overflows,
        )
