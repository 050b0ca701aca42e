"""Scenes of few shapes, so that little is compiled: 64 particles, 256 vertices."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.mesh.surface import Surface
from jaxgrow.transfer.device import put_membrane, put_particles

from .derivatives import changed, settled


SLOTS = 64


@pytest.fixture(scope="session")
def make_particles():
    """Particles in 64 slots, some of them held."""

    def make(position, held=None, species=None):
        position = np.atleast_2d(np.asarray(position, float))
        held = np.zeros(len(position), bool) if held is None else np.asarray(held)
        species = np.zeros(len(position), int) if species is None else species
        return put_particles(position, species, held, SLOTS)

    return make


@pytest.fixture(scope="session")
def make_membrane():
    """A flat square grid centred at 0, rim pinned, normals up, in 256 slots."""

    def make(side=7, spacing=1.0, height=None):
        line = spacing * (np.arange(side) - (side - 1) / 2)
        x, y = np.meshgrid(line, line)
        vertices = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
        index = np.arange(side * side).reshape(side, side)
        a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
        c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
        faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
        fixed = np.zeros(side * side, bool)
        fixed[np.concatenate([index[0], index[-1], index[:, 0], index[:, -1]])] = True
        if height is not None:
            vertices[:, 2] = height(vertices[:, 0], vertices[:, 1])
        middle = int(index[side // 2, side // 2])
        return put_membrane(Surface(vertices, faces, fixed, middle))

    return make


@pytest.fixture(scope="session")
def cluster(make_particles):
    """Sixty particles at random in a box, one per r0³, three of them held."""
    rng = np.random.default_rng(0)
    held = np.arange(60) % 20 == 0
    return make_particles(rng.uniform(0, 60 ** (1 / 3), (60, 3)), held)


@pytest.fixture(scope="session")
def bed(make_particles, make_membrane):
    """Particles under a membrane, the lowest of them held."""
    rng = np.random.default_rng(2)
    position = rng.uniform([-2.2, -2.2, -2.0], [2.2, 2.2, -0.5], (50, 3))
    return make_particles(position, position[:, 2] < -1.6), make_membrane()


@pytest.fixture(scope="session")
def load():
    """A load on one vertex, none on the others."""

    def make(vertex, force):
        return jnp.zeros((256, 3)).at[vertex].set(jnp.asarray(force, float))

    return make


@pytest.fixture(scope="session")
def cage(make_particles):
    """Particles, a third of them held."""
    rng = np.random.default_rng(8)
    held = np.arange(18) % 3 == 0
    particles = make_particles(rng.uniform(0, 2.2, (18, 3)), held, held.astype(int))
    return settled(particles, parameters=changed(tumour_stiffness=2.0))
