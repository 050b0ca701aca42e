"""Relaxation methods, and the driver that reallocates overflowing lists."""

from collections.abc import Callable, Iterator
from typing import Literal, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import PyTree

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.descent import blank_memory, descend, Descent, Minimiser
from jaxgrow.equilibrium.lbfgs import LBFGS
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.loops import how_terms_run, with_loops
from jaxgrow.equilibrium.native_descent import descend_by_loop
from jaxgrow.equilibrium.native_lists import why_not_looped
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists, CollisionLister, prepared
from jaxgrow.equilibrium.relaxers import method_names, POLISH, Program, RELAXERS
from jaxgrow.runtime.descents import note_descent
from jaxgrow.runtime.results import Result
from jaxgrow.state import Nodes


Method: TypeAlias = (
    Literal["auto", "lbfgs", "fire", "newton", "local", "euler", "serial", "staggered"]
    | str
)
"""Name of a method: one of jaxgrow's, or one that was registered."""

NEAR = 1e-4
"""Residual, in F(0), from which Newton's method converges without help."""

POLISHED = 1e-12
"""Tolerance below which Newton's method ends a relaxation, in F(0): down to it L-BFGS
takes a quarter of the time, and below it stalls at the rounding of the forces."""

BEYOND = 0.01
"""Share of the tolerance to relax to where derivatives may be taken."""

TIGHT = 1e-6
"""Tolerance below which Newton's method follows if L-BFGS does not converge."""


_descend = eqx.filter_jit(descend)
# all arguments are arrays, and the call of jax.jit takes a tenth of the time
_descend_by_loop = jax.jit(descend_by_loop)
_run = eqx.filter_jit(lambda run, *given: run(*given))
_blank_memory = eqx.filter_jit(blank_memory)


class Stage(NamedTuple):
    """Method with its tolerance.

    Attributes:
        name: of the method.
        method: None for a method that calls others.
        tolerance: largest force at its end, in F(0).
        polishes: whether it runs only after a method that came near an equilibrium.
    """

    name: str
    method: Minimiser | Program | None
    tolerance: float
    polishes: bool = False


class Limits(NamedTuple):
    """Tolerance, most steps and longest step of a method."""

    tolerance: float
    max_steps: int
    largest_step: float


class MethodResult(NamedTuple):
    """Outcome of a method."""

    nodes: Nodes
    force: Nodes
    lists: Lists
    result: Result
    residual: float
    steps: int
    rebuilds: int
    overflows: int


def exact_tolerance(dtype: DTypeLike = jnp.float64) -> float:
    """Return the tolerance for an equilibrium to differentiate, in F(0)."""
    return 1e-10 if jnp.finfo(dtype).bits > 32 else 1e-5


def goal_of(tolerance: float, dtype: DTypeLike) -> float:
    """Return the force to relax to: below the tolerance for derivatives."""
    if jnp.finfo(dtype).bits <= 32 or tolerance > exact_tolerance(dtype):
        return tolerance
    return min(tolerance, max(BEYOND * tolerance, POLISHED))


def stages_of(method: str, tolerance: float, parameters: Parameters) -> Iterator[Stage]:
    """Yield the methods to try in turn, until one reaches the tolerance.

    Raises:
        ValueError: the method is unknown.
    """
    if method not in (known := method_names()):
        raise ValueError(f"method is {method!r}; it must be one of {list(known)}.")

    def own(name: str) -> Stage:
        return Stage(name, RELAXERS[name](parameters), tolerance)

    # lazily, as most relaxations end with the first
    if method == "local":
        yield Stage("local", None, max(tolerance, NEAR))
    if method in ("auto", "local"):
        lbfgs = own("lbfgs")
        yield lbfgs._replace(tolerance=max(tolerance, POLISHED))
        if tolerance < TIGHT:
            yield Stage("newton", POLISH, tolerance, polishes=True)
        if tolerance < POLISHED:
            yield lbfgs._replace(polishes=True)
        yield own("fire")
    elif method == "staggered":
        yield Stage(method, None, tolerance)
    else:
        yield own(method)


