"""Triangles that meet."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxgrow.mesh.intersection import intersecting_pairs, meeting


FLAT = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]])


def _meet(other, one=FLAT):
    other = np.array(other, dtype=float)
    there = meeting(one[None], other[None])[0]
    assert there == meeting(other[None], one[None])[0]
    return bool(there)


@pytest.mark.parametrize(
    "other, expected",
    [
        ([[1, 1, -1], [1, 1, 1], [9, 9, 1]], True),
        ([[1, -1, -1], [1, -1, 1], [1, 1, 0.2]], True),
        ([[5, 5, -1], [5, 5, 1], [9, 9, 1]], False),
        ([[1, 1, 1], [2, 1, 1], [1, 2, 1]], False),
        ([[1, 1, 0], [2, 1, 0], [1, 2, 0]], True),
        ([[3, 3, 0], [5, 3, 0], [3, 5, 0]], False),
        ([[3, 0.5, 0], [6, 0.5, 0], [6, 2, 0]], True),
        ([[1, 1, 0], [1, 1, 3], [2, 1, 3]], True),
        ([[1, 1, 1e-6], [1, 1, 3], [2, 1, 3]], False),
        ([[1, 1, 1], [1, 1, -1], [1, 1, -1]], True),
        ([[5, 5, 1], [5, 5, -1], [5, 5, -1]], False),
    ],
    ids=[
        "side pierces",
        "tip pierces",
        "plane only",
        "parallel",
        "coplanar within",
        "coplanar apart",
        "coplanar across",
        "touching tip",
        "nearly touching",
        "segment",
        "segment apart",
    ],
)
def test_pairs_of_triangles(other, expected):
    assert _meet(other) is expected


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_meeting_agrees_with_sides_that_pierce(seed):
    rng = np.random.default_rng(seed)
    one, other = rng.normal(size=(2, 100, 3, 3))
    pierced = np.zeros(100, dtype=bool)
    for a, b in ((one, other), (other, one)):
        normal = np.cross(b[:, 1] - b[:, 0], b[:, 2] - b[:, 0])
        for k in range(3):
            p, q = a[:, k], a[:, (k + 1) % 3]
            hp = np.einsum("ni,ni->n", p - b[:, 0], normal)
            hq = np.einsum("ni,ni->n", q - b[:, 0], normal)
            x = p + (hp / (hp - hq))[:, None] * (q - p)
            side = [
                np.einsum(
                    "ni,ni->n",
                    np.cross(b[:, (j + 1) % 3] - b[:, j], x - b[:, j]),
                    normal,
                )
                for j in range(3)
            ]
            pierced |= (hp * hq < 0) & (np.min(side, axis=0) > 0)
    assert np.array_equal(meeting(one, other), pierced)


def test_segment_beside_a_triangle_in_its_plane_does_not_meet_it():
    # as midpoints of a subdivision lie: the segment has no normal of its own
    segment = [[2.5, 2.5, 0], [5.0, 1.0, 0], [5.0, 1.0, 0]]
    assert not _meet(segment)
    assert _meet([[1.5, 1.5, 0], [5.0, 1.0, 0], [5.0, 1.0, 0]])
    assert not _meet([[4.5, -1, 0], [4.5, 5, 0], [4.5, 5, 0]])


def test_meeting_does_not_depend_on_where_or_how_large():
    rng = np.random.default_rng(0)
    one, other = rng.normal(size=(2, 300, 3, 3))
    expected = meeting(one, other)
    assert 0 < expected.sum() < 300
    shift = np.array([1e3, -2e3, 5e2])
    assert np.array_equal(meeting(1e-3 * one, 1e-3 * other), expected)
    assert np.array_equal(meeting(one + shift, other + shift), expected)


def test_all_pairs_are_found_among_triangles_of_all_sizes():
    rng = np.random.default_rng(1)
    size = np.exp(1.5 * rng.normal(size=(150, 1, 1)))
    corners = 4 * rng.normal(size=(150, 1, 3)) + size * rng.normal(size=(150, 3, 3))
    faces = np.arange(450).reshape(-1, 3)
    apart, corner = intersecting_pairs(corners.reshape(-1, 3), faces)
    i, j = np.triu_indices(150, 1)
    expected = np.stack([i, j], 1)[meeting(corners[i], corners[j])]
    assert len(expected) > 50
    assert np.array_equal(np.unique(apart, axis=0), expected)
    assert len(apart) == len(expected)
    assert len(corner) == 0


def test_a_sphere_and_a_flat_grid_have_none(sphere, grid):
    for surface in (sphere(3), grid(10)):
        apart, corner = intersecting_pairs(surface.vertices, surface.faces)
        assert len(apart) == len(corner) == 0


def test_triangles_hinged_at_a_vertex_may_meet_beyond_it():
    vertices = np.array(
        [[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, 1], [1.5, 1, -1], [-1, -1, 1]]
    )
    through, beside = [0, 3, 4], [0, 5, 3]
    _, corner = intersecting_pairs(vertices, np.array([[0, 1, 2], through]))
    assert corner.tolist() == [[0, 1]]
    _, corner = intersecting_pairs(vertices, np.array([[0, 1, 2], beside]))
    assert len(corner) == 0
