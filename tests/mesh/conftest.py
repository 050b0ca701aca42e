"""Meshes that the mesh tests share."""

from __future__ import annotations

import numpy as np
import pytest

from jaxgrow.mesh.surface import Surface


@pytest.fixture(scope="session")
def grid():
    """A flat square patch with its rim fixed and the source in the middle."""

    def make(n, spacing=1.0, rng=None, noise=0.0):
        y, x = np.mgrid[: n + 1, : n + 1]
        vertices = spacing * np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
        index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
        a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
        c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
        faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
        fixed = np.zeros(len(vertices), dtype=bool)
        for side in (index[0], index[-1], index[:, 0], index[:, -1]):
            fixed[side] = True
        if rng is not None:
            vertices[~fixed] += noise * rng.normal(size=(np.count_nonzero(~fixed), 3))
        return Surface(vertices, faces, fixed, int(index[n // 2, n // 2]))

    return make


@pytest.fixture(scope="session")
def sphere():
    """A closed subdivided icosahedron; a tenth of the vertices fixed if asked for."""

    def make(level, radius=1.0, rng=None):
        phi = (1 + 5**0.5) / 2
        vertices = np.array([(s, t * phi, 0.0) for s in (-1, 1) for t in (-1, 1)])
        vertices = np.concatenate([np.roll(vertices, k, axis=1) for k in range(3)])
        # Faces of the icosahedron: triples at mutual distance 2, turned outwards.
        near = np.isclose(np.linalg.norm(vertices[:, None] - vertices, axis=2), 2.0)
        faces = np.array(
            [
                (i, j, k)
                for i in range(12)
                for j in range(i + 1, 12)
                for k in range(j + 1, 12)
                if near[i, j] and near[j, k] and near[k, i]
            ]
        )
        turn = np.linalg.det(vertices[faces]) < 0
        faces[turn] = faces[turn][:, ::-1]
        for _ in range(level):
            edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
            unique, middle = np.unique(edges, axis=0, return_inverse=True)
            new = middle.reshape(-1, 3) + len(vertices)
            vertices = np.concatenate([vertices, vertices[unique].mean(axis=1)])
            (a, b, c), (ab, bc, ca) = faces.T, new.T
            parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
            faces = np.concatenate([np.stack(part, axis=1) for part in parts])
        vertices = radius * vertices / np.linalg.norm(vertices, axis=1)[:, None]
        fixed = np.zeros(len(vertices), dtype=bool)
        source = -1
        if rng is not None:
            fixed = rng.random(len(vertices)) < 0.1
            source = int(rng.integers(len(vertices)))
        return Surface(vertices, faces, fixed, source)

    return make


@pytest.fixture(scope="session")
def diamond():
    """Two triangles (a, b, c), (b, a, d) with a triangle on each outer edge.

    Vertices 0 to 3 are a, b, c, d; the edge a-b is the only interior edge between
    vertices that are not on the rim alone, so it is the only one that may be flipped
    without leaving a corner of the rim with two edges.
    """

    def make(a, b, c, d, reach=2.0):
        inner = np.array([a, b, c, d], dtype=float)
        middle = inner.mean(axis=0)
        quad = [(0, 3), (3, 1), (1, 2), (2, 0)]
        outer = [middle + reach * (inner[i] + inner[j] - 2 * middle) for i, j in quad]
        vertices = np.concatenate([inner, outer])
        faces = [(0, 1, 2), (1, 0, 3)]
        # Seen from inside, the outer edges run 0-3-1-2-0; the neighbours run them back.
        faces += [(j, i, 4 + k) for k, (i, j) in enumerate(quad)]
        fixed = np.arange(8) >= 4
        return Surface(vertices, np.array(faces), fixed)

    return make


@pytest.fixture(scope="session")
def nobody():
    """No particles."""
    return np.zeros((0, 3))
