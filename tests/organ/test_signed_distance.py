import numpy as np
import pytest

from jaxgrow.mesh.proximity import nearest_on_mesh
from jaxgrow.mesh.winding import winding_number
from jaxgrow.organ.signed_distance import Sides


@pytest.fixture(scope="module")
def spiked(ball):
    """A sphere with spikes out and in: closest points on corners and edges abound."""
    vertices = ball.vertices.copy()
    rng = np.random.default_rng(0)
    vertices[rng.choice(len(vertices), 40, replace=False)] *= 1.3
    vertices[rng.choice(len(vertices), 40, replace=False)] *= 0.8
    return vertices, ball.faces


def test_the_side_is_that_of_the_winding_number(spiked):
    vertices, faces = spiked
    points = np.random.default_rng(1).uniform(-13, 13, size=(1500, 3))
    measured = Sides(vertices, faces).measure(points)
    inside = winding_number(points, vertices, faces) > 0.5
    assert 0.2 < inside.mean() < 0.8
    np.testing.assert_array_equal(measured.side < 0, inside)


def test_the_distance_is_exact_and_its_face_the_nearest(spiked):
    vertices, faces = spiked
    points = np.random.default_rng(2).uniform(-13, 13, size=(300, 3))
    measured = Sides(vertices, faces).measure(points)
    exact = nearest_on_mesh(points, vertices, faces)[0]
    np.testing.assert_array_equal(measured.distance, exact)
    for i in range(0, 300, 10):
        alone = faces[measured.face[i]][None]
        gap = nearest_on_mesh(points[i][None], vertices, alone)[0]
        np.testing.assert_allclose(gap, exact[i], atol=1e-13)


def test_a_box_changes_nothing_near_it(spiked):
    vertices, faces = spiked
    low, high = np.array([2.0, 2.0, 2.0]), np.array([9.0, 9.0, 9.0])
    points = np.random.default_rng(3).uniform(4, 7, size=(200, 3))
    whole = Sides(vertices, faces).measure(points)
    boxed = Sides(vertices, faces, low - 5, high + 5)
    assert len(boxed.faces) < len(faces)
    for one, other in zip(whole, boxed.measure(points), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_point_on_the_surface_is_on_no_side(ball):
    measured = Sides(ball.vertices, ball.faces).measure(ball.vertices[:1])
    assert measured.distance[0] == 0
    assert measured.side[0] == 0


def test_no_points_are_measured_as_none(ball):
    measured = Sides(ball.vertices, ball.faces).measure(np.zeros((0, 3)))
    assert all(len(part) == 0 for part in measured)
