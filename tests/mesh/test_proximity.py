"""Exact distances."""

import igl
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import minimize

from jaxgrow.mesh.proximity import closest_on_triangles, nearest_on_mesh

from .. import brute_force


TRIANGLE = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0]])


@pytest.mark.parametrize(
    "point, weights, distance",
    [
        ([1, 1, 2], [5 / 12, 1 / 4, 1 / 3], 2.0),
        ([2, -1, 0], [1 / 2, 1 / 2, 0], 1.0),
        ([-2, 1.5, 0], [1 / 2, 0, 1 / 2], 2.0),
        ([2 + 3, 1.5 + 4, 0], [0, 1 / 2, 1 / 2], 5.0),
        ([-3, -4, 0], [1, 0, 0], 5.0),
        ([7, -1, 0], [0, 1, 0], 10**0.5),
        ([-1, 5, 2], [0, 0, 1], 3.0),
    ],
    ids=["face", "side ab", "side ca", "side bc", "corner a", "corner b", "corner c"],
)
def test_every_voronoi_region_has_its_closest_point(point, weights, distance):
    found = closest_on_triangles(np.array([point], dtype=float), TRIANGLE[None])
    assert found[0][0] == pytest.approx(distance, abs=1e-14)
    assert found[1][0] == pytest.approx(weights, abs=1e-14)


@pytest.mark.parametrize(
    "triangle, distance",
    [
        ([[0.0, 0, 0]] * 3, 13**0.5),
        ([[0.0, 0, 0], [4, 0, 0], [1, 0, 0]], 3.0),
        ([[2.0, 3, 0], [2, 3, 0], [2, 3, 5]], 0.0),
    ],
    ids=["point", "line", "needle"],
)
def test_a_degenerate_triangle_is_what_is_left_of_it(triangle, distance):
    point = np.array([[2.0, 3, 0]])
    found, weights = closest_on_triangles(point, np.array([triangle]))
    assert found[0] == pytest.approx(distance, abs=1e-14)
    assert weights.sum() == pytest.approx(1.0)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), flat=st.sampled_from([1.0, 1e-3, 1e-9, 0.0]))
def test_the_closest_point_is_on_the_triangle_and_no_sample_is_nearer(seed, flat):
    rng = np.random.default_rng(seed)
    triangles = rng.normal(size=(20, 3, 3))
    base = triangles[:, 0] + rng.random((20, 1)) * (triangles[:, 1] - triangles[:, 0])
    triangles[:, 2] = base + flat * (triangles[:, 2] - base)
    points = 2 * rng.normal(size=(20, 3))
    distance, weights = closest_on_triangles(points, triangles)
    assert (weights >= 0).all()
    assert np.allclose(weights.sum(axis=1), 1.0, atol=1e-14)
    closest = np.einsum("nk,nki->ni", weights, triangles)
    assert np.allclose(np.linalg.norm(points - closest, axis=1), distance, atol=1e-7)
    samples = np.einsum("sk,nki->nsi", rng.dirichlet([0.5] * 3, 200), triangles)
    gap = np.linalg.norm(samples - points[:, None], axis=2).min(axis=1)
    assert (distance <= gap + 1e-12).all()


def test_distances_agree_with_constrained_minimisation():
    rng = np.random.default_rng(0)
    for _ in range(20):
        triangle, point = rng.normal(size=(3, 3)), rng.normal(size=3)
        best = minimize(
            lambda w, t=triangle, p=point: np.sum((w @ t - p) ** 2),
            np.full(3, 1 / 3),
            bounds=[(0, 1)] * 3,
            constraints={"type": "eq", "fun": lambda w: w.sum() - 1},
            tol=1e-14,
        )
        distance, _ = closest_on_triangles(point[None], triangle[None])
        assert distance[0] == pytest.approx(np.sqrt(best.fun), abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), spread=st.sampled_from([0.0, 1.0, 4.0]))
def test_the_nearest_face_is_found_among_triangles_of_all_sizes(seed, spread):
    rng = np.random.default_rng(seed)
    size = np.exp(spread * rng.normal(size=(60, 1, 1)))
    corners = rng.normal(size=(60, 1, 3)) * 3 + size * rng.normal(size=(60, 3, 3))
    vertices, faces = corners.reshape(-1, 3), np.arange(180).reshape(-1, 3)
    points = 4 * rng.normal(size=(50, 3))
    distance, face, closest = nearest_on_mesh(points, vertices, faces)
    every = brute_force.nearest(points, vertices, faces)
    np.testing.assert_allclose(distance, every.min(axis=1), rtol=1e-12)
    np.testing.assert_allclose(distance, every[np.arange(50), face], rtol=1e-12)
    assert np.allclose(np.linalg.norm(points - closest, axis=1), distance, rtol=1e-6)


@pytest.mark.parametrize("flat", [1.0, 1e-6, 1e-12, 0.0])
def test_no_triangle_is_missed_from_far_away_in_its_plane(flat):
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(200, 3, 3)) * [1, 1, flat] + [1e3, -1e3, 0]
    vertices, faces = corners.reshape(-1, 3), np.arange(600).reshape(-1, 3)
    points = 100 * rng.normal(size=(50, 3)) * [1, 1, flat] + [1e3, -1e3, 0]
    distance, face, _ = nearest_on_mesh(points, vertices, faces)
    every = brute_force.nearest(points, vertices, faces)
    np.testing.assert_allclose(distance, every.min(axis=1), rtol=1e-12)
    np.testing.assert_allclose(distance, every[np.arange(50), face], rtol=1e-12)


def test_distances_to_a_sphere_agree_with_libigl(sphere):
    surface = sphere(3, 5.0)
    points = 4 * np.random.default_rng(0).normal(size=(500, 3))
    distance, _, _ = nearest_on_mesh(points, surface.vertices, surface.faces)
    square = igl.point_mesh_squared_distance(points, surface.vertices, surface.faces)
    assert np.allclose(distance, np.sqrt(square[0]), atol=1e-12)


def test_a_mesh_of_points_only_still_has_a_distance():
    distance, _, _ = nearest_on_mesh(
        np.array([[3.0, 4, 0]]), np.zeros((3, 3)), np.array([[0, 1, 2]])
    )
    assert distance[0] == 5.0


def test_no_points_have_no_distances(sphere):
    found = nearest_on_mesh(np.zeros((0, 3)), sphere(1).vertices, sphere(1).faces)
    assert [len(part) for part in found] == [0, 0, 0]


def test_a_mesh_without_faces_is_refused():
    with pytest.raises(ValueError, match="no face"):
        nearest_on_mesh(np.zeros((1, 3)), np.zeros((3, 3)), np.zeros((0, 3), dtype=int))
