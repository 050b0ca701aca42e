"""The tree of boxes finds the nearest of all faces."""

import numpy as np
import pytest

from jaxgrow.mesh.proximity import nearest_on_mesh

from .. import brute_force
from .sheets import of_every_kind


MESHES = {n: s for n, s in of_every_kind().items() if len(s.faces)}


def points_around(mesh, rng):
    """Near, far, on vertices, on edges, and inside of faces."""
    vertices, corners = mesh.vertices, mesh.vertices[mesh.faces]
    return np.concatenate(
        [
            rng.normal(size=(100, 3)) * 2,
            rng.normal(size=(20, 3)) * 100,
            vertices[:40],
            corners[:20, :2].mean(axis=1),
            corners[:20].mean(axis=1),
        ]
    )


@pytest.mark.parametrize("name", MESHES)
def test_nearest_points_are_those_of_all_faces(name):
    mesh = MESHES[name]
    points = points_around(mesh, np.random.default_rng(0))
    found = nearest_on_mesh(points, mesh.vertices, mesh.faces)
    every = brute_force.nearest(points, mesh.vertices, mesh.faces)
    wanted = {"rtol": 1e-12, "atol": 1e-13}
    np.testing.assert_allclose(found.distance, every.min(axis=1), **wanted)
    to_closest = np.linalg.norm(points - found.closest, axis=1)
    np.testing.assert_allclose(to_closest, found.distance, rtol=1e-9, atol=1e-12)
    # of equally near faces any one is right
    there = every[np.arange(len(points)), found.face]
    np.testing.assert_allclose(there, found.distance, **wanted)
    assert found.face.dtype == np.int64


def test_of_equally_near_faces_the_first_is_found():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    vertices = np.concatenate([corners] * 30)
    faces = np.arange(90).reshape(-1, 3)
    found = nearest_on_mesh(np.array([[0.2, 0.2, 1.0]]), vertices, faces)
    assert found.face[0] == 0
