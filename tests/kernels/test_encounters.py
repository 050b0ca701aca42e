"""The loops find the encounters that all pairs tell, in their order."""

import numpy as np
import pytest

from jaxgrow.mesh.collision_mesh import distances_of, encounters, nearest_apart
from jaxgrow.mesh.proximity import closest_on_segments, closest_on_triangles

from .. import brute_force
from .sheets import of_every_kind


SHEETS = of_every_kind()
BOUNDS = [(0.9, 0.6, 1.5), (0.4, 0.7, 0.8), (1.2, 0.95, 0.0)]


def same(found, expected):
    """Equal integers and flags; distances to rounding."""
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == other.dtype
        assert one.shape == other.shape
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("bounds", BOUNDS)
@pytest.mark.parametrize("name", SHEETS)
def test_encounters_are_those_of_all_pairs_in_their_order(name, bounds):
    sheet = SHEETS[name]
    wanted = dict(zip(("apart", "local", "along"), bounds, strict=True))
    found = encounters(sheet, **wanted)
    of_vertices = brute_force.vertices_near_faces(sheet, *bounds)
    of_edges = brute_force.edges_near_edges(sheet, *bounds)
    same(
        (found.vertex, found.corners, found.vertex_distance, found.vertex_apart),
        of_vertices,
    )
    same((found.edges, found.edge_distance, found.edge_apart), of_edges)


def test_sheets_have_encounters_of_every_kind():
    found = [encounters(s, apart=0.9, local=0.6, along=1.5) for s in SHEETS.values()]
    for name in ("vertex_apart", "edge_apart"):
        flags = np.concatenate([getattr(f, name) for f in found])
        assert 100 < flags.sum() < len(flags) - 100


@pytest.mark.parametrize("name", SHEETS)
def test_distances_elsewhere_are_those_of_the_pairs(name):
    found = encounters(SHEETS[name], apart=0.9, local=0.6, along=1.5)
    rng = np.random.default_rng(2)
    moved = SHEETS[name].vertices + rng.normal(size=SHEETS[name].vertices.shape)
    corners, ends = moved[found.corners], moved[found.edges]
    to_triangles, _ = brute_force.to_triangles(moved[found.vertex], corners)
    to_edges, _, _ = brute_force.of_segments(ends[:, :2], ends[:, 2:])
    same(distances_of(moved, found), (to_triangles, to_edges))


@pytest.mark.parametrize("name", SHEETS)
def test_gap_is_the_least_of_all_pairs(name):
    for within in (0.1, 0.5):
        found = nearest_apart(SHEETS[name], within=within, along=0.3)
        pairs = brute_force.vertices_near_faces(SHEETS[name], within, -1.0, 0.3)
        expected = pairs[2].min(initial=np.inf)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)


def cases(corners, rng):
    """Points, segments and triangles in general position, and degenerate ones."""
    made = rng.normal(size=(400, corners, 3))
    made[::4] = rng.integers(-1, 2, (100, corners, 3))
    made[1::8, -1] = made[1::8, -2]
    made[2::8, :2] = made[2::8, :1]
    return made


def test_distances_of_degenerate_pairs_are_those_of_numpy():
    four = cases(4, np.random.default_rng(0))
    points, _ = closest_on_triangles(four[:, 0], four[:, 1:])
    wanted, weights = brute_force.to_triangles(four[:, 0], four[:, 1:])
    np.testing.assert_allclose(points, wanted, rtol=1e-12, atol=1e-13)
    lines, s, t = closest_on_segments(four[:, :2], four[:, 2:])
    wanted, _, _ = brute_force.of_segments(four[:, :2], four[:, 2:])
    np.testing.assert_allclose(lines, wanted, rtol=1e-12, atol=1e-13)
    a, b, c, d = four.transpose(1, 0, 2)
    gap = a + s[:, None] * (b - a) - c - t[:, None] * (d - c)
    np.testing.assert_allclose(np.linalg.norm(gap, axis=1), lines, atol=1e-12)
    inside = (weights > 0).all(axis=1)
    assert 20 < inside.sum() < 380


def test_weights_are_those_of_the_closest_point():
    four = cases(4, np.random.default_rng(1))
    point, corners = four[:, 0], four[:, 1:]
    distance, weights = closest_on_triangles(point, corners)
    # of equally near points on different sides any one is right
    for found in (weights, brute_force.to_triangles(point, corners)[1]):
        np.testing.assert_allclose(found.sum(axis=1), 1.0, rtol=1e-14)
        foot = np.einsum("nk,nki->ni", found, corners)
        gap = np.linalg.norm(point - foot, axis=1)
        np.testing.assert_allclose(gap, distance, atol=1e-12)


def test_the_closest_of_parallel_and_crossing_edges_is_found():
    from jaxgrow.kernels import distances

    vertices = np.array([[0, 0, 0], [2, 0, 0], [1, 1, 0], [3, 1, 0], [1, -1, 0.0]])
    assert distances.between(vertices, 0, 1, 2, 3) == 1.0
    assert distances.between(vertices, 0, 1, 2, 4) == 0.0
