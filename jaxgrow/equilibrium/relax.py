"""Relaxation to the equilibrium of particles, of a membrane, or of both."""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.active_set import is_local, may_pay, relax_locally
from jaxgrow.equilibrium.extra_terms import ExtraTerms
from jaxgrow.equilibrium.implicit_diff import at_equilibrium, Equilibrium
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.methods import (
    exact_tolerance,
    goal_of,
    Limits,
    Method,
    NEAR,
    run_stage,
    stages_of,
)
from jaxgrow.equilibrium.problem import LARGEST_STEP, Problem
from jaxgrow.equilibrium.refresh_lists import (
    allocate_lists,
    CollisionLister,
    fits,
    prepared,
)
from jaxgrow.equilibrium.staggered import stagger
from jaxgrow.equilibrium.transformations import (
    check_transformations,
    is_differentiated,
    primal,
)
from jaxgrow.neighbors.within_radius import may_coincide
from jaxgrow.numerics.guards import check_precision
from jaxgrow.runtime.forks import refuse_forked
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.types import Given
from jaxgrow.state import Membrane, Nodes, Particles
from jaxgrow.transfer.array_checks import accept_bodies, accept_vectors
from jaxgrow.transfer.device import get


class RelaxationStats(NamedTuple):
    """Statistics of a relaxation.

    Attributes:
        residual: largest force on a free node, in F(0).
        steps: steps made, over all methods and retries; for Newton's method the Hessian
            products.
        rebuilds: number of list rebuilds during descents.
        overflows: number of lists that overflowed and were reallocated.
        method: the method that ended it.
    """

    residual: float
    steps: int
    rebuilds: int
    overflows: int
    method: str


class Relaxation(NamedTuple):
    """Outcome of `relax`.

    Attributes:
        state: particles and membrane.
        result: CONVERGED, or why not.
        stats: residual, steps and method.
        lists: may be passed to the next call.
        forces: on all nodes, in F(0); on held and pinned ones, the reaction at the
            border of a patch. They are differentiated as the equilibrium is.
    """

    state: tuple[Particles | None, Membrane | None]
    result: Result
    stats: RelaxationStats
    lists: Lists
    forces: Nodes


@jax.jit
def _set_apart(particles: Particles) -> Particles:
    """Separate coincident particles by a tiny displacement.

    At distance 0 a pair's force has no direction, so the pair would seem to be at rest
    at the maximum of its energy. All but one of a group are moved, by some roundings of
    their coordinates, each in another direction.
    """
    position = particles.position
    order = jnp.lexsort(position.T)
    there, alive = position[order], particles.alive[order]
    same = jnp.all(there[1:] == there[:-1], axis=1) & alive[1:] & alive[:-1]
    again = jnp.zeros(len(order), bool).at[order[1:]].set(same)
    index = jnp.arange(len(order)).astype(position.dtype)
    turn, height = 2.399963 * index, 1 - 2 * ((0.618034 * index + 0.5) % 1)  # a spiral
    flat = jnp.sqrt(jnp.maximum(1 - height**2, 0))
    way = jnp.stack([flat * jnp.cos(turn), flat * jnp.sin(turn), height], axis=1)
    size = jnp.maximum(1, jnp.max(jnp.abs(position), axis=1, keepdims=True))
    hair = 1024 * jnp.finfo(position.dtype).eps * size * way
    moved = jnp.where((again & particles.free)[:, None], position + hair, position)
    return particles.at(moved)


