"""Sheets that are hard for what looks for encounters and intersections in them."""

import numpy as np

from jaxgrow.mesh.collision_mesh import Sheet


def rough(count, rng, size=1.0):
    """A square of triangles, crumpled at random, over a few walls."""
    y, x = np.mgrid[:count, :count]
    flat = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(float)
    vertices = flat + 0.45 * rng.normal(size=flat.shape)
    index = np.arange(count**2).reshape(count, count)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return sheet(size * vertices, faces, rng.random(len(vertices)) < 0.7)


def sheet(vertices, faces, moving=None):
    if moving is None:
        moving = np.ones(len(vertices), bool)
    return Sheet(vertices, faces, moving, len(vertices), len(faces))


def soup(triangles):
    """Triangles that share no vertex."""
    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    return sheet(np.reshape(triangles, (-1, 3)).astype(float), faces)


def scattered(count, rng):
    """Triangles of very different size, some of them needles, segments and points."""
    size = 10 ** rng.uniform(-2, 0.7, (count, 1, 1))
    triangles = rng.uniform(-2, 2, (count, 1, 3)) + size * rng.normal(
        size=(count, 3, 3)
    )
    triangles[::5, 2] = triangles[::5, 1]
    triangles[::7, 1:] = triangles[::7, :1]
    triangles[1::9, 2] = 0.5 * (triangles[1::9, 0] + triangles[1::9, 1])
    return soup(triangles)


def on_a_lattice(count, rng):
    """Triangles with small whole coordinates: many touch, are coplanar, or both."""
    return soup(rng.integers(0, 4, (count, 3, 3)))


def two_sizes(rng):
    """A fine strip before a coarse wall that does not move, and no vertex of both."""
    fine = rough(8, rng, size=0.3)
    wall = np.array([[-9, -9, -0.4], [9, -9, -0.4], [9, 9, -0.4], [-9, 9, -0.4]])
    n = len(fine.vertices)
    faces = np.concatenate([fine.faces, n + np.array([[0, 1, 2], [0, 2, 3]])])
    moving = np.concatenate([fine.moving, np.zeros(4, bool)])
    return Sheet(
        np.concatenate([fine.vertices, wall]), faces, moving, n, len(fine.faces)
    )


def empty():
    return sheet(np.zeros((0, 3)), np.zeros((0, 3), int))


def of_every_kind():
    rng = np.random.default_rng(5)
    return {
        "rough": rough(10, rng),
        "rough and still": rough(6, np.random.default_rng(6)),
        "scattered": scattered(60, rng),
        "lattice": on_a_lattice(60, rng),
        "two sizes": two_sizes(rng),
        "one triangle": soup(rng.normal(size=(1, 3, 3))),
        "empty": empty(),
    }
