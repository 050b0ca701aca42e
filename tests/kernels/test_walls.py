"""The loop finds the walls that all pairs tell to be near."""

import numpy as np
import pytest

from jaxgrow.mesh.collision_mesh import Walls

from ..brute_force import walls_near
from .sheets import of_every_kind


SHEETS = of_every_kind()


@pytest.mark.parametrize("distance", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("name", SHEETS)
def test_near_walls_are_those_of_all_pairs(name, distance):
    sheet = SHEETS[name]
    walls = Walls(sheet.vertices, sheet.faces, np.arange(len(sheet.vertices)))
    rng = np.random.default_rng(4)
    for scale in ([3, 1, 1], [0.1, 0.1, 5], [0, 0, 0]):
        points = rng.uniform(-1, 1, (40, 3)) * scale + rng.uniform(-3, 3, 3)
        expected = walls_near(walls, points, distance)
        np.testing.assert_array_equal(walls.near(points, distance), expected)


def test_walls_that_points_lie_on_are_near_at_no_distance():
    sheet = SHEETS["lattice"]
    walls = Walls(sheet.vertices, sheet.faces, np.arange(len(sheet.vertices)))
    near = walls.near(sheet.vertices[sheet.faces[7]], 0.0)
    assert 7 in near
    assert len(near) < len(walls.faces)


def test_no_points_are_near_no_walls():
    sheet = SHEETS["rough"]
    walls = Walls(sheet.vertices, sheet.faces, np.arange(len(sheet.vertices)))
    assert len(walls.near(np.zeros((0, 3)), 1.0)) == 0
    assert walls.near(np.zeros((0, 3)), 1.0).dtype == np.int64
