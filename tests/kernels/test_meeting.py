"""The loop finds the triangles that numpy finds to intersect, in its order."""

import numpy as np
import pytest

from jaxgrow import kernels
from jaxgrow.mesh.intersection import intersecting_pairs, meeting

from .sheets import of_every_kind


pytest.importorskip("numba")

SHEETS = of_every_kind()


def by_numpy(monkeypatch, sheet, first=None):
    with monkeypatch.context() as patch:
        patch.setattr(kernels, "wanted", lambda: False)
        return intersecting_pairs(sheet.vertices, sheet.faces, first)


@pytest.mark.parametrize("first", [None, 0, 11])
@pytest.mark.parametrize("name", SHEETS)
def test_intersecting_pairs_are_those_of_numpy_in_their_order(name, first, monkeypatch):
    sheet = SHEETS[name]
    found = intersecting_pairs(sheet.vertices, sheet.faces, first)
    expected = by_numpy(monkeypatch, sheet, first)
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
    from jaxgrow.kernels.meeting import meet

    rng = np.random.default_rng(3)
    one, other = rng.integers(-1, 3, (2, 2000, 3, 3)).astype(float)
    one[::3] += 0.3 * rng.normal(size=one[::3].shape)
    one[::4, 2] = one[::4, 1]
    other[::6, 1:] = other[::6, :1]
    one, other = scale * (one + 7), scale * (other + 7)
    expected = meeting(one, other)
    found = [meet(a.copy(), b.copy()) for a, b in zip(one, other, strict=True)]
    np.testing.assert_array_equal(found, expected)
    assert 50 < expected.sum() < 1900


def test_triangles_that_touch_in_a_point_meet():
    from jaxgrow.kernels.meeting import meet

    one = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    above = np.array([[0.2, 0.2, 0], [1, 0, 1], [0, 1, 1.0]])
    assert meet(one.copy(), above.copy())
    above[:, 2] += 1e-6
    assert not meet(one.copy(), above)
