r"""Newton's method from any start: conjugate gradients in a trust region.

In every iteration the quadratic model of the energy,

.. math:: m(p) = -F \cdot p + \tfrac12\, p \cdot H p,

is reduced by conjugate gradients (Steihaug 1983; Nocedal and Wright 2006, algorithm
7.2) while every node stays within a share of its bound. They end on the boundary of
that region where a direction leads out of it, and along one of negative curvature: so
the method leaves saddles. The step is accepted if the energy falls as the model
predicts, and the share grows and shrinks with the agreement (algorithm 4.1 there).

Near an equilibrium it converges superlinearly, to the rounding of the forces. It takes
more Hessian products than L-BFGS takes steps (for 600 particles, dense and jittered, 55
to 42 until 1e-4 F(0) and 106 to 95 until 1e-8), and a product costs about two force
evaluations: it is useful where curvature is negative.

A saddle is an equilibrium too: if the forces that break its symmetry are below the
tolerance, or of the rounding of the others, this method ends there as all others do.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgrow.equilibrium.descent import Descent
from jaxgrow.equilibrium.hessian_solve import dot, Product
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.products import hessian_product
from jaxgrow.numerics.guards import safe_norm
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Nodes


_COARSEST = 0.5
"""Relative residual at which a linear solve ends far from an equilibrium."""

_ACCEPTED = 0.05
"""Ratio of actual to predicted decrease of the energy from which a step is accepted."""

_SMALLEST_SHARE = 1e-12
"""Share of the bounds below which the iteration stops."""


class _Step(eqx.Module):
    """State of the conjugate gradients, with the step that they end with.

    Attributes:
        p: the step.
        r: residual, F − H p.
        d: direction of the search.
        square: r · r.
        products: Hessian products so far, of all iterations.
        ended: whether p is on the boundary.
    """

    p: Nodes
    r: Nodes
    d: Nodes
    square: Float[Array, ""]
    products: Int[Array, ""]
    ended: Array


class _Now(eqx.Module):
    """State of the descent, with the next trial.

    Attributes:
        best: accepted state.
        energy: there, in F(0) r0.
        share: radius of the trust region, as a share of the nodes' bounds.
        trial: positions to evaluate next.
        foretold: predicted decrease of the energy there, in F(0) r0.
        reached: largest share of a bound that a node moves there.
        certain: whether the trial is accepted in any case: it is the start, or the
            accepted state after a rejected trial. So the evaluation is compiled once.
    """

    best: Descent
    energy: Float[Array, ""]
    share: Float[Array, ""]
    trial: Nodes
    foretold: Float[Array, ""]
    reached: Float[Array, ""]
    certain: Array


def _plus(first: Nodes, factor: Scalar, second: Nodes) -> Nodes:
    return jax.tree.map(lambda a, b: a + factor * b, first, second)


def _largest(rows: Nodes) -> Float[Array, ""]:
    """Return the length of the longest row."""
    each = [jnp.max(safe_norm(leaf)) for leaf in jax.tree.leaves(rows)]
    return jnp.max(jnp.stack(each))


def _to_border(p: Nodes, d: Nodes, limit: Nodes) -> Float[Array, ""]:
    """Return the largest τ with no row of p + τ d longer than its limit."""

    def of_rows(p: Array, d: Array, limit: Array) -> Array:
        along, square = jnp.sum(p * d, axis=1), jnp.sum(d * d, axis=1)
        room = jnp.maximum(limit**2 - jnp.sum(p * p, axis=1), 0)
        root = jnp.sqrt(along**2 + square * room)
        # the form of the root without cancellation
        outward = along > 0
        over = jnp.where(outward, along + root, jnp.where(square > 0, square, 1))
        rate = jnp.where(outward, room, root - along)
        return jnp.min(jnp.where(square > 0, rate / over, jnp.inf))

    rates = jax.tree.map(of_rows, p, d, limit)
    return jnp.min(jnp.stack(jax.tree.leaves(rates)))


def _reached(p: Nodes, bound: Nodes) -> Float[Array, ""]:
    """Return the largest ratio of a row's length to its bound."""

    def of_rows(p: Array, bound: Array) -> Array:
        return jnp.max(safe_norm(p) / jnp.where(bound > 0, bound, 1))

    each = jax.tree.map(of_rows, p, bound)
    return jnp.max(jnp.stack(jax.tree.leaves(each)))


