"""The loop counts the particles that all pairs of them tell to be alone."""

import numpy as np
import pytest

from jaxgrow.energy.a2 import CUTOFF
from jaxgrow.growth.adaptation import _alone

from ..brute_force import alone


@pytest.mark.parametrize("spread", [0.0, 3.0, 8.0, 40.0])
def test_those_alone_are_as_many_as_all_pairs_tell(spread):
    rng = np.random.default_rng(0)
    points = spread * rng.uniform(-1, 1, (200, 3))
    points[:20] = points[20:40]
    points[-3:] = [[300.0, 0, 0], [0, -4e4, 0], [1e9, 1e9, 1e9]]
    found = _alone(points)
    assert found == alone(points, CUTOFF)
    assert 3 <= found < 200


def test_only_two_at_the_cutoff_are_alone():
    points = np.array([[0, 0, 0], [0, 0, CUTOFF]])
    assert _alone(points) == 2
    assert _alone(points * (1 - 1e-9)) == 0
