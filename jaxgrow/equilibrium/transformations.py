"""Checks of JAX's transformations on computations that run on the host.

Relaxation and growth branch in Python on computed values (which list is too small,
which particle divides), so they need these: they are available under `jax.grad`,
`jax.jvp`, `jax.vjp`, `jax.linearize`, `jax.jacfwd` and `jax.jacrev`, and under no other
transformation. Only first derivatives exist.
"""

from collections.abc import Sequence
from typing import Any

import jax
from jax.core import Tracer
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, PyTree


VALUES_WITHHELD = (
    "jaxgrow relaxes and grows by Python loops over the numbers it finds, and "
    "jax.jit, jax.checkpoint and jax.vmap over values withhold them; call it outside "
    "of them (what it computes is compiled, and of an equilibrium only the end is "
    "kept), and instead of jax.vmap in a Python loop, or jaxgrow.grow_many."
)

SECOND_DERIVATIVE = (
    "an equilibrium has first derivatives only, and this is a second one "
    "(jax.hessian, jax.grad of jax.grad, …); take differences of jax.grad, or, for a "
    "sum of squares, J^T J with the Jacobian J of jax.jacfwd."
)


def is_differentiated(tree: PyTree) -> bool:
    """Return whether a leaf is being differentiated (traced)."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def primal(tree: PyTree) -> PyTree:
    """Strip the derivatives off all leaves, keeping their values.

    As `jax.lax.stop_gradient` on each leaf, but all leaves at once: under a derivative
    every operation on the host costs a millisecond.
    """
    leaves, structure = jax.tree.flatten(tree)
    traced = [k for k, leaf in enumerate(leaves) if isinstance(leaf, Tracer)]
    if traced:
        values = _primal.bind(*(leaves[k] for k in traced))
        for k, value in zip(traced, values, strict=True):
            leaves[k] = value
    return jax.tree.unflatten(structure, leaves)


_primal = Primitive("primal")
_primal.multiple_results = True
_primal.def_impl(lambda *leaves: list(leaves))
_primal.def_abstract_eval(lambda *avals: list(avals))


def _primal_jvp(
    primals: Sequence[Array], _: Sequence[Any]
) -> tuple[list[Array], list[ad.Zero]]:
    values = _primal.bind(*primals)
    return values, [ad.Zero(jax.typeof(a).to_tangent_aval()) for a in values]


ad.primitive_jvps[_primal] = _primal_jvp
batching.primitive_batchers[_primal] = lambda values, axes: (
    _primal.bind(*values),
    list(axes),
)
mlir.register_lowering(_primal, lambda _, *leaves: list(leaves))


def check_transformations(tree: PyTree) -> None:
    """Raise if these leaves cannot be computed with.

    Raises:
        ValueError: their values are withheld (`jax.jit`, `jax.checkpoint`, `jax.vmap`
            over values), or a second derivative is taken.
    """
    traced = [leaf for leaf in jax.tree.leaves(tree) if isinstance(leaf, Tracer)]
    if is_differentiated(primal(traced)):
        raise ValueError(VALUES_WITHHELD)
    if traced:
        _once(*traced)


def check_undifferentiated(tree: PyTree, what: str, instead: str) -> None:
    """Raise if host numbers without derivative are asked for under one.

    Args:
        tree: inputs of the computation.
        what: name of the result, for the message.
        instead: how to get a derivative, for the message.

    Raises:
        ValueError: a leaf is differentiated.
    """
    if is_differentiated(tree):
        raise ValueError(
            f"{what} is computed on the host and has no derivative, and one is being "
            f"taken here; {instead}, or ask for it outside of jax.grad."
        )


@jax.custom_jvp
def _once(*leaves: Array) -> tuple[Array, ...]:
    """Return the leaves; its JVP rule rejects second derivatives.

    A leaf that is still traced in the rule has a second derivative.
    """
    return leaves


@_once.defjvp
def _once_jvp(
    primals: Sequence[Array], tangents: Sequence[Any]
) -> tuple[tuple[Array, ...], tuple[Any, ...]]:
    if is_differentiated(primals):
        raise ValueError(SECOND_DERIVATIVE)
    return tuple(primals), tuple(tangents)