def _lessen(
    force: Nodes,
    product: Product,
    limit: Nodes,
    goal: Float[Array, ""],
    most: Float[Array, ""] | Int[Array, ""],
) -> _Step:
    """Reduce the quadratic model within the trust region.

    Args:
        force: on free nodes, 0 elsewhere.
        product: H v.
        limit: largest length of each row of the step.
        goal: length of the residual at which to stop.
        most: bound on the number of products.
    """

    def searching(step: _Step) -> Array:
        return ~step.ended & (step.square > goal**2) & (step.products < most)

    def search(step: _Step) -> _Step:
        hd = product(step.d)
        curvature = dot(step.d, hd)
        upward = curvature > 0
        rate = step.square / jnp.where(upward, curvature, 1)
        border = _to_border(step.p, step.d, limit)
        ended = ~upward | (rate >= border)
        rate = jnp.where(ended, border, rate)
        r = _plus(step.r, -rate, hd)
        square = dot(r, r)
        p, d = _plus(step.p, rate, step.d), _plus(r, square / step.square, step.d)
        return _Step(p, r, d, square, step.products + 1, ended)

    nothing = jax.tree.map(jnp.zeros_like, force)
    none, no = jnp.zeros((), int), jnp.zeros((), bool)
    start = _Step(nothing, force, force, dot(force, force), none, no)
    return jax.lax.while_loop(searching, search, start)


class _Region(eqx.Module):
    """Trust region: how a trial is judged, and the next one found.

    The region is a ball for each node, whose radius is a share of its bound. Where the
    decrease of the energy is below its rounding, a step is judged by the largest force
    instead.

    Attributes:
        problem: the energy.
        tolerance: largest force allowed on a free node, in F(0).
        max_products: bound on the number of Hessian products.
        largest: longest displacement of a node in one iteration, in r0.
    """

    problem: Problem
    tolerance: Float[Array, ""]
    max_products: Int[Array, ""]
    largest: Float[Array, ""]

    def masked(self, nodes: Nodes) -> Nodes:
        """Return rows of free nodes, 0 for the others."""
        return jax.tree.map(jnp.multiply, self.problem.free(), nodes)

    def unfinished(self, best: Descent) -> Array:
        """Return whether the tolerance may still be reached."""
        going = (best.code == Result.STEP_LIMIT.code) & ~best.lists.stale
        return going & (best.steps < self.max_products)

    def iterate(self, now: _Now) -> _Now:
        """Evaluate the trial, accept or reject it, and reduce the model there."""
        there = self.evaluated(now)
        energy = self.problem.energy(now.trial, there.lists)
        hessian = hessian_product(self.problem, now.trial, there.lists)
        ratio = self.agreement(now, energy, there.residual)
        taken = self.accepts(now, there, ratio)
        best, bound = self.after(now.best, there, taken)
        share = jnp.where(now.certain, now.share, _adapted(now, ratio))
        force = self.masked(there.force)
        step = _lessen(
            force,
            lambda way: self.masked(hessian(self.masked(way))),
            jax.tree.map(lambda b: share * b, bound),
            jnp.sqrt(dot(force, force)) * self.exactness(best.residual),
            jnp.where(taken & self.unfinished(best), self.max_products - best.steps, 0),
        )
        foretold = 0.5 * (dot(force, step.p) + dot(step.r, step.p))  # H p is F - r
        return _Now(
            eqx.tree_at(lambda b: b.steps, best, best.steps + step.products),
            jnp.where(taken, energy, now.energy),
            share,
            _plus(best.nodes, 1.0, step.p),
            foretold,
            _reached(step.p, bound),
            ~taken,
        )

    def evaluated(self, now: _Now) -> Descent:
        """Return the state at the trial, with lists that are valid there."""
        best = now.best
        outgrown = self.problem.outgrown(now.trial, best.lists)
        lists = self.problem.rebuilt(now.trial, best.lists, outgrown)
        force = self.problem.forces(now.trial, lists)
        rebuilds = best.rebuilds + outgrown.any().astype(int)
        residual = _largest(self.masked(force))
        return Descent(
            now.trial, force, lists, None, residual, best.steps, rebuilds, best.code
        )

    def agreement(self, now: _Now, energy: Array, residual: Array) -> Array:
        """Return the ratio of actual to predicted decrease of the energy."""
        rounding = 100 * jnp.finfo(self.problem.dtype).eps
        drowned = now.foretold <= rounding * jnp.maximum(1, jnp.abs(now.energy))
        ratio = (now.energy - energy) / jnp.where(drowned, 1, now.foretold)
        nearer = jnp.where(residual < now.best.residual, 1.0, 0.0).astype(ratio.dtype)
        return jnp.where(drowned, nearer, ratio)

    def accepts(self, now: _Now, there: Descent, ratio: Array) -> Array:
        """Return whether the trial becomes the accepted state."""
        agrees = (ratio > _ACCEPTED) & jnp.isfinite(there.residual)
        return (now.certain | agrees) & ~there.lists.overflow & ~there.lists.stale

    def after(
        self, best: Descent, there: Descent, taken: Array
    ) -> tuple[Descent, Nodes]:
        """Return the accepted state, with its code, and the bounds of its nodes."""
        tried = there.lists
        best = jax.tree.map(lambda a, b: jnp.where(taken, a, b), there, best)
        bound = self.problem.bound(best.nodes, best.lists, self.largest)
        best = eqx.tree_at(
            lambda b: (b.lists, b.code),
            best,
            (_noted(tried, best.lists), self.judged(best, tried, bound)),
        )
        return best, bound

    def judged(self, best: Descent, tried: Lists, bound: Nodes) -> Array:
        """Return the code of the accepted state."""
        reached = best.residual <= self.tolerance
        code = jnp.where(reached, Result.CONVERGED.code, Result.STEP_LIMIT.code)
        none = jax.tree.map(
            lambda b, on: jnp.any((b == 0) & (on[:, 0] > 0)), bound, self.problem.free()
        )
        stuck = jnp.any(jnp.stack(jax.tree.leaves(none)))
        stuck &= code == Result.STEP_LIMIT.code
        code = jnp.where(stuck, Result.ON_MEMBRANE.code, code)
        finite = jnp.isfinite(best.residual)
        code = jnp.where(finite, code, Result.NON_FINITE.code)
        return jnp.where(tried.overflow, Result.OVERFLOW.code, code)

    def exactness(self, residual: Array) -> Array:
        """Return the relative residual of the linear system at which to stop."""
        return jnp.clip(jnp.sqrt(residual), 0.3 * self.tolerance / residual, _COARSEST)


