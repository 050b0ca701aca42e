"""Springs alone, as a membrane without faces."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrow.mesh.surface import Surface
from jaxgrow.transfer.device import put_membrane


def springs(vertices, edges, rest_length, pinned):
    """Vertices and springs without faces, in the arrays that other membranes have.

    Each spring is a side of a triangle of its own, of which nothing else is alive.
    """
    count, tips = len(vertices), len(vertices) + np.arange(len(edges))
    surface = Surface(
        np.zeros((count + len(edges), 3)),
        np.concatenate([edges, tips[:, None]], axis=1),
        np.concatenate([pinned, np.zeros(len(edges), bool)]),
    )
    membrane = put_membrane(surface)
    rows = rows_of(membrane, edges)
    length = jnp.zeros_like(membrane.rest_length).at[rows].set(rest_length)
    membrane = membrane.with_rest_length(length)
    return eqx.tree_at(
        lambda m: (m.vertices, m.vertex_alive, m.face_alive, m.edge_alive),
        membrane,
        (
            jnp.zeros_like(membrane.vertices).at[:count].set(vertices),
            jnp.arange(len(membrane.vertices)) < count,
            jnp.zeros_like(membrane.face_alive),
            jnp.zeros_like(membrane.edge_alive).at[rows].set(True),
        ),
    )


def rows_of(membrane, edges):
    """Where these edges are among those of a membrane."""
    row = {tuple(edge): i for i, edge in enumerate(np.asarray(membrane.edges).tolist())}
    return np.array([row[tuple(sorted(edge))] for edge in np.asarray(edges).tolist()])
