"""The loop finds the triangles that all pairs tell to intersect, in their order."""

import numpy as np
import pytest

from jaxgrow.mesh.intersection import intersecting_pairs, meeting

from .. import brute_force
from .sheets import of_every_kind


SHEETS = of_every_kind()


@pytest.mark.parametrize("first", [None, 0, 11])
@pytest.mark.parametrize("name", SHEETS)
def test_intersecting_pairs_are_those_of_all_in_their_order(name, first):
    sheet = SHEETS[name]
    found = intersecting_pairs(sheet.vertices, sheet.faces, first)
    expected = brute_force.intersecting(sheet.vertices, sheet.faces, first)
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


def test_sheets_have_intersections_of_every_kind():
    found = [intersecting_pairs(s.vertices, s.faces) for s in SHEETS.values()]
    apart, corner = (sum(map(len, pairs)) for pairs in zip(*found, strict=True))
    assert apart > 100
    assert corner > 10


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_pairs_of_hard_triangles_meet_as_numpy_says(scale):
    rng = np.random.default_rng(3)
    one, other = rng.integers(-1, 3, (2, 2000, 3, 3)).astype(float)
    one[::3] += 0.3 * rng.normal(size=one[::3].shape)
    one[::4, 2] = one[::4, 1]
    other[::6, 1:] = other[::6, :1]
    one, other = scale * (one + 7), scale * (other + 7)
    expected = brute_force.meet(one, other)
    np.testing.assert_array_equal(meeting(one, other), expected)
    assert 50 < expected.sum() < 1900


def test_triangles_that_touch_in_a_point_meet():
    one = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    above = np.array([[0.2, 0.2, 0], [1, 0, 1], [0, 1, 1.0]])
    assert meeting(one[None], above[None]).all()
    above[:, 2] += 1e-6
    assert not meeting(one[None], above[None]).any()
