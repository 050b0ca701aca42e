"""Energies that a user adds: terms of elements, and plain functions."""

from collections.abc import Callable, Sequence
from typing import cast, TypeAlias

import equinox as eqx
from jaxtyping import Array

from jaxgrow.energy.collision import Collision
from jaxgrow.energy.contact import Contact
from jaxgrow.energy.pair import Pairs
from jaxgrow.energy.term import Term
from jaxgrow.energy.terms import MEMBRANE_TERMS
from jaxgrow.state import Membrane, Particles


EnergyFunction: TypeAlias = Callable[[Particles | None, Membrane | None], Array]
"""Energy of particles and membrane, in F(0) r0."""

ExtraTerms: TypeAlias = Sequence[Term | EnergyFunction]
"""Additional energies."""


_BUILT_IN = frozenset(
    [*(t.name for t in MEMBRANE_TERMS), Pairs.name, Contact.name, Collision.name]
)


def check_names(terms: Sequence[Term]) -> None:
    """Refuse terms that share a name: rest data and loops are kept by it.

    Raises:
        ValueError: two classes have the same name, or one that of a term of jaxgrow.
    """
    classes: dict[str, type[Term]] = {}
    for term in terms:
        name = term.name
        if name in _BUILT_IN:
            raise ValueError(
                f"a term is named {name!r}, as one of jaxgrow's own is; give its class "
                "another name."
            )
        if classes.setdefault(name, type(term)) is not type(term):
            raise ValueError(
                f"two terms are named {name!r}; give each class a name of its own."
            )


class _Function(eqx.Module):
    """Plain function as an energy; each object is another program."""

    function: EnergyFunction = eqx.field(static=True)

    @property
    def name(self) -> str:
        """Name of the function."""
        return getattr(self.function, "__name__", type(self.function).__name__)

    def __call__(self, particles: Particles | None, membrane: Membrane | None) -> Array:
        return self.function(particles, membrane)


def as_module(function: EnergyFunction) -> EnergyFunction:
    """Wrap a function; its arrays, if any, become arguments of a program."""
    own = function if isinstance(function, eqx.Module) else _Function(function)
    return cast(EnergyFunction, own)
