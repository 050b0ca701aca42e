"""The loops find the encounters that numpy finds, in its order."""

from dataclasses import fields

import numpy as np
import pytest

from jaxgrow import kernels
from jaxgrow.mesh.proximity import closest_on_segments, closest_on_triangles
from jaxgrow.mesh.sheet import distances_of, encounters, nearest_apart

from .sheets import of_every_kind


pytest.importorskip("numba")

SHEETS = of_every_kind()
BOUNDS = [(0.9, 0.6, 1.5), (0.4, 0.7, 0.8), (1.2, 0.95, 0.0)]


@pytest.fixture
def by_numpy(monkeypatch):
    """What a function returns without loops."""

    def call(function, *args, **kwargs):
        with monkeypatch.context() as patch:
            patch.setattr(kernels, "wanted", lambda: False)
            return function(*args, **kwargs)

    return call


@pytest.mark.parametrize("bounds", BOUNDS)
@pytest.mark.parametrize("name", SHEETS)
def test_encounters_are_those_of_numpy_in_their_order(name, bounds, by_numpy):
    sheet = SHEETS[name]
    wanted = dict(zip(("apart", "local", "along"), bounds, strict=True))
    found, expected = encounters(sheet, **wanted), by_numpy(encounters, sheet, **wanted)
    for field in fields(found):
        one, other = getattr(found, field.name), getattr(expected, field.name)
        assert one.dtype == other.dtype
        assert one.shape == other.shape
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-13)


def test_sheets_have_encounters_of_every_kind():
    found = [encounters(s, apart=0.9, local=0.6, along=1.5) for s in SHEETS.values()]
    for name in ("vertex_apart", "edge_apart"):
        flags = np.concatenate([getattr(f, name) for f in found])
        assert 100 < flags.sum() < len(flags) - 100


@pytest.mark.parametrize("name", SHEETS)
def test_distances_elsewhere_are_those_of_numpy(name, by_numpy):
    found = encounters(SHEETS[name], apart=0.9, local=0.6, along=1.5)
    rng = np.random.default_rng(2)
    moved = SHEETS[name].vertices + rng.normal(size=SHEETS[name].vertices.shape)
    expected = by_numpy(distances_of, moved, found)
    for one, other in zip(distances_of(moved, found), expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", SHEETS)
def test_gap_is_that_of_numpy(name, by_numpy):
    for within in (0.1, 0.5):
        wanted = {"within": within, "along": 0.3}
        found = nearest_apart(SHEETS[name], **wanted)
        expected = by_numpy(nearest_apart, SHEETS[name], **wanted)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)


def cases(corners, rng):
    """Points, segments and triangles in general position, and degenerate ones."""
    made = rng.normal(size=(400, corners, 3))
    made[::4] = rng.integers(-1, 2, (100, corners, 3))
    made[1::8, -1] = made[1::8, -2]
    made[2::8, :2] = made[2::8, :1]
    return made


def test_distances_of_pairs_are_those_of_numpy():
    from jaxgrow.kernels import distances

    rng = np.random.default_rng(0)
    four = cases(4, rng)
    vertices = four.reshape(-1, 3)
    index = np.arange(len(vertices)).reshape(-1, 4)
    points, lines = distances.of_pairs(vertices, index[:, 0], index[:, 1:], index)
    wanted, weights = closest_on_triangles(four[:, 0], four[:, 1:])
    np.testing.assert_allclose(points, wanted, rtol=1e-12, atol=1e-13)
    wanted, _, _ = closest_on_segments(four[:, :2], four[:, 2:])
    np.testing.assert_allclose(lines, wanted, rtol=1e-12, atol=1e-13)
    inside = (weights > 0).all(axis=1)
    assert 20 < inside.sum() < 380


def test_weights_are_those_of_the_closest_point():
    from jaxgrow.kernels import distances

    four = cases(4, np.random.default_rng(1))
    _, wanted = closest_on_triangles(four[:, 0], four[:, 1:])
    for (point, *corners), weights in zip(four, wanted, strict=True):
        corners = np.stack(corners)
        distance, *found = distances.to_triangle(point[None], 0, corners, 0, 1, 2)
        np.testing.assert_allclose(sum(found), 1.0, rtol=1e-14)
        foot = found @ corners
        np.testing.assert_allclose(np.linalg.norm(point - foot), distance, atol=1e-12)
        # of equally near points on different sides any one is right
        np.testing.assert_allclose(
            np.linalg.norm(point - weights @ corners), distance, atol=1e-12
        )


def test_the_closest_of_parallel_and_crossing_edges_is_found():
    from jaxgrow.kernels import distances

    vertices = np.array([[0, 0, 0], [2, 0, 0], [1, 1, 0], [3, 1, 0], [1, -1, 0.0]])
    assert distances.between(vertices, 0, 1, 2, 3) == 1.0
    assert distances.between(vertices, 0, 1, 2, 4) == 0.0