def run_stage(
    problem: Problem,
    lists: Lists,
    stage: Stage,
    limits: Limits,
    collide: CollisionLister | None,
    observe: Callable[[Nodes], None] | None,
) -> MethodResult:
    """Run one method; reallocate every list that overflows, larger."""
    method = stage.method
    products = isinstance(method, Program) and method.products
    problem = with_loops(problem, lists, products=products)
    run = _path(problem, lists, stage, limits)
    steps = rebuilds = overflows = 0
    memory = None
    if isinstance(method, Minimiser) and (collide is not None or observe is not None):
        memory = _blank_memory(problem, method)
    while True:
        lists = prepared(problem, lists, collide, refresh=run.refreshes)
        problem = with_loops(problem, lists, products=products)
        left = limits.max_steps - steps
        # Newton's method is not observed step by step
        single = observe is not None and not products
        outcome = run(problem, lists, 1 if single else left, memory)
        steps, rebuilds = steps + outcome.steps, rebuilds + outcome.rebuilds
        memory, lists = outcome.memory, outcome.lists
        if observe is not None and outcome.steps:
            observe(outcome.nodes)
        host = lists.of_host
        paused = single or (host is not None and bool(host.stale))
        if outcome.result is Result.OVERFLOW:
            overflows += 1
            problem = problem.at(outcome.nodes)
            lists = allocate_lists(problem, lists)
        elif (
            outcome.result is Result.STEP_LIMIT and steps < limits.max_steps and paused
        ):
            problem = problem.at(outcome.nodes)
        else:
            return MethodResult(
                outcome.nodes,
                outcome.force,
                lists,
                outcome.result,
                outcome.residual,
                steps,
                rebuilds,
                overflows,
            )


class _Outcome(NamedTuple):
    """Outcome of one call of a compiled program.

    Attributes:
        nodes, force, lists, memory: as in `Descent`.
        result, residual, steps, rebuilds: as in `Descent`, on the host.
    """

    nodes: Nodes
    force: Nodes
    lists: Lists
    memory: PyTree
    result: Result
    residual: float
    steps: int
    rebuilds: int


class _Looped(NamedTuple):
    """Runner of L-BFGS in one loop, which rebuilds the device's lists itself."""

    minimiser: LBFGS
    limits: Limits

    refreshes = False

    def __call__(
        self, problem: Problem, lists: Lists, most: int, memory: PyTree
    ) -> _Outcome:
        tolerance, _, largest = self.limits
        end = _descend_by_loop(
            problem, lists, self.minimiser, tolerance, most, largest, memory
        )
        return _outcome(end)


class _Compiled:
    """Runner of a method that XLA compiles."""

    refreshes = True

    def __init__(self, stage: Stage, limits: Limits, problem: Problem) -> None:
        self._stage = stage
        self._tolerance = jnp.asarray(limits.tolerance, problem.dtype)
        self._largest = jnp.asarray(limits.largest_step, problem.dtype)

    def __call__(
        self, problem: Problem, lists: Lists, most: int, memory: PyTree
    ) -> _Outcome:
        method = self._stage.method
        assert method is not None
        bounds = self._tolerance, jnp.asarray(most), self._largest
        if isinstance(method, Program):
            return _outcome(_run(method.run, problem, lists, *bounds))
        return _outcome(_descend(problem, lists, method, *bounds, memory))


def _path(
    problem: Problem, lists: Lists, stage: Stage, limits: Limits
) -> _Looped | _Compiled:
    """Choose the runner of a method for this problem; count L-BFGS descents."""
    if isinstance(stage.method, LBFGS):
        why_not, terms = why_not_looped(problem), how_terms_run(problem, lists)
        without = [name for name, how in terms.items() if how != "loop"]
        if why_not is None and without:
            why_not = f"there is no loop for {', '.join(without)}"
        note_descent(why_not, terms)
        if why_not is None:
            return _Looped(stage.method, limits)
    return _Compiled(stage, limits, problem)


def _outcome(end: Descent) -> _Outcome:
    """Convert a program's outcome, with its numbers on the host."""
    return _Outcome(
        end.nodes,
        end.force,
        end.lists,
        end.memory,
        Result.of(end.code),
        float(end.residual),
        int(end.steps),
        int(end.rebuilds),
    )
