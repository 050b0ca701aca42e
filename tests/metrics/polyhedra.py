"""Lesions that are polyhedra of revolution, in arrays of the same shapes."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrow.metrics import ShapeMetrics


SEGMENTS = 24
SECTOR = SEGMENTS / 2 * np.sin(2 * np.pi / SEGMENTS)  # area of the polygon of radius 1

# radius and height of the rings from the rim inwards, and height of the tip
PROFILES = {
    "dome": ([(6, 0), (3, 0.0), (2.9, 0.6), (2.4, 1.6), (1.3, 2.6)], 3.0),
    "cylinder": ([(6, 0), (1.5, 0), (1.5, 0.6), (1.5, 5.0), (1.0, 5.8)], 6.2),
    "mushroom": (
        [(6, 0), (1.3, 0), (1.3, 0.6), (1, 1.4), (1, 2.4), (2.5, 3.5), (1.5, 4.5)],
        5.0,
    ),
}

OF_TUMOUR = {
    "tumour_diameter_mm",
    "body_diameter_mm",
    "body_equivalent_diameter_mm",
    "body_sphericity",
}
NAMES = tuple(ShapeMetrics.__dataclass_fields__)


def revolve(rings, tip):
    """Vertices and faces, normals away from the axis' inside, and the rim."""
    angle = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = [np.column_stack([r * circle, np.full(SEGMENTS, z)]) for r, z in rings]
    vertices = np.concatenate([*points, [[0.0, 0.0, tip]]])
    index = np.arange(len(rings) * SEGMENTS).reshape(len(rings), SEGMENTS)
    after = np.roll(index, -1, axis=1)
    faces = []
    for k in range(len(rings) - 1):
        a, b, c, d = index[k], after[k], after[k + 1], index[k + 1]
        faces += [np.stack([a, b, c], 1), np.stack([a, c, d], 1)]
    last = np.full(SEGMENTS, len(vertices) - 1)
    faces.append(np.stack([index[-1], after[-1], last], 1))
    rim = np.arange(len(vertices)) < SEGMENTS
    return vertices, np.concatenate(faces), rim


def flattened(state, share=0.0):
    """The state with all heights of the membrane scaled."""
    return eqx.tree_at(
        lambda s: s.membrane.vertices,
        state,
        state.membrane.vertices * jnp.array([[1, 1, share]]),
    )


def bumpy(state, seed, size=0.02):
    """The state with noise on the free vertices of the membrane."""
    noise = size * np.random.default_rng(seed).normal(size=(256, 3))
    free = np.asarray(state.membrane.free)[:, None]
    return eqx.tree_at(
        lambda s: s.membrane.vertices, state, state.membrane.vertices + noise * free
    )
