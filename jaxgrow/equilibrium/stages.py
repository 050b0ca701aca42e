"""The methods of a relaxation, and how one is run on lists that may overflow."""

from collections.abc import Callable
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax.typing import DTypeLike

from jaxgrow.equilibrium.descent import blank_memory, descend, Minimiser
from jaxgrow.equilibrium.euler import Euler
from jaxgrow.equilibrium.fire import FIRE
from jaxgrow.equilibrium.lbfgs import LBFGS
from jaxgrow.equilibrium.listing import allocate_lists, CollisionLister, prepared
from jaxgrow.equilibrium.newton import polish
from jaxgrow.equilibrium.problem import Lists, Problem
from jaxgrow.equilibrium.serial import sweep
from jaxgrow.equilibrium.trust import descend_by_trust
from jaxgrow.parameters import Parameters
from jaxgrow.results import Result
from jaxgrow.state import Nodes


Method = Literal[
    "auto", "lbfgs", "fire", "newton", "local", "euler", "serial", "staggered"
]

NEAR = 1e-4
"""Residual, in F(0), from which Newton's method converges without help."""

POLISHED = 1e-6
"""Tolerance below which Newton's method ends a relaxation, in F(0): down to there
L-BFGS takes half of the time."""


_descend = eqx.filter_jit(descend)
_polish = eqx.filter_jit(polish)
_sweep = eqx.filter_jit(sweep)
_descend_by_trust = eqx.filter_jit(descend_by_trust)
_blank_memory = eqx.filter_jit(blank_memory)


class Stage(NamedTuple):
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


class Limits(NamedTuple):
    """Where a method stops, and its longest step."""

    tolerance: float
    max_steps: int
    largest_step: float


class Found(NamedTuple):
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


def stages_of(method: str, tolerance: float, parameters: Parameters) -> list[Stage]:
    """The methods to try in turn, until one reaches the tolerance.

    Raises:
        ValueError: the method is unknown.
    """
    # the stiffest pairs bound the stable time step: 2 / √λ, and λ grows with s
    stiffest = jnp.maximum(1.0, parameters.tumour_stiffness)
    lbfgs = Stage("lbfgs", LBFGS(), tolerance)
    fire = Stage("fire", FIRE(largest=0.4 / jnp.sqrt(stiffest)), tolerance)
    newton = Stage("newton", None, tolerance)
    euler = Stage("euler", Euler(Euler.rate / stiffest), tolerance)
    serial = Stage("serial", None, tolerance)
    auto = [lbfgs, fire]
    if tolerance < POLISHED:
        polish = newton._replace(polishes=True), lbfgs._replace(polishes=True)
        auto = [lbfgs._replace(tolerance=POLISHED), *polish, fire]
    local = Stage("local", None, max(tolerance, NEAR))
    staggered = Stage("staggered", None, tolerance)
    each = lbfgs, fire, newton, euler, serial, staggered
    alone = {stage.name: [stage] for stage in each}
    methods = {**alone, "auto": auto, "local": [local, *auto]}
    if method not in methods:
        raise ValueError(f"method is {method!r}; it must be one of {list(methods)}.")
    return methods[method]


def run_stage(
    problem: Problem,
    lists: Lists,
    stage: Stage,
    limits: Limits,
    collide: CollisionLister | None,
    observe: Callable[[Nodes], None] | None,
) -> Found:
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
        left = limits.max_steps - steps
        most = jnp.asarray(left if observe is None else 1)
        if stage.name == "serial":
            outcome = _sweep(problem, lists, tolerance, most, largest)
            made = int(outcome.steps)
            rebuilds += int(outcome.rebuilds)
        elif stage.name == "newton" and not stage.polishes:
            most = jnp.asarray(left)
            outcome = _descend_by_trust(problem, lists, tolerance, most, largest)
            made = int(outcome.products)
            rebuilds += int(outcome.rebuilds)
        elif minimiser is None:
            outcome = _polish(problem, lists, tolerance, largest)
            made = int(outcome.products)
        else:
            outcome = _descend(
                problem, lists, minimiser, tolerance, most, largest, memory
            )
            made, memory = int(outcome.steps), outcome.memory
            rebuilds += int(outcome.rebuilds)
        steps += made
        problem, lists = problem.at(outcome.nodes), outcome.lists
        if observe is not None and made:
            observe(outcome.nodes)
        result = Result.of(int(outcome.code))
        single = observe is not None and stage.name != "newton"
        paused = single or bool(lists.stale)
        if result is Result.OVERFLOW:
            overflows += 1
            lists = allocate_lists(problem, lists)
        elif not (result is Result.STEP_LIMIT and steps < limits.max_steps and paused):
            residual = float(outcome.residual)
            return Found(
                outcome.nodes,
                outcome.force,
                lists,
                result,
                residual,
                steps,
                rebuilds,
                overflows,
            )
