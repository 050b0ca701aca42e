r"""Energy of the springs on the membrane's edges (paper §3).

.. math::
    E = \sum_e \tfrac12 k (\ell_e - (1 - \tau) \ell^0_e)^2

with the spring stiffness k in F(0)/r0 and lengths in r0; :math:`\ell^0` is the length
of the edge when the springs were last reset.

The pretension :math:`\tau` is ours; the paper resets to :math:`\ell^0` itself. With
:math:`\tau = 0` a membrane has no linear stiffness out of its plane right after each
reset, so it dives into every gap between the particles that it adheres to, and
crumples at the base of a lesion. The paper wants "a small tension in the surface" that
acts "as a smoothing factor"; :math:`\tau` is that tension. Its force
:math:`k \tau \ell` per edge, proportional to the length, also draws every vertex
towards the mean of its neighbours, which keeps triangles even.
"""

import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from jaxgrow.numerics import safe_norm
from jaxgrow.parameters import Parameters
from jaxgrow.state import Membrane


def edge_length(membrane: Membrane) -> Float[Array, " e"]:
    """Length of every edge, in r0; 0 for padding."""
    start, end = membrane.vertices[membrane.edges.T]
    return jnp.where(membrane.edge_alive, safe_norm(end - start), 0)


def spring_energy(membrane: Membrane, parameters: Parameters) -> Float[Array, ""]:
    """Energy in F(0) r0."""
    rest = (1 - parameters.pretension) * membrane.rest_length
    stretch = edge_length(membrane) - rest
    square = jnp.where(membrane.edge_alive, stretch, 0) ** 2
    return 0.5 * parameters.spring_stiffness * jnp.sum(square)


def numbers_of_springs(parameters: Parameters, dtype: DTypeLike) -> Float[Array, "2"]:
    """The law as its loop takes it, see `jaxgrow.kernels.springs`."""
    law = parameters.spring_stiffness, parameters.pretension
    return jnp.stack([jnp.asarray(number, dtype) for number in law])
