"""Relaxation: the equilibrium of particles, of a membrane, or of both together."""

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from jaxgrow.equilibrium.descent import blank_memory, descend, Minimiser
from jaxgrow.equilibrium.euler import Euler
from jaxgrow.equilibrium.fire import FIRE
from jaxgrow.equilibrium.implicit import at_equilibrium, is_differentiated, primal
from jaxgrow.equilibrium.lbfgs import LBFGS
from jaxgrow.equilibrium.listing import (
    allocate_lists,
    CollisionLister,
    fits,
    prepared,
)
from jaxgrow.equilibrium.newton import polish
from jaxgrow.equilibrium.problem import Lists, Problem
from jaxgrow.equilibrium.serial import sweep
from jaxgrow.parameters import Parameters
from jaxgrow.results import Result
from jaxgrow.state import Membrane, Nodes, Particles


Method = Literal["auto", "lbfgs", "fire", "newton", "euler", "serial"]

LARGEST_STEP = 0.1
"""Longest displacement of a node in one step, in r0."""

POLISHED = 1e-4
"""Tolerance below which Newton's method ends a relaxation, in F(0)."""


class RelaxationStats(NamedTuple):
    """What a relaxation took.

    Attributes:
        residual: largest force on a free node, in F(0).
        steps: steps made, over all methods and retries; of Newton's method the Hessian
            products.
        rebuilds: how often descents rebuilt their lists on the way.
        overflows: how often a list was too small and was allocated anew.
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
        stats: what it took.
        lists: may be passed to the next call.
        forces: on all nodes, in F(0); on those that are held or pinned, what the
            border of a patch feels.
    """

    state: tuple[Particles | None, Membrane | None]
    result: Result
    stats: RelaxationStats
    lists: Lists
    forces: Nodes


_descend = eqx.filter_jit(descend)
_polish = eqx.filter_jit(polish)
_sweep = eqx.filter_jit(sweep)
_blank_memory = eqx.filter_jit(blank_memory)