def _adapted(now: _Now, ratio: Array) -> Array:
    """Return the share of their bounds that nodes may move next."""
    wider = (ratio > 0.75) & (now.reached > 0.99 * now.share)
    share = jnp.where(wider, jnp.minimum(1, 2 * now.share), now.share)
    return jnp.where(ratio >= 0.25, share, 0.25 * now.reached)


def _noted(tried: Lists, lists: Lists) -> Lists:
    """Return lists with the overflow and staleness of those that were tried."""
    larger = jax.tree.map(lambda a, b: jnp.where(tried.overflow, a, b), tried, lists)
    return larger.with_stale(tried.stale)


def descend_by_trust(
    problem: Problem,
    lists: Lists,
    tolerance: Float[Array, ""],
    max_products: Int[Array, ""],
    largest: Float[Array, ""],
) -> Descent:
    """Move the free nodes until the largest force is at most `tolerance`.

    Args:
        problem: the energy, and the start.
        lists: valid for the start.
        tolerance: largest force allowed on a free node, in F(0).
        max_products: bound on the number of Hessian products.
        largest: longest displacement of a node in one iteration, in r0.

    Returns:
        The positions accepted last; the steps are Hessian products.
    """
    region = _Region(problem, tolerance, max_products, largest)
    zero, none = jnp.zeros((), problem.dtype), jnp.zeros((), int)
    nodes = problem.nodes()
    start = Descent(
        nodes,
        jax.tree.map(jnp.zeros_like, nodes),
        lists,
        None,
        zero + jnp.inf,
        none,
        none,
        jnp.asarray(Result.STEP_LIMIT.code),
    )
    now = _Now(start, zero, zero + 1, nodes, zero, zero, jnp.ones((), bool))
    end = jax.lax.while_loop(
        lambda now: region.unfinished(now.best) & (now.share > _SMALLEST_SHARE),
        lambda now: region.iterate(now),  # a bound method would be hashed
        now,
    )
    return end.best
