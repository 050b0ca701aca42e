"""A linear map of two programs: transposed, batched, staged, and never looked into."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.equilibrium.linear_map import linear_map


ROWS, COLUMNS = 3, 5
MATRIX = np.random.default_rng(0).normal(size=(ROWS, COLUMNS))


def made():
    """The product with a matrix, its transpose, and how often each was traced.

    Neither can be batched or differentiated by JAX: rows are summed in a loop whose
    length depends on values.
    """
    traced = {"forward": 0, "backward": 0}

    def summed(matrix, vector):
        def add(state):
            row, total = state
            return row + 1, total + matrix[:, row] * vector[row]

        start = 0, jnp.zeros(matrix.shape[0])
        return jax.lax.while_loop(lambda s: s[0] < len(vector), add, start)[1]

    @jax.jit
    def forward(matrix, vector):
        assert vector.ndim == 1
        traced["forward"] += 1
        return summed(matrix, vector)

    @jax.jit
    def backward(matrix, vector):
        assert vector.ndim == 1
        traced["backward"] += 1
        return summed(matrix.T, vector)

    def image(vector, matrix=MATRIX):
        return linear_map(forward, backward, jnp.asarray(matrix), vector, ROWS)

    return image, traced


AT = jnp.arange(1.0, COLUMNS + 1)


def test_image_is_that_of_the_forward_function():
    image, _ = made()
    np.testing.assert_allclose(image(AT), MATRIX @ np.asarray(AT), rtol=1e-14)


@pytest.mark.parametrize("jacobian", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize("outer", [lambda f: f, jax.jit])
def test_jacobian_is_the_matrix(jacobian, outer):
    image, _ = made()
    found = outer(jacobian(lambda v: 2 * image(3 * v)))(AT)
    np.testing.assert_allclose(found, 6 * MATRIX, rtol=1e-14)


def test_transpose_of_the_transpose_is_the_map():
    image, _ = made()
    _, pull = jax.vjp(image, AT)
    found = jax.jacrev(lambda w: pull(w)[0])(jnp.ones(ROWS))
    np.testing.assert_allclose(found, MATRIX.T, rtol=1e-14)


def test_rows_of_a_batch_have_the_bits_they_have_alone():
    image, _ = made()
    vectors = jnp.asarray(np.random.default_rng(1).normal(size=(4, COLUMNS)))
    alone = [image(vector) for vector in vectors]
    np.testing.assert_array_equal(jax.vmap(image)(vectors), jnp.stack(alone))


def test_batches_of_batches_are_those_of_their_rows():
    image, _ = made()
    vectors = jnp.asarray(np.random.default_rng(1).normal(size=(2, 4, COLUMNS)))
    found = jax.vmap(jax.vmap(image, 1), 0)(vectors.swapaxes(1, 2))
    np.testing.assert_allclose(found, vectors @ MATRIX.T, rtol=1e-13)


def test_nothing_is_traced_twice():
    image, traced = made()
    for number in range(3):
        matrix = MATRIX + number
        jax.jacrev(lambda v, m=matrix: image(v, m))(AT + number)
        jax.jacfwd(lambda v, m=matrix: image(v, m))(AT + number)
        jax.grad(lambda v, m=matrix: image(v, m).sum())(AT + number)
    assert traced == {"forward": 1, "backward": 1}


@pytest.mark.parametrize(
    "differentiate", [jax.grad, lambda f: lambda x: jax.jvp(f, (x,), (jnp.ones(()),))]
)
def test_derivative_in_what_the_map_depends_on_is_refused(differentiate):
    image, _ = made()
    with pytest.raises(ValueError, match="first derivatives only"):
        differentiate(lambda s: image(AT, s * jnp.asarray(MATRIX)).sum())(jnp.ones(()))


def test_batch_of_what_the_map_depends_on_is_refused():
    image, _ = made()
    with pytest.raises(ValueError, match=r"jax\.vmap over values"):
        jax.vmap(lambda matrix: image(AT, matrix))(jnp.asarray(MATRIX)[None])
