"""Names of types that several modules share."""

from typing import TypeAlias

from jaxtyping import Array, Float


Scalar: TypeAlias = float | Float[Array, ""]
"""A number that may be a Python float or traced by JAX."""
