r"""Energy terms: the energy of one element, and the elements of a scene.

A term is written once, as a function of the coordinates of *one* element (an edge, a
hinge, a triangle, a particle, ...), of its rest data and of its parameters. The energy
is the sum over all elements; forces and Hessian products are derivatives that JAX
takes,

.. math::
    E = \sum_e W(x_e, q_e, p), \quad F = -\nabla E, \quad
    H v = \left.\frac{d}{d\epsilon}\right|_0 \nabla E(x + \epsilon v),

by `jax.vmap` over the elements where XLA evaluates them, and on a CPU by loops that are
generated from the same function (`jaxgrow.kernels.roots`).

Nodes are numbered through: first the particles' slots, then the membrane's vertices.
"""

from abc import abstractmethod
from types import SimpleNamespace
from typing import Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.energy.parameters import Parameters
from jaxgrow.runtime.types import Columns
from jaxgrow.state import Membrane, Particles


class Elements(NamedTuple):
    """Elements of a term in a scene.

    Attributes:
        nodes: the nodes of each.
        rest: rest data of each.
        alive: False for padding.
    """

    nodes: Int[Array, "e k"]
    rest: Float[Array, "e q"]
    alive: Bool[Array, " e"]


class Term(eqx.Module):
    """Energy that is a sum over elements; subclass it to add one.

    Fields of a subclass are parameters of its own, which may be differentiated.

    Class attributes:
        name: of the term, for reports and errors.
        size: nodes of one element.
        parameters: the fields of `jaxgrow.Parameters` that `energy` uses.
    """

    name: ClassVar[str]
    size: ClassVar[int]
    parameters: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def energy(self, x: tuple[Columns, ...], rest: Columns, p: Any) -> Array:
        r"""Return the energy of one element, in F(0) r0.

        Args:
            x: for each node its three coordinates, in r0 (see
                `jaxgrow.energy.vectors`).
            rest: data of the element.
            p: has the `parameters` by name.
        """

    @abstractmethod
    def elements(
        self, particles: Particles | None, membrane: Membrane | None
    ) -> Elements | None:
        """Return the elements of a scene; None if it has none.

        Args:
            particles: or None for a membrane alone.
            membrane: or None for particles alone.
        """


class MembraneTerm(Term):
    """Term of the membrane's elasticity, with rest data reset like springs.

    Class attributes:
        modulus: the parameter that is a factor of the energy; the term is left out
            where it is 0.
        per: whether an element belongs to an edge or to a face of the membrane.
        edges: largest number of edges between two nodes of an element.
    """

    modulus: ClassVar[str]
    per: ClassVar[Literal["edge", "face"]]
    edges: ClassVar[int] = 1

    @abstractmethod
    def rest(self, x: tuple[Columns, ...]) -> Columns:
        """Return the rest data of one element where it is; may be empty.

        Args:
            x: for each node its three coordinates, in r0.
        """

    @abstractmethod
    def stencil(
        self, membrane: Membrane
    ) -> tuple[Int[Array, "e k"], Bool[Array, " e"]]:
        """Return the vertices of each element, and False for padding.

        There is one for every slot of an edge, or of a face, see `per`.
        """

    def elements(
        self, particles: Particles | None, membrane: Membrane | None
    ) -> Elements | None:
        """Return the elements of the membrane."""
        if membrane is None:
            return None
        first = 0 if particles is None else particles.position.shape[0]
        vertices, alive = self.stencil(membrane)
        return Elements(vertices.astype(int) + first, membrane.rest[self.name], alive)

    def at_rest(self, membrane: Membrane) -> Float[Array, "e q"]:
        """Return new rest data of all elements, as they are now; 0 for padding."""
        vertices, alive = self.stencil(membrane)
        rest = self._rest_at(membrane.vertices, vertices, alive)
        return jnp.where(alive[:, None], rest, 0)

    def _rest_at(
        self,
        positions: Float[Array, "m 3"],
        vertices: Int[Array, "e k"],
        alive: Bool[Array, " e"],
    ) -> Float[Array, "e q"]:
        columns = jax.vmap(self.rest)(_gathered(positions, vertices, alive))
        none = jnp.zeros((len(alive), 0), positions.dtype)
        return jnp.stack(columns, axis=1) if columns else none


class HealthyTerm(MembraneTerm):
    r"""Term of the healthy membrane's elasticity, which is never reset.

    Its rest data are those of the reference positions, and one more: the healthy share
    :math:`h = \prod_v (1 - m_v)` of the element, with the hyperplasia m of its
    vertices. `energy` must be in proportion to it, so that what is hyperplastic has no
    memory.
    """

    def at_rest(self, membrane: Membrane) -> Float[Array, "e q"]:
        """Return the rest data of all elements; 0 for padding."""
        vertices, alive = self.stencil(membrane)
        rest = self._rest_at(membrane.reference, vertices, alive)
        healthy = jnp.prod(1 - membrane.hyperplasia[vertices], axis=1)
        rest = jnp.concatenate([rest, healthy[:, None]], axis=1)
        return jnp.where(alive[:, None], rest, 0)


def values_of(term: Any, parameters: Parameters) -> SimpleNamespace:
    """Return the parameters that a term uses, by name."""
    return SimpleNamespace(**{n: getattr(parameters, n) for n in term.parameters})


def energy_of_elements(
    term: Term,
    nodes: Float[Array, "n 3"],
    elements: Elements,
    parameters: Parameters,
) -> Float[Array, ""]:
    """Return the sum of the energy over all elements, in F(0) r0.

    Args:
        term: whose elements they are.
        nodes: particles, then vertices, in r0.
        elements: of the scene.
        parameters: of all terms.
    """
    x = _gathered(nodes, elements.nodes, elements.alive)
    p = values_of(term, parameters)
    rest = tuple(jnp.where(elements.alive, q, 1) for q in elements.rest.T)
    each = jax.vmap(lambda at, q: term.energy(at, q, p))(x, rest)
    return jnp.sum(jnp.where(elements.alive, each, 0))


def _gathered(
    nodes: Float[Array, "n 3"], index: Int[Array, "e k"], alive: Bool[Array, " e"]
) -> tuple[Columns, ...]:
    """Gather the node coordinates of each element; padding gets regular ones.

    Derivatives of degenerate padding would be NaN, and NaN times 0 is NaN.
    """
    corners = tuple(nodes[index[:, k]] for k in range(index.shape[1]))
    regular = [
        [float(k % 2), float(k // 2 % 2), 0.25 * k * k] for k in range(index.shape[1])
    ]
    return tuple(
        tuple(jnp.where(alive, corner[:, axis], regular[k][axis]) for axis in range(3))
        for k, corner in enumerate(corners)
    )
