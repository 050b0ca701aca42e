"""Registry of relaxation methods, each by the name that `relax` takes.

A method is a `Minimiser`, which turns forces into displacements and leaves lists,
bounds and the end to the loop of `jaxgrow.equilibrium.descent`; or a `Program`, which
does all of it. Either may depend on the parameters of the energy.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.descent import Descent, Minimiser
from jaxgrow.equilibrium.euler import Euler
from jaxgrow.equilibrium.fire import FIRE
from jaxgrow.equilibrium.gauss_seidel import sweep
from jaxgrow.equilibrium.lbfgs import LBFGS
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.newton import polish
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.trust_region import descend_by_trust
from jaxgrow.runtime.types import Scalar


class Program(NamedTuple):
    """Method that JAX compiles as a whole.

    Attributes:
        run: makes a `Descent` from problem, lists, tolerance in F(0), bound on the
            steps, and longest displacement in one step in r0. The same function for
            every relaxation, as each is compiled.
        products: whether it takes Hessian products. It is not observed step by step
            then.
    """

    run: Callable[..., Descent]
    products: bool = False


Relaxer: TypeAlias = Callable[[Parameters], Minimiser | Program]
"""Maker of a method for an energy's parameters."""


def _stiffest(parameters: Parameters) -> Scalar:
    """Return the stiffness λ that bounds the stable time step, 2 / √λ."""
    return jnp.maximum(1.0, parameters.tumour_stiffness)


def _polish(
    problem: Problem,
    lists: Lists,
    tolerance: Float[Array, ""],
    max_steps: Int[Array, ""],
    largest: Float[Array, ""],
) -> Descent:
    del max_steps  # its few iterations have a bound of their own
    return polish(problem, lists, tolerance, largest)


POLISH = Program(_polish, products=True)
"""Newton's method near an equilibrium, after another method."""

_TRUST = Program(descend_by_trust, products=True)

_SWEEP = Program(sweep)

RELAXERS: dict[str, Relaxer] = {
    "lbfgs": lambda _: LBFGS(),
    "fire": lambda energy: FIRE(largest=0.4 / jnp.sqrt(_stiffest(energy))),
    "newton": lambda _: _TRUST,
    "euler": lambda energy: Euler(Euler.rate / _stiffest(energy)),
    "serial": lambda _: _SWEEP,
}
"""Registered methods, by name."""

SEQUENCES = ("auto", "local", "staggered")
"""Names of methods that call others, in `jaxgrow.equilibrium.methods`."""

_BUILT_IN = (*SEQUENCES, *RELAXERS)


def register_relaxer(name: str, method: Minimiser | Program | Relaxer) -> None:
    """Register a relaxation method for `jaxgrow.relax`.

    A method of the same name is replaced.

    Args:
        name: for the argument ``method``.
        method: a `jaxgrow.Minimiser`, best an `equinox.Module`, a
            `jaxgrow.equilibrium.relaxers.Program`, or a function that makes one from
            the `jaxgrow.Parameters` of the energy.

    Raises:
        TypeError: it is none of these.
        ValueError: the name is that of one of jaxgrow's methods.
    """
    if name in _BUILT_IN:
        raise ValueError(f"the method {name!r} is jaxgrow's; choose another name.")
    if isinstance(method, type) or not (
        isinstance(method, Program | Minimiser) or callable(method)
    ):
        raise TypeError(
            f"{method!r} is no relaxation method; give an object with the methods "
            "init, propose and learn, or a function of parameters that returns one."
        )
    RELAXERS[name] = _maker(method)


def _maker(method: Minimiser | Program | Relaxer) -> Relaxer:
    """Return a function of parameters that gives the method."""
    if isinstance(method, Program | Minimiser):
        return lambda _: method
    return method


def method_names() -> tuple[str, ...]:
    """Return the names of all methods that there are."""
    return (*SEQUENCES, *RELAXERS)
