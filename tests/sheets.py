"""Plane triangle meshes, as a user makes them."""

import numpy as np


def square(side):
    """Vertices at whole coordinates and faces of a square; normals up."""
    y, x = np.mgrid[:side, :side]
    vertices = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(float)
    index = np.arange(side * side).reshape(side, side)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return vertices, faces
