"""JAX primitive of a linear map whose transpose is a function of its own.

A derivative is a linear map of tangents, and its transpose one of cotangents. Both are
given here as compiled functions that JAX does not trace: they may solve a system by any
means. `jax.custom_derivatives.linear_call` does the same, but cannot be batched, and
traces both functions at every call.

*Batching* over vectors (`jax.jacfwd`, `jax.jacrev`) calls the function for one vector
after the other, so every row has the bits of a single call, and no program depends on
their number. The function itself is never batched.

*Constants* are all inputs besides the vector: a derivative in these would be a second
one, and is refused.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float, PyTree

from jaxgrow.equilibrium.transformations import SECOND_DERIVATIVE, VALUES_WITHHELD


Direction: TypeAlias = Callable[[PyTree, Float[Array, " k"]], Float[Array, " l"]]
"""Function of (constants, vector) to vector, linear in the vector."""


def linear_map(
    forward: Direction,
    backward: Direction,
    constants: PyTree,
    vector: Float[Array, " k"],
    rows: int,
) -> Float[Array, " l"]:
    """Apply a linear map, with the given transpose for reverse mode.

    Args:
        forward: the map; jitted, and the same object at every call.
        backward: its transpose; jitted, and the same object at every call.
        constants: further inputs of both.
        vector: to be mapped.
        rows: length of the image.

    Raises:
        ValueError: the constants are differentiated or batched.
    """
    leaves, structure = jax.tree.flatten(constants)
    return _map.bind(
        vector,
        *leaves,
        forward=forward,
        backward=backward,
        structure=structure,
        shape=(rows,),
    )


_map = Primitive("linear_map")


@_map.def_impl
def _impl(
    vector: Array, *leaves: Array, forward: Direction, structure: Any, **_: Any
) -> Array:
    constants = jax.tree.unflatten(structure, leaves)
    return _one_by_one(forward, constants, vector)


def _one_by_one(forward: Direction, constants: PyTree, vector: Array) -> Array:
    """Map all vectors along the last axis, one at a time."""
    if vector.ndim == 1:
        return forward(constants, vector)
    images = [_one_by_one(forward, constants, row) for row in vector]
    return jnp.stack(images)


@_map.def_abstract_eval
def _abstract(vector: Any, *_: Any, shape: tuple[int, ...], **__: Any) -> ShapedArray:
    return ShapedArray(shape, vector.dtype)


def _staged(
    vector: Array, *leaves: Array, forward: Direction, structure: Any, **_: Any
) -> Array:
    """Map all vectors within a program, as a loop."""
    each = partial(forward, jax.tree.unflatten(structure, leaves))
    for _axis in range(vector.ndim - 1):
        each = partial(jax.lax.map, each)
    return each(vector)


def _jvp(
    primals: Sequence[Array], tangents: Sequence[Any], **how: Any
) -> tuple[Array, Any]:
    moved, *others = tangents
    if any(not isinstance(other, ad.Zero) for other in others):
        raise ValueError(SECOND_DERIVATIVE)
    image = _map.bind(*primals, **how)
    if isinstance(moved, ad.Zero):
        return image, ad.Zero(jax.typeof(image).to_tangent_aval())
    return image, _map.bind(moved, *primals[1:], **how)


def _transpose(
    weight: Any,
    vector: Any,
    *leaves: Array,
    forward: Direction,
    backward: Direction,
    structure: Any,
    **_: Any,
) -> list[Any]:
    if any(ad.is_undefined_primal(leaf) for leaf in leaves):
        raise ValueError(SECOND_DERIVATIVE)
    shape, nothing = vector.aval.shape, [None] * len(leaves)
    if isinstance(weight, ad.Zero):
        return [ad.Zero(vector.aval), *nothing]
    pulled = _map.bind(
        weight,
        *leaves,
        forward=backward,
        backward=forward,
        structure=structure,
        shape=shape,
    )
    return [pulled, *nothing]


def _batch(
    values: Sequence[Array], axes: Sequence[Any], *, shape: tuple[int, ...], **how: Any
) -> tuple[Array, int]:
    (vector, *leaves), (axis, *others) = values, axes
    if any(other is not batching.not_mapped for other in others):
        raise ValueError(VALUES_WITHHELD)
    vectors = jnp.moveaxis(vector, axis, 0)
    batched = (vectors.shape[0], *shape)
    return _map.bind(vectors, *leaves, shape=batched, **how), 0


ad.primitive_jvps[_map] = _jvp
ad.primitive_transposes[_map] = _transpose
batching.primitive_batchers[_map] = _batch
mlir.register_lowering(_map, mlir.lower_fun(_staged, multiple_results=False))
