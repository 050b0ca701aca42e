"""Guards of precision, and of formulas at their singular points."""

import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float


def safe_divide(
    numerator: Float[Array, "*shape"],
    denominator: Float[Array, "*shape"],
    where: Bool[Array, "*shape"],
) -> Float[Array, "*shape"]:
    """Divide where ``where`` holds, else return 0; derivatives are finite.

    The denominator, not the quotient, is replaced: a ``where`` around the quotient
    alone lets the NaN of the branch not taken through into the derivative.
    """
    return jnp.where(where, numerator / jnp.where(where, denominator, 1), 0)


def safe_norm(vector: Float[Array, "*shape 3"]) -> Float[Array, "*shape"]:
    """Return the Euclidean norm, with gradient 0 (not NaN) at the null vector.

    The singularity is the direction of a vector of length 0: two particles at the
    same position, a spring of length 0, a particle on the membrane. A vector that is
    not finite keeps a length that is not.
    """
    return safe_root(jnp.sum(vector**2, axis=-1))


def safe_root(square: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Return the square root, with derivative 0 at 0."""
    some = square != 0
    return jnp.where(some, jnp.sqrt(jnp.where(some, square, 1)), 0)


def farthest_two(moved: Float[Array, "n 3"]) -> Float[Array, ""]:
    """Return the sum of the two largest displacements.

    It bounds how much nearer any two of the points came.

    A single point that moves (a daughter) may so go the whole skin before a list
    becomes invalid, twice as far as if each point were allowed half of the skin.
    """
    square = jnp.sum(moved**2, axis=1)
    # not argmax, which takes two and a half times as long on a CPU
    first = jnp.max(square)
    below = square < first
    second = jnp.max(jnp.where(below, square, 0))
    second = jnp.where(jnp.sum(~below) > 1, first, second)
    return jnp.sqrt(first) + jnp.sqrt(second)


def smallest_distance(dtype: DTypeLike) -> float:
    """Return the distance that replaces 0 in a power or a logarithm.

    Small enough that a barrier still repels at any distance that coordinates can
    resolve, and large enough that the square of its force does not overflow.
    """
    return 1e-30 if jnp.finfo(dtype).bits > 32 else 1e-12


def check_precision(dtype: DTypeLike) -> None:
    """Raise if arrays have 64 bits where JAX computes in 32.

    Raises:
        ValueError: JAX would round some of the arrays and not others.
    """
    if jnp.finfo(dtype).bits > 32 and jnp.result_type(float) != jnp.float64:
        raise ValueError(
            "the positions have 64 bits and JAX computes in 32 here; stay within the "
            "`with jax.enable_x64(True):` that they come from, or put "
            'jax.config.update("jax_enable_x64", True) before everything.'
        )
