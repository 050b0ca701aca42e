"""Compiled loop of a relaxation: evaluate, learn, propose, bound, move."""

import itertools
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from jaxgrow.equilibrium.lists import Lists, Outgrown
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.numerics.guards import safe_norm
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Nodes


@runtime_checkable
class Minimiser(Protocol):
    """Method that turns forces into displacements; see `LBFGS` and `FIRE`."""

    def init(self, force: Float[Array, "d 3"]) -> PyTree:
        """Return the memory before the first step."""
        ...

    def propose(
        self, memory: PyTree, force: Float[Array, "d 3"]
    ) -> tuple[Float[Array, "d 3"], PyTree]:
        """Return the displacement to try, in r0, and the memory."""
        ...

    def learn(
        self,
        memory: PyTree,
        displacement: Float[Array, "d 3"],
        before: Float[Array, "d 3"],
        after: Float[Array, "d 3"],
        made: Bool[Array, ""],
    ) -> PyTree:
        """Update the memory after a displacement, if it was made."""
        ...


class Descent(eqx.Module):
    """State of a descent, and the outcome of every relaxation method.

    Attributes:
        nodes: positions accepted last.
        force: at these positions, on all nodes.
        lists: the current lists; valid there, unless one overflowed.
        memory: of the minimiser; None for a method that has none.
        residual: largest force on a free node, in F(0).
        steps: number of steps made, with one evaluation of forces more; of Newton's
            method the Hessian products, of Gauss-Seidel the sweeps.
        rebuilds: number of list rebuilds.
        code: of the `Result`; STEP_LIMIT while it runs, or if the tolerance was not
            reached.
    """

    nodes: Nodes
    force: Nodes
    lists: Lists
    memory: PyTree
    residual: Float[Array, ""]
    steps: Int[Array, ""]
    rebuilds: Int[Array, ""]
    code: Int[Array, ""]


class _Now(eqx.Module):
    """State of a `Descent` without its lists, with the next trial.

    Attributes:
        nodes, force, residual, steps, code: as there; -1 steps before the first
            evaluation.
        memory: of the minimiser after it proposed the step.
        trial: positions to evaluate next.
        step: the displacement to them, all 0 before the first step.
        outgrown: lists that are not valid there.
    """

    nodes: Nodes
    force: Nodes
    memory: PyTree
    residual: Float[Array, ""]
    steps: Int[Array, ""]
    code: Int[Array, ""]
    trial: Nodes
    step: Float[Array, "d 3"]
    outgrown: Outgrown


def blank_memory(problem: Problem, minimiser: Minimiser) -> PyTree:
    """Return the memory of a descent that has not begun."""
    return minimiser.init(_rows(jax.tree.map(jnp.zeros_like, problem.nodes())))


def _rows(nodes: Nodes) -> Float[Array, "d *_"]:
    """Concatenate all nodes in one array."""
    return jnp.concatenate(jax.tree.leaves(nodes))


def _like(rows: Float[Array, "d 3"], nodes: Nodes) -> Nodes:
    """Split one array into nodes."""
    leaves, structure = jax.tree.flatten(nodes)
    ends = list(itertools.accumulate(leaf.shape[0] for leaf in leaves))
    return jax.tree.unflatten(structure, jnp.split(rows, ends[:-1]))