def relax(
    particles: Particles | None,
    membrane: Membrane | None = None,
    *,
    parameters: Parameters | None = None,
    tolerance: float = 1e-3,
    method: Method = "auto",
    max_steps: int = 3000,
    largest_step: float = LARGEST_STEP,
    load: Given | None = None,
    lists: Lists | None = None,
    collide: CollisionLister | None = None,
    observe: Callable[[Nodes], None] | None = None,
    terms: ExtraTerms = (),
) -> Relaxation:
    """Relax particles and membrane until the largest force is at a tolerance.

    One energy, of pairs, springs and contact, is minimised over the positions of all
    free particles and vertices together. (The paper relaxes the tissue and then the
    surface under the forces that it accumulated; after a reset of rest lengths a flat
    membrane has no linear stiffness out of its plane, and those dead loads move it far
    beyond the reach of the particles.)

    Coincident particles are separated by a tiny displacement first.

    *Derivatives.* The equilibrium can be differentiated, in forward and reverse mode at
    the cost of a linear solve per direction, with respect to parameters, rest lengths,
    load, and the positions of held and pinned nodes
    (`jaxgrow.equilibrium.implicit_diff`): by `jax.grad`, `jax.jvp`, `jax.vjp`,
    `jax.jacfwd` (a solve per parameter) and `jax.jacrev` (a solve per result). The
    tolerance is then 1e-10 at most. The initial positions of free nodes have no
    derivative. If the equilibrium was not reached, is not a strict minimum, or its
    linear system could not be solved, the derivative is NaN; `jaxgrow.linear_response`
    says which.

    No node moves farther in one step than 0.4 of its distance to the surfaces that it
    must not cross, so particles stay on their side of the membrane throughout.

    Args:
        particles: or None for a membrane alone; see `jaxgrow.make_particles`.
        membrane: or None for particles alone; then no membrane term is compiled. See
            `jaxgrow.make_membrane`.
        parameters: of the energy; the default `Parameters()`.
        tolerance: largest force on a free node at the end, in F(0). At 1e-10 or less,
            as under a derivative, whose error is about the residual, the relaxation
            goes on to a hundredth of it if possible, and 1e-12 is enough.
        method: "lbfgs", "fire", "newton" (within a trust region, from any start),
            "euler" and "serial" (the paper's eq. 1, all at once or in serial order,
            which is for particles alone), "staggered" (the paper's turns of tissue and
            surface, for both, which seldom converge), or "auto": L-BFGS, then Newton's
            method if the tolerance is below 1e-12, or if it is below 1e-6 and L-BFGS
            does not converge, then FIRE if they do not; "local": the same after
            relaxing the disturbed part separately, with growing size, which "auto" does
            too for many thousands of nodes; or one of your own
            (`jaxgrow.register_relaxer`).
        max_steps: bound on the steps of each method.
        largest_step: longest displacement of a node in one step, in r0.
        load: external force on every vertex, padding included, (m, 3), in F(0).
        lists: of an earlier call, to save their allocation.
        collide: lists what the membrane may collide with (see
            `jaxgrow.growth.collision_broad_phase.CollisionFinder`); None if it can
            collide with nothing, and then no collision term is compiled.
        observe: called with the positions after every single step, which makes the
            relaxation several times slower; for "staggered" after every turn, for
            "newton" at the end.
        terms: additional energies. An instance of `jaxgrow.Term`, whose energy of one
            element is printed as a loop like those of jaxgrow; or a function of
            particles and membrane that returns an energy in F(0) r0, which XLA
            evaluates: a relaxation then takes several times as long. A function is
            compiled again for every new object, so define it once; numbers in it that
            change from call to call belong in the fields of a callable
            `equinox.Module`.

    Returns:
        State, result, stats and lists. If the result is not CONVERGED the state is the
        last valid one, and its residual is in the stats.

    Raises:
        ValueError: there is nothing to relax, an array has a wrong shape or kind of
            numbers, the tolerance is not positive, the method is unknown or not for a
            membrane, JAX computes in 32 bits and the positions have 64, or a second
            derivative is taken or values are withheld (`jax.hessian`, `jax.jit`,
            `jax.checkpoint`, `jax.vmap` over values).
        RuntimeError: this process was forked from one that had computed.
    """
    refuse_forked()
    if particles is None and membrane is None:
        raise ValueError("nothing to relax: give particles, a membrane, or both.")
    if not tolerance > 0:
        raise ValueError(f"tolerance is {tolerance}; it must be a positive force.")
    if not 0 < largest_step <= LARGEST_STEP:
        raise ValueError(
            f"largest_step is {largest_step}; it must be positive and at most "
            f"{LARGEST_STEP}, or nodes could pass each other within a step."
        )
    if method == "serial" and membrane is not None:
        raise ValueError("method is 'serial', which is for particles alone.")
    if method == "staggered" and (particles is None or membrane is None):
        raise ValueError(
            "method is 'staggered', which is for particles and a membrane: give both, "
            "or choose another method."
        )
    if method == "local" and (collide is not None or observe is not None):
        raise ValueError(
            "method is 'local', which is for what collides with nothing and is not "
            "observed; 'auto' is for everything."
        )
    particles, membrane = accept_bodies(particles, membrane)
    if load is not None:
        load = accept_vectors("load", load, membrane and membrane.vertices)
    check_precision(Problem(particles, membrane, Parameters()).dtype)
    given = Problem.of(particles, membrane, parameters, load, terms)
    check_transformations(given)
    differentiated = is_differentiated(given)
    problem = primal(given) if differentiated else given
    own = problem.particles
    if own is not None and may_coincide(get(own.position), get(own.alive)):
        problem = problem.but(particles=_set_apart(own))
    if differentiated:
        tolerance = min(tolerance, exact_tolerance(given.dtype))
    goal = goal_of(tolerance, given.dtype)
    if lists is None or not fits(problem, lists):
        lists = allocate_lists(problem)
    if method == "local" and not is_local(problem):
        raise ValueError(
            "method is 'local', and of energies that are not jaxgrow's it is not known "
            "how far they act; use 'auto'."
        )
    if method == "auto" and collide is None and observe is None and may_pay(problem):
        method = "local"
    stats = RelaxationStats(math.inf, 0, 0, 0, method)
    result, forces, near = Result.STEP_LIMIT, problem.nodes(), False
    for stage in stages_of(method, goal, problem.parameters):
        if stage.polishes and not near:
            continue
        limits = Limits(stage.tolerance, max_steps, largest_step)
        if stage.name == "local":
            found = relax_locally(problem, lists, limits)
        elif stage.name == "staggered":
            found = stagger(problem, lists, limits, collide, observe)
        else:
            found = run_stage(problem, lists, stage, limits, collide, observe)
        problem, lists, forces = problem.at(found.nodes), found.lists, found.force
        result = found.result
        near |= found.residual <= NEAR
        stats = RelaxationStats(
            found.residual,
            stats.steps + found.steps,
            stats.rebuilds + found.rebuilds,
            stats.overflows + found.overflows,
            stage.name,
        )
        if result not in (Result.CONVERGED, Result.STEP_LIMIT):
            break
        if found.residual <= tolerance:
            result = Result.CONVERGED
            break
    if differentiated:
        if stats.method == "local":  # leaves neighbour lists invalid
            lists = prepared(problem, lists, None)
        valid = result is Result.CONVERGED
        found = Equilibrium(problem.nodes(), forces)
        nodes, forces = at_equilibrium(given, found, lists, valid=valid)
        problem = given.at(nodes)
    state = problem.particles, problem.membrane
    return Relaxation(state, result, stats, lists, forces)
