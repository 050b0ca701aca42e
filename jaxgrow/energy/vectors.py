"""Vector arithmetic on tuples of components.

Energies of one element are written with these: a component is a scalar where the
energy of a single element is traced, and an array where many are evaluated at once
(arithmetic on rows of three is several times slower).
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.numerics.guards import safe_root
from jaxgrow.runtime.types import Columns


def split(rows: Float[Array, "*p 3"]) -> Columns:
    """Return the components of an array of rows."""
    return rows[..., 0], rows[..., 1], rows[..., 2]


def minus(a: Columns, b: Columns) -> Columns:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def dot(a: Columns, b: Columns) -> Float[Array, "*p"]:
    """Return the scalar product a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Columns, b: Columns) -> Columns:
    """Return the vector product a × b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def norm(a: Columns) -> Float[Array, "*p"]:
    """Return the Euclidean norm, with derivative 0 (not NaN) at length 0."""
    return safe_root(dot(a, a))


def unit(a: Columns, length: Float[Array, "*p"]) -> Columns:
    """Return the direction of a vector of known length; 0 for length 0."""
    scale = 1 / jnp.where(length > 0, length, 1)
    return a[0] * scale, a[1] * scale, a[2] * scale
