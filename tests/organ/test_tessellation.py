import numpy as np
import pytest
import trimesh

from jaxgrow.mesh.quality import radius_ratio, side_lengths
from jaxgrow.mesh.topology import euler_number, is_manifold
from jaxgrow.organ.tessellation import circumcentres, scatter, tessellate


RADIUS = 5.0
BOX = np.full(3, -6.0), np.full(3, 6.0)


def sphere(points):
    return np.linalg.norm(points, axis=1) - RADIUS


def torus(points):
    ring = np.hypot(points[:, 0], points[:, 1]) - 4.0
    return np.hypot(ring, points[:, 2]) - 1.5


@pytest.fixture(scope="module")
def surface():
    return tessellate(sphere, *BOX, 1.0, np.random.default_rng(0))


@pytest.mark.parametrize("field, euler", [(sphere, 2), (torus, 0)])
def test_a_tessellation_has_the_topology_of_the_surface(field, euler):
    vertices, faces = tessellate(field, *BOX, 0.8, np.random.default_rng(1))
    assert is_manifold(faces, len(vertices))
    assert trimesh.Trimesh(vertices, faces, process=False).is_watertight
    assert euler_number(faces) == euler


def test_vertices_lie_on_the_surface(surface):
    np.testing.assert_allclose(sphere(surface[0]), 0.0, atol=1e-12)


def test_triangles_are_even_and_nearly_equilateral(surface):
    triangles = surface[0][surface[1]]
    assert radius_ratio(triangles).min() > 0.6
    assert 0.9 < np.median(side_lengths(triangles)) < 1.15
    assert side_lengths(triangles).max() < 1.6


def test_normals_point_outwards(surface):
    volume = trimesh.Trimesh(*surface, process=False).volume
    assert volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.02)


def test_scattered_points_keep_their_distance():
    points = scatter(sphere, *BOX, 1.0, np.random.default_rng(0))
    gaps = np.linalg.norm(points[:, None] - points, axis=2) + 9 * np.eye(len(points))
    assert gaps.min() >= 0.72


def test_circumcentres_are_equally_far_from_all_corners():
    points = np.random.default_rng(0).normal(size=(8, 3))
    tetrahedra = np.array([[0, 1, 2, 3], [4, 5, 6, 7]])
    centre = circumcentres(points, tetrahedra)
    reach = np.linalg.norm(points[tetrahedra] - centre[:, None], axis=2)
    np.testing.assert_allclose(reach, reach[:, :1].repeat(4, axis=1), rtol=1e-9)


def test_pinned_points_are_the_first_vertices_and_do_not_move():
    pinned = RADIUS * np.array([[0.0, 0.0, 1.0], [0.6, 0.8, 0.0]])
    vertices, faces = tessellate(sphere, *BOX, 1.0, np.random.default_rng(0), pinned)
    np.testing.assert_allclose(vertices[:2], pinned, atol=1e-12)
    assert np.isin([0, 1], faces).all()
    assert radius_ratio(vertices[faces]).min() > 0.5
