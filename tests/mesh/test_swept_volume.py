"""Points that a remeshing swept over are found, and no others."""

import numpy as np

from jaxgrow.mesh.subdivide import subdivide
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.swept_volume import swept_points


def pyramid(height):
    """A square base with a tip in the middle, and four more triangles far away."""
    vertices = np.array(
        [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, height]]
    )
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    return Surface(vertices, faces, np.array([True] * 4 + [False]))


def test_point_between_before_and_after_is_swept():
    points = np.array([[0.5, 0.5, 0.5], [0.5, 0.5, 1.5], [0.5, 0.5, -0.5], [3, 3, 3.0]])
    found = swept_points(pyramid(0.0), pyramid(1.0), points)
    np.testing.assert_array_equal(found, [True, False, False, False])
    found = swept_points(pyramid(1.0), pyramid(0.0), points)
    np.testing.assert_array_equal(found, [True, False, False, False])


def test_random_points_are_swept_where_the_heights_say_so():
    rng = np.random.default_rng(0)
    points = rng.uniform([0, 0, -1], [1, 1, 1.2], (2000, 3))
    found = swept_points(pyramid(0.2), pyramid(0.9), points)
    level = 1 - 2 * np.abs(points[:, :2] - 0.5).max(axis=1)
    np.testing.assert_array_equal(
        found, (points[:, 2] > 0.2 * level) & (points[:, 2] < 0.9 * level)
    )
    assert found.sum() > 50


def test_point_on_the_new_surface_counts():
    assert swept_points(pyramid(0.0), pyramid(1.0), np.array([[0.5, 0.25, 0.5]])).all()


def test_subdivision_sweeps_nothing():
    before = pyramid(0.7)
    after, _ = subdivide(before, 0.01)
    assert len(after.faces) > len(before.faces)
    rng = np.random.default_rng(1)
    assert not swept_points(before, after, rng.uniform(-1, 2, (500, 3))).any()


def test_same_triangles_from_other_corners_are_no_change():
    before = pyramid(0.7)
    after = Surface(before.vertices, np.roll(before.faces, 1, axis=1), before.fixed)
    assert not swept_points(before, after, np.array([[0.5, 0.5, 0.3]])).any()