def _bounded(
    step: Float[Array, "d 3"], limit: Float[Array, " d"], largest: Scalar
) -> Float[Array, "d 3"]:
    """Scale a step to a longest row, then clip each row to its limit."""
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

    Stops early, with the last valid positions, when a list overflows, a force is not
    finite, or a node has no clearance at all, and when the host must rebuild the
    collision list.

    Two loops: the inner one steps with lists that do not change, until a step leads to
    where they are not valid; the outer one rebuilds them. In a single loop the lists
    would be carried, and copied, through every step.

    Args:
        problem: the energy, and the start.
        lists: valid for the start.
        minimiser: the method.
        tolerance: largest force allowed on a free node, in F(0).
        max_steps: bound on the number of steps.
        largest: longest displacement of a node in one step, in r0.
        memory: of an earlier descent that is continued; None for a new one.
    """
    free = _rows(problem.free())

    def judge(residual: Array, lists: Lists) -> Array:
        code = jnp.where(
            residual <= tolerance, Result.CONVERGED.code, Result.STEP_LIMIT.code
        )
        code = jnp.where(jnp.isfinite(residual), code, Result.NON_FINITE.code)
        return jnp.where(lists.overflow, Result.OVERFLOW.code, code)

    def unfinished(now: _Now) -> Array:
        return (now.code == Result.STEP_LIMIT.code) & (now.steps < max_steps)

    def advance(lists: Lists, now: _Now) -> _Now:
        """Evaluate the trial, accept it, update the memory, and propose the next."""
        first = now.steps < 0
        forces, bound = problem.forces_and_bound(now.trial, lists, largest)
        before, force = free * _rows(now.force), free * _rows(forces)
        residual = jnp.max(safe_norm(force))
        code = judge(residual, lists)
        failed = (code == Result.OVERFLOW.code) | (code == Result.NON_FINITE.code)

        def unless(wrong: Array, new: PyTree, old: PyTree) -> PyTree:
            return jax.tree.map(lambda a, b: jnp.where(wrong, b, a), new, old)

        # the memory is large and carried once, so that it is written in place
        made = ~(first | failed)
        memory = minimiser.learn(now.memory, now.step, before, force, made)
        step, memory = minimiser.propose(memory, force)
        uphill = jnp.sum(step * force) <= 0
        step = jnp.where(uphill, 0.05 * force, step)
        limit = _rows(bound)
        stuck = jnp.any((limit == 0) & (free[:, 0] > 0))
        stuck &= code == Result.STEP_LIMIT.code
        step = _bounded(step, limit, largest)
        nodes = unless(failed, now.trial, now.nodes)
        trial = jax.tree.map(jnp.add, nodes, _like(step, nodes))
        return _Now(
            nodes,
            unless(failed & ~first, forces, now.force),
            memory,
            jnp.where(failed & ~first, now.residual, residual),
            now.steps + 1,
            jnp.where(stuck, Result.ON_MEMBRANE.code, code),
            trial,
            step,
            problem.outgrown(trial, lists),
        )

    def relist(at: tuple[_Now, Lists, Array]) -> tuple[_Now, Lists, Array]:
        now, lists, rebuilds = at
        rebuilds += now.outgrown.any().astype(int)
        lists = problem.rebuilt(now.trial, lists, now.outgrown)
        now = eqx.tree_at(lambda n: n.outgrown, now, Outgrown.nothing())
        now = jax.lax.while_loop(
            lambda now: unfinished(now) & ~now.outgrown.any(),
            lambda now: advance(lists, now),
            now,
        )
        return now, lists, rebuilds

    nodes = problem.nodes()
    nothing = jax.tree.map(jnp.zeros_like, nodes)
    memory = minimiser.init(_rows(nothing)) if memory is None else memory
    start = _Now(
        nodes,
        nothing,
        memory,
        jnp.full((), jnp.inf, problem.dtype),
        jnp.full((), -1),
        jnp.asarray(Result.STEP_LIMIT.code),
        nodes,
        _rows(nothing),
        Outgrown.nothing(),
    )
    now, lists, rebuilds = jax.lax.while_loop(
        lambda at: unfinished(at[0]) & ~at[0].outgrown.of_host,
        relist,
        (start, lists, jnp.zeros((), int)),
    )
    return Descent(
        now.nodes,
        now.force,
        lists.with_stale(unfinished(now) & now.outgrown.of_host),
        now.memory,
        now.residual,
        now.steps,
        rebuilds,
        now.code,
    )
