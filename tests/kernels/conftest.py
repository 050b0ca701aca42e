"""Surfaces with triangles that loops must not mistake."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.transfer.constructors import make_membrane


SIDE = 6


@pytest.fixture(scope="session")
def make_sheet():
    """A grid of heights that are told by a function."""

    def make(height):
        """A grid with triangles that are needles, and a dead one."""
        y, x = np.mgrid[:SIDE, :SIDE].astype(float)
        vertices = np.stack([0.8 * x, 0.8 * y, height(x, y)], axis=-1).reshape(-1, 3)
        index = np.arange(SIDE**2).reshape(SIDE, SIDE)
        a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
        c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
        faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
        vertices[8] = 0.5 * (vertices[7] + vertices[14]) + [1e-9, 0, 0]
        membrane = make_membrane(vertices, faces)
        alive = jnp.arange(len(faces)) != 3
        return eqx.tree_at(lambda m: m.face_alive, membrane, alive)

    return make