@eqx.filter_jit
def _set_apart(particles: Particles) -> Particles:
    """Move living particles that lie on each other's very point apart by a hair.

    At distance 0 a pair's force has no direction, and so seems to be at rest at the
    maximum of its energy. All but one of a group are moved, by some roundings of their
    coordinates, each in a direction of its own.
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
    return eqx.tree_at(lambda p: p.position, particles, moved)


def relax(
    particles: Particles | None,
    membrane: Membrane | None = None,
    *,
    parameters: Parameters | None = None,
    tolerance: float = 1e-3,
    method: Method = "auto",
    max_steps: int = 3000,
    largest_step: float = LARGEST_STEP,
    load: Float[Array, "m 3"] | None = None,
    lists: Lists | None = None,
    collide: CollisionLister | None = None,
    observe: Callable[[Nodes], None] | None = None,
) -> Relaxation:
    """Bring particles and membrane to equilibrium: the largest force at a tolerance.

    One energy, of pairs, springs and contact, is minimised over the positions of all
    free particles and vertices together. (The paper relaxes the tissue and then the
    surface under the forces that it accumulated; after a reset of rest lengths a flat
    membrane has no linear stiffness out of its plane, and those dead loads throw it
    far beyond the reach of the particles.)

    Particles at the very same point are set apart by a hair first.

    *Derivatives.* The equilibrium can be differentiated, in forward and reverse mode at
    the price of a linear solve a direction, with respect to parameters, rest lengths,
    load, and the positions of what is held or pinned (`jaxgrow.equilibrium.implicit`).
    The tolerance is then 1e-10 at most. Where free nodes started from has no
    derivative. If the equilibrium was not reached, is not a strict minimum, or its
    linear system could not be solved, the derivative is NaN; `jaxgrow.linear_response`
    says which.

    No node moves farther in one step than 0.4 of its distance to what it must not
    cross, so particles stay on their side of the membrane throughout.

    Args:
        particles: or None for a membrane alone.
        membrane: or None for particles alone; then no membrane term is compiled.
        parameters: of the energy; the default `Parameters()`.
        tolerance: largest force on a free node at the end, in F(0).
        method: "lbfgs", "fire", "newton" (only from near an equilibrium), "euler" and
            "serial" (the paper's eq. 1, all at once or in serial order, which is for
            particles alone), or "auto": L-BFGS, which Newton's method ends where the
            tolerance is below 1e-4, then FIRE if they do not converge.
        max_steps: bound on the steps of each method.
        largest_step: longest displacement of a node in one step, in r0.
        load: external force on every vertex, in F(0).
        lists: of an earlier call, to spare their allocation.
        collide: lists what the membrane may collide with (see
            `jaxgrow.collisions.CollisionFinder`); None if it can collide with nothing,
            and then no collision term is compiled.
        observe: called with the positions after every single step, which makes the
            relaxation several times slower.

    Returns:
        state, result, stats and lists. When the result is not CONVERGED the state is
        the last valid one, and its residual is in the stats.

    Raises:
        ValueError: there is nothing to relax, the tolerance is not positive, or the
            method is unknown or not for a membrane.
    """
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
    given = Problem.of(particles, membrane, parameters, load)
    problem = primal(given)
    if problem.particles is not None:
        apart = _set_apart(problem.particles)
        problem = eqx.tree_at(lambda p: p.particles, problem, apart)
    differentiated = is_differentiated(given)
    if differentiated:
        tolerance = min(tolerance, exact_tolerance(given.dtype))
    if lists is None or not fits(problem, lists):
        lists = allocate_lists(problem)
    stats = RelaxationStats(math.inf, 0, 0, 0, method)
    result, forces, near = Result.STEP_LIMIT, problem.nodes(), False
    for stage in _stages(method, tolerance, problem.parameters):
        if stage.polishes and not near:
            continue
        limits = _Limits(stage.tolerance, max_steps, largest_step)
        found = _run(problem, lists, stage, limits, collide, observe)
        problem, lists, forces = problem.at(found.nodes), found.lists, found.force
        result = found.result
        near |= result is Result.CONVERGED
        stats = RelaxationStats(
            found.residual,
            stats.steps + found.steps,
            stats.rebuilds + found.rebuilds,
            stats.overflows + found.overflows,
            stage.name,
        )
        done = result is Result.CONVERGED and found.residual <= tolerance
        if done or result not in (Result.CONVERGED, Result.STEP_LIMIT):
            break
    if differentiated:
        valid = result is Result.CONVERGED
        nodes = at_equilibrium(given, problem.nodes(), lists, valid=valid)
        problem = given.at(nodes)
    state = problem.particles, problem.membrane
    return Relaxation(state, result, stats, lists, forces)


class _Stage(NamedTuple):
    """A method.

    Attributes:
        name: of it.
        minimiser: None for a method that is no `Minimiser`.
        tolerance: how far it goes.
        polishes: whether it comes only after a method that converged.
    """

    name: str
    minimiser: Minimiser | None
    tolerance: float
    polishes: bool = False


class _Limits(NamedTuple):
    """Where a method stops, and its longest step."""

    tolerance: float
    max_steps: int
    largest_step: float


class _Found(NamedTuple):
    """Where a method ended."""

    nodes: Nodes
    force: Nodes
    lists: Lists
    result: Result
    residual: float
    steps: int
    rebuilds: int
    overflows: int


def exact_tolerance(dtype: DTypeLike = jnp.float64) -> float:
    """Tolerance of an equilibrium whose derivative is taken, in F(0)."""
    return 1e-10 if jnp.finfo(dtype).bits > 32 else 1e-5


def _stages(method: str, tolerance: float, parameters: Parameters) -> list[_Stage]:
    """The methods to try in turn, until one reaches the tolerance.

    Raises:
        ValueError: the method is unknown.
    """
    # the stiffest pairs bound the stable time step: 2 / √λ, and λ grows with s
    stiffest = jnp.maximum(1.0, parameters.tumour_stiffness)
    lbfgs = _Stage("lbfgs", LBFGS(), tolerance)
    fire = _Stage("fire", FIRE(largest=0.4 / jnp.sqrt(stiffest)), tolerance)
    newton = _Stage("newton", None, tolerance)
    euler = _Stage("euler", Euler(Euler.rate / stiffest), tolerance)
    serial = _Stage("serial", None, tolerance)
    auto = [lbfgs, fire]
    if tolerance < POLISHED:
        polish = newton._replace(polishes=True), lbfgs._replace(polishes=True)
        auto = [lbfgs._replace(tolerance=POLISHED), *polish, fire]
    alone = {stage.name: [stage] for stage in (lbfgs, fire, newton, euler, serial)}
    methods = {**alone, "auto": auto}
    if method not in methods:
        raise ValueError(f"method is {method!r}; it must be one of {list(methods)}.")
    return methods[method]


def _run(
    problem: Problem,
    lists: Lists,
    stage: _Stage,
    limits: _Limits,
    collide: CollisionLister | None,
    observe: Callable[[Nodes], None] | None,
) -> _Found:
    """One method; every list that overflows is allocated anew and larger."""
    minimiser = stage.minimiser
    steps = rebuilds = overflows = 0
    memory = None
    if minimiser is not None and (collide is not None or observe is not None):
        memory = _blank_memory(problem, minimiser)
    while True:
        lists = prepared(problem, lists, collide)
        tolerance = jnp.asarray(limits.tolerance, problem.dtype)
        largest = jnp.asarray(limits.largest_step, problem.dtype)
        if stage.name == "serial":
            most = jnp.asarray(limits.max_steps - steps)
            outcome = _sweep(problem, lists, tolerance, most, largest)
            made = int(outcome.steps)
            rebuilds += int(outcome.rebuilds)
        elif minimiser is None:
            outcome = _polish(problem, lists, tolerance, largest)
            made = int(outcome.products)
        else:
            most = limits.max_steps - steps if observe is None else 1
            outcome = _descend(
                problem, lists, minimiser, tolerance, jnp.asarray(most), largest, memory
            )
            made, memory = int(outcome.steps), outcome.memory
            rebuilds += int(outcome.rebuilds)
        steps += made
        problem, lists = problem.at(outcome.nodes), outcome.lists
        if observe is not None and made:
            observe(outcome.nodes)
        result = Result.of(int(outcome.code))
        single = observe is not None and minimiser is not None
        paused = single or bool(lists.stale)
        if result is Result.OVERFLOW:
            overflows += 1
            lists = allocate_lists(problem, lists)
        elif not (result is Result.STEP_LIMIT and steps < limits.max_steps and paused):
            residual = float(outcome.residual)
            return _Found(
                outcome.nodes,
                outcome.force,
                lists,
                result,
                residual,
                steps,
                rebuilds,
                overflows,
            )
