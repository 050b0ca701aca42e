"""Type aliases that several modules share."""

from collections.abc import Sequence
from typing import Any, TypeAlias

from jax.typing import ArrayLike
from jaxtyping import Array, Float


Scalar: TypeAlias = float | Float[Array, ""]
"""A number that may be a Python float or traced by JAX."""

Columns: TypeAlias = tuple[Float[Array, "..."], ...]
"""x, y and z of many vectors: arithmetic on rows of three is several times slower."""

Given: TypeAlias = ArrayLike | Sequence[Any]
"""An array as users give it: of NumPy, of JAX, a number, or nested lists."""
