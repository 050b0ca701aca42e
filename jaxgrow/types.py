"""Names of types that several modules share."""

from typing import TypeAlias

from jaxtyping import Array, Float


Scalar: TypeAlias = float | Float[Array, ""]
"""A number that may be a Python float or traced by JAX."""

Columns: TypeAlias = tuple[Float[Array, "..."], ...]
"""x, y and z of many vectors: arithmetic on rows of three is several times slower."""
