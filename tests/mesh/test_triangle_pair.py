"""Two triangles: shared corners, overlap, distance."""

import numpy as np
import pytest

from jaxgrow.mesh import triangle_pair as module
from jaxgrow.mesh.intersection import meeting
from jaxgrow.mesh.triangle_pair import distances, facing, overlapping, same_corners


BASE = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]])


def _overlap(one, other):
    one, other = (np.array([x], dtype=float) for x in (one, other))
    return bool(overlapping(one, other, same_corners(one, other))[0])


@pytest.mark.parametrize(
    "other, overlap",
    [
        ([[1, 1, -1], [1, 1, 1], [9, 9, 1]], True),
        ([[1, 1, 0.1], [1, 1, 1], [9, 9, 1]], False),
        ([[1, 1, 0], [2, 1, 0], [1, 2, 0]], True),
        ([[4, 4, 0], [5, 4, 0], [4, 5, 0]], False),
        ([[0, 0, 0], [1, 1, -1], [1, 1, 1]], True),
        ([[0, 0, 0], [-1, 1, -1], [-1, 1, 1]], False),
        ([[0, 0, 0], [1, 2, 0], [2, 1, 0]], True),
        ([[0, 0, 0], [-4, 0, 0], [0, -4, 0]], False),
        ([[0, 0, 0], [4, 0, 0], [1, 1, 0]], True),
        ([[0, 0, 0], [4, 0, 0], [1, 1, 0.05]], True),
        ([[0, 0, 0], [4, 0, 0], [1, 1, 0.2]], False),
        ([[0, 0, 0], [4, 0, 0], [1, -1, 0]], False),
        (BASE, True),
    ],
)
def test_what_overlaps_besides_shared_corners(other, overlap):
    rng = np.random.default_rng(0)
    for _ in range(4):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        one, two = BASE @ turn, np.array(other, dtype=float) @ turn
        i, j = rng.permutation(3), rng.permutation(3)
        # Shared corners must be the same numbers after the rotation as well.
        for k, corner in enumerate(np.array(other, dtype=float)):
            at = np.flatnonzero((corner == BASE).all(axis=1))
            two[k] = one[at[0]] if len(at) else two[k]
        assert _overlap(one[i], two[j]) == overlap
        assert _overlap(two[j], one[i]) == overlap


@pytest.mark.parametrize("shared", [0, 1])
def test_the_planes_tried_first_change_no_answer(shared, monkeypatch):
    rng = np.random.default_rng(shared)
    one = rng.normal(size=(20_000, 3, 3))
    other = rng.normal(size=(20_000, 3, 3))
    other[:10_000] = other[:10_000] * [1, 1, 0.01]
    one[:10_000] = one[:10_000] * [1, 1, 0.01]
    other[:, 1] = np.where(shared == 1, one[:, 2], other[:, 1])
    same = same_corners(one, other)
    assert (same.sum(axis=(1, 2)) == shared).all()
    quick = overlapping(one, other, same)
    calls = []

    def never(*triangles):
        calls.append(len(triangles[0]))
        return np.zeros(len(triangles[0]), dtype=bool)

    monkeypatch.setattr(module, "_parted", never)
    monkeypatch.setattr(module, "_parted_at", never)
    assert np.array_equal(quick, overlapping(one, other, same))
    assert len(calls) == 2
    assert 1000 < quick.sum() < 19_000


@pytest.mark.parametrize(
    "other, expected",
    [
        ([[1, 1, 2], [9, 9, 5], [9, 8, 7]], 2.0),
        ([[-3, 0, 4], [-9, 0, 4], [-9, 1, 5]], 5.0),
        ([[2, -3, -3], [2, -3, 3], [2, -9, 0]], 3.0),
        ([[2, -3, 0], [1, -9, 0], [3, -9, 1]], 3.0),
        ([[1, 1, -1], [1, 1, 1], [9, 9, 1]], 0.0),
        ([[1, 1, 0.25], [2, 1, 0.25], [1, 2, 0.25]], 0.25),
    ],
    ids=["corner-face", "corner-corner", "side-side", "corner-side", "through", "flat"],
)
def test_distances_that_are_known(other, expected):
    one, two = BASE[None], np.array([other], dtype=float)
    assert distances(one, two)[0] == pytest.approx(expected, abs=1e-14)
    assert distances(two, one)[0] == pytest.approx(expected, abs=1e-14)


def test_distances_are_the_least_of_all_points():
    rng = np.random.default_rng(1)
    one, other = rng.normal(size=(2, 300, 3, 3))
    other = other + np.array([0, 0, 1.5])
    steps = np.linspace(0, 1, 13)
    u, v = (x.ravel() for x in np.meshgrid(steps, steps))
    weights = np.stack([1 - u, u * (1 - v), u * v], axis=1)
    p, q = (np.einsum("wk,nki->nwi", weights, x) for x in (one, other))
    sampled = np.linalg.norm(p[:, :, None] - q[:, None], axis=3).min(axis=(1, 2))
    distance = distances(one, other)
    assert (distance <= sampled + 1e-12).all()
    assert (distance >= sampled - 0.35).all()
    assert np.abs(distance - sampled).mean() < 0.06
    assert np.array_equal(distance == 0, meeting(one, other))


def test_facing_means_opposed_normals():
    turned = BASE[::-1] + np.array([0, 0, 1.0])
    tilted = BASE @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    one = np.array([BASE, BASE, BASE])
    assert facing(one, np.array([turned, BASE, tilted])).tolist() == [
        True,
        False,
        False,
    ]


def test_nothing_has_no_distance():
    assert distances(np.zeros((0, 3, 3)), np.zeros((0, 3, 3))).shape == (0,)
