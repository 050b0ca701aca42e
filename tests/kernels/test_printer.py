"""Printed functions compute what JAX computes."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.kernels.printer import print_function, UnprintableError


def printed(function, names):
    """A printed function, as Python runs it."""
    space = {"math": math, "np": np}
    exec(print_function("f", function, names), space)
    return space["f"]


FUNCTIONS = {
    "arithmetic": lambda a, b: (a * b - a / b + a**3 - b**-2 + (-a) ** 4,),
    "choices": lambda a, b: (
        jnp.where(a > b, a, b * 2),
        jnp.maximum(a, b) + jnp.minimum(a, 1.0),
        jnp.clip(a, 0.3, 0.7),
    ),
    "functions": lambda a, b: (
        jnp.exp(a) * jnp.log(b) + jnp.sqrt(a * b),
        jnp.arctan2(a, b) + jnp.sin(a) * jnp.cos(b) - jnp.tan(a),
        jnp.tanh(a) + jnp.abs(a - b) + jnp.sign(a - b) + jnp.square(b),
    ),
    "flags": lambda a, b: (
        jnp.where((a > 0.2) & ~(b < 0.1) | (a == b), 1.0, 0.0),
        (a > b).astype(float),
    ),
    "constants": lambda a, b: (a + 0.0, b * 1.0, a * np.float64(0.1), a * jnp.inf),
    "derivative": lambda a, b: jax.grad(
        lambda x, y: jnp.where(x > y, x**2 * y, jnp.sqrt(x + y)), argnums=(0, 1)
    )(a, b),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_printed_function_is_the_same(name):
    function = FUNCTIONS[name]
    own = printed(function, ["a", "b"])
    for a, b in [(0.3, 0.8), (0.9, 0.2), (0.5, 0.5), (1.7, 2.5)]:
        wanted = [float(x) for x in function(jnp.asarray(a), jnp.asarray(b))]
        np.testing.assert_allclose(own(a, b), wanted, rtol=1e-14)


def test_equal_expressions_are_printed_once_and_unused_ones_not_at_all():
    def function(a, b):
        _ = jnp.exp(a) / b
        return ((a * b) + (b * a), a * b)

    source = print_function("f", function, ["a", "b"])
    assert source.count("*") == 1
    assert "exp" not in source


@pytest.mark.parametrize(
    "function, what",
    [
        (lambda a: (jnp.sum(jnp.stack([a, a])),), r"of shape \(\d*,\)"),
        (lambda a: (jax.lax.digamma(a),), "digamma"),
        (
            lambda a: (jax.lax.while_loop(lambda x: x < 9, lambda x: x + 1, a),),
            "while",
        ),
    ],
)
def test_unknown_primitive_is_refused_by_its_name(function, what):
    with pytest.raises(UnprintableError, match=what):
        print_function("f", function, ["a"])
