import numpy as np
import pytest

from jaxgrow.organ.implicit_surface import gradient, project, round_cone, smooth_union


def cone(points):
    return round_cone(
        points, np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 4.0]), 2.0, 1.0
    )


def test_a_round_cone_is_the_distance_to_the_hull_of_its_spheres():
    points = np.random.default_rng(0).uniform(-4, 8, size=(200, 3))
    points = points[cone(points) > 0]
    # the hull is the union of the spheres in between: sample them densely
    t = np.linspace(0, 1, 4001)
    centre = np.stack([0 * t, 0 * t, 4 * t], axis=1)
    radius = 2 - t
    reach = np.linalg.norm(points[:, None] - centre, axis=2) - radius
    np.testing.assert_allclose(cone(points), reach.min(axis=1), atol=1e-6)


def test_a_round_cone_inside_a_sphere_is_refused():
    with pytest.raises(ValueError, match="move them apart"):
        round_cone(np.zeros((1, 3)), np.zeros(3), np.array([0, 0, 1.0]), 3.0, 1.0)


def test_a_smooth_union_lies_below_the_parts_by_at_most_b_log_parts():
    rows = np.random.default_rng(0).normal(size=(3, 50))
    united = smooth_union(rows, 0.5)
    assert np.all(united <= rows.min(axis=0))
    assert np.all(united >= rows.min(axis=0) - 0.5 * np.log(3))


def test_the_gradient_of_a_distance_has_length_one():
    points = np.random.default_rng(0).uniform(-4, 8, size=(100, 3))
    slope = gradient(cone, points, 1e-5)
    np.testing.assert_allclose(np.linalg.norm(slope, axis=1), 1.0, atol=1e-6)


def test_projected_points_lie_on_the_surface():
    points = np.random.default_rng(0).uniform(-4, 8, size=(100, 3))
    landed = project(cone, points, step=1e-5, iterations=5)
    np.testing.assert_allclose(cone(landed), 0.0, atol=1e-12)
