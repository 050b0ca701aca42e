"""Known miscompilations of the toolchain; see the exclusions in pyproject.toml."""

import jax
import jax.numpy as jnp
import pytest


@pytest.mark.parametrize("dtype, n", [(jnp.float64, 16_385), (jnp.float32, 32_769)])
def test_jit_matches_eager_vmapped_matvec(dtype, n):
    # https://github.com/jax-ml/jax/issues/39103 (jaxlib 0.10.2 on CPU)
    x = jnp.zeros((n, 3), dtype).at[:, 0].set(jnp.arange(n, dtype=dtype))
    f = jax.vmap(lambda row: jnp.sum((jnp.eye(3, dtype=dtype) @ row) ** 2))
    assert jnp.allclose(jax.jit(f)(x), f(x))
