r"""Field on a lesion that rises from its base ring to its tip.

It is the solution of

.. math:: -\Delta u + k \, (1 - r) \, u = r

on the membrane, with the raisedness r of the surface (`jaxgrow.metrics.elevation`) and
the Laplacian of the curved surface: u is 0 where nothing is raised, and rises on the
raised part from its ring, evenly around it, to one place, the tip, which need not be
known. On a cylinder of length L its value at s is :math:`L s - s^2/2`, so the *rise*

.. math:: w = 1 - \sqrt{1 - u / \max u}

is the share s/L there, and on a flat disc the share of the way to the centre. Level
lines go round the lesion at every w from 0 to 1, whichever way it leans or bends.

Linear finite elements with lumped masses; the weights of edges are half the cotangents
of the angles opposite (Pinkall and Polthier, "Computing discrete minimal surfaces and
their conjugates", 1993). Conjugate gradients solve for u, and for its derivatives.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.numerics.guards import safe_divide, safe_norm, safe_root
from jaxgrow.state import Membrane


_SINK = 100.0
"""k, per r0²: u falls within a tenth of an r0 where nothing is raised."""

_ROUNDINGS = 10.0
"""Largest residual in units of rounding, relative to the right hand side."""

_ITERATIONS = 1000
"""A lesion of forty rows of triangles needs some hundred."""


class Patches(NamedTuple):
    """Triangles of a membrane, as areas.

    Attributes:
        vector: area times outward normal of each triangle, in r0²; 0 for padding.
        area: of each triangle; 0 for padding.
        share: a third of the areas around each vertex.
    """

    vector: Float[Array, "f 3"]
    area: Float[Array, " f"]
    share: Float[Array, " m"]


def patches_of(membrane: Membrane) -> Patches:
    """Compute the areas of a membrane's triangles and around its vertices."""
    corners = membrane.vertices[membrane.faces]
    vector = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    vector = jnp.where(membrane.face_alive[:, None], vector, 0)
    area = safe_norm(vector)
    zero = jnp.zeros_like(membrane.vertices[:, 0])
    thirds = jnp.broadcast_to(area[:, None] / 3, membrane.faces.shape)
    return Patches(vector, area, zero.at[membrane.faces].add(thirds))


def rise(
    membrane: Membrane, around: Float[Array, " m"], raised: Float[Array, " m"]
) -> Float[Array, " m"]:
    """Compute the rise w of each vertex, from 0 to 1; 0 if not raised.

    Args:
        membrane: in r0.
        around: area around each vertex.
        raised: raisedness of each vertex; 0 for padding.
    """
    u = _potential(membrane, around, raised)
    top = jnp.max(u)
    share = safe_divide(u, jnp.full_like(u, top), jnp.broadcast_to(top > 0, u.shape))
    return 1 - safe_root(jnp.clip(1 - share, 0, 1))


def _potential(
    membrane: Membrane, around: Float[Array, " m"], raised: Float[Array, " m"]
) -> Float[Array, " m"]:
    """Solve for u."""
    start, end = membrane.edges.T
    weight = jnp.where(membrane.edge_alive, _cotangents(membrane), 0)
    # vertices without an area are padding, whose equation is u = 0
    sink = jnp.where(around > 0, _SINK * around * (1 - raised), 1)
    diagonal = sink.at[start].add(weight).at[end].add(weight)
    scale = 1 / jnp.where(diagonal > 0, diagonal, 1)

    def equations(u: Float[Array, " m"]) -> Float[Array, " m"]:
        flow = weight * (u[start] - u[end])
        return (sink * u).at[start].add(flow).at[end].add(-flow)

    def solve(_: object, right: Float[Array, " m"]) -> Float[Array, " m"]:
        found, _ = jax.scipy.sparse.linalg.cg(
            equations,
            right,
            tol=_ROUNDINGS * float(jnp.finfo(right.dtype).eps),
            maxiter=_ITERATIONS,
            M=lambda rest: scale * rest,
        )
        return found

    return jax.lax.custom_linear_solve(
        equations, around * raised, solve, symmetric=True
    )


def _cotangents(membrane: Membrane) -> Float[Array, " e"]:
    """Compute half the sum of the cotangents opposite to each edge."""
    ends = membrane.vertices[membrane.edges][:, :, None, :]
    there = membrane.opposite >= 0
    third = membrane.vertices[jnp.where(there, membrane.opposite, 0)]
    a, b = ends[:, 0] - third, ends[:, 1] - third
    double = safe_norm(jnp.cross(a, b))
    cotangent = safe_divide(jnp.sum(a * b, axis=-1), double, there & (double > 0))
    return jnp.sum(cotangent, axis=1) / 2
