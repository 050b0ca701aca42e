"""The compiled loop of a relaxation: propose, bound, move, list, evaluate, learn."""

import itertools
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PyTree

from jaxgrow.equilibrium.problem import Lists, Problem
from jaxgrow.numerics import safe_norm
from jaxgrow.results import Result
from jaxgrow.state import Nodes
from jaxgrow.types import Scalar


@runtime_checkable
class Minimiser(Protocol):
    """A method that turns forces into displacements; see `LBFGS` and `FIRE`."""

    def init(self, force: Float[Array, "d 3"]) -> PyTree:
        """The memory before the first step."""
        ...

    def propose(
        self, memory: PyTree, force: Float[Array, "d 3"]
    ) -> tuple[Float[Array, "d 3"], PyTree]:
        """The displacement to try, in r0."""
        ...

    def learn(
        self,
        memory: PyTree,
        displacement: Float[Array, "d 3"],
        before: Float[Array, "d 3"],
        after: Float[Array, "d 3"],
    ) -> PyTree:
        """The memory after a displacement that was made."""
        ...


class Descent(eqx.Module):
    """Where a descent stands.

    Attributes:
        nodes: positions accepted last; the lists are valid for them.
        force: at these positions, on nodes that may not move too.
        lists: the current lists.
        memory: of the minimiser.
        residual: largest force on a free node, in F(0).
        steps: number of steps made; `evaluations` of forces is one more.
        code: of the `Result`; STEP_LIMIT while it runs.
    """

    nodes: Nodes
    force: Nodes
    lists: Lists
    memory: PyTree
    residual: Float[Array, ""]
    steps: Int[Array, ""]
    code: Int[Array, ""]


def blank_memory(problem: Problem, minimiser: Minimiser) -> PyTree:
    """The memory of a descent that has not begun."""
    return minimiser.init(_rows(jax.tree.map(jnp.zeros_like, problem.nodes())))


def _rows(nodes: Nodes) -> Float[Array, "d *_"]:
    """All nodes in one array."""
    return jnp.concatenate(jax.tree.leaves(nodes))


def _like(rows: Float[Array, "d 3"], nodes: Nodes) -> Nodes:
    """One array split into nodes again."""
    leaves, structure = jax.tree.flatten(nodes)
    ends = list(itertools.accumulate(leaf.shape[0] for leaf in leaves))
    return jax.tree.unflatten(structure, jnp.split(rows, ends[:-1]))


def _bounded(
    step: Float[Array, "d 3"], limit: Float[Array, " d"], largest: Scalar
) -> Float[Array, "d 3"]:
    """A step whose longest row is `largest`, cut row by row to its limit."""
    length = safe_norm(step)
    longest = jnp.max(length)
    step = step * jnp.minimum(1, largest / jnp.where(longest > 0, longest, 1))
    length = safe_norm(step)
    cut = jnp.minimum(1, limit / jnp.where(length > 0, length, 1))
    return step * cut[:, None]


def descend(
    problem: Problem,
    lists: Lists,
    minimiser: Minimiser,
    tolerance: Float[Array, ""],
    max_steps: Int[Array, ""],
    largest: Float[Array, ""],
    memory: PyTree = None,
) -> Descent:
    """Move the free nodes until the largest force is at most `tolerance`.

    Stops early, with the last valid positions, when a list no longer fits, a force is
    not finite, or a node has no clearance at all, and when the host has to list the
    collisions anew.

    Args:
        problem: the energy, and the start.
        lists: valid for the start.
        minimiser: the method.
        tolerance: largest force allowed on a free node, in F(0).
        max_steps: bound on the number of steps.
        largest: longest displacement of a node in one step, in r0.
        memory: of an earlier descent that this one goes on from; None for a new one.
    """
    free = _rows(problem.free())

    def measure(force: Nodes, lists: Lists) -> tuple[Array, Array]:
        residual = jnp.max(safe_norm(free * _rows(force)))
        code = jnp.where(
            lists.overflow,
            Result.OVERFLOW.code,
            jnp.where(
                jnp.isfinite(residual),
                jnp.where(
                    residual <= tolerance,
                    Result.CONVERGED.code,
                    Result.STEP_LIMIT.code,
                ),
                Result.NON_FINITE.code,
            ),
        )
        return residual, code

    def running(now: Descent) -> Array:
        unfinished = (now.code == Result.STEP_LIMIT.code) & (now.steps < max_steps)
        return unfinished & ~now.lists.stale

    def move(now: Descent) -> Descent:
        before = free * _rows(now.force)
        step, memory = minimiser.propose(now.memory, before)
        uphill = jnp.sum(step * before) <= 0
        step = jnp.where(uphill, 0.05 * before, step)
        limit = _rows(problem.bound(now.nodes, now.lists, largest))
        stuck = jnp.any((limit == 0) & (free[:, 0] > 0))
        step = _bounded(step, limit, largest)
        nodes = jax.tree.map(jnp.add, now.nodes, _like(step, now.nodes))
        lists = problem.update(nodes, now.lists)
        force = problem.forces(nodes, lists)
        residual, code = measure(force, lists)
        code = jnp.where(stuck, Result.ON_MEMBRANE.code, code)
        memory = minimiser.learn(memory, step, before, free * _rows(force))
        failed = (code == Result.OVERFLOW.code) | (code == Result.NON_FINITE.code)

        def keep(new: PyTree, old: PyTree) -> PyTree:
            return jax.tree.map(lambda a, b: jnp.where(failed, b, a), new, old)

        return Descent(
            keep(nodes, now.nodes),
            keep(force, now.force),
            lists,
            memory,
            jnp.where(failed, now.residual, residual),
            now.steps + 1,
            code,
        )

    nodes = problem.nodes()
    force = problem.forces(nodes, lists)
    residual, code = measure(force, lists)
    start = Descent(
        nodes,
        force,
        lists,
        minimiser.init(free * _rows(force)) if memory is None else memory,
        residual,
        jnp.zeros((), int),
        code,
    )
    return jax.lax.while_loop(running, move, start)
