"""Compiled programs are counted."""

import jax
import jax.numpy as jnp

from jaxgrow.compilations import count_compilations


def test_first_call_compiles_once_and_the_second_does_not():
    program = jax.jit(lambda x: 3 * x - 1)
    x = jnp.arange(5.0)
    with count_compilations() as first:
        program(x)
    with count_compilations() as second:
        program(x)
    assert first.count == 1
    assert second.count == 0


def test_new_shape_compiles_again():
    program = jax.jit(lambda x: 5 * x + 1)
    arrays = [jnp.zeros(n) for n in (3, 4)]
    with count_compilations() as seen:
        for array in arrays:
            program(array)
    assert seen.count == 2


def test_nothing_is_counted_after_the_block():
    x = jnp.arange(7.0)
    with count_compilations() as seen:
        pass
    jax.jit(lambda x: x * 7)(x)
    assert seen.count == 0
