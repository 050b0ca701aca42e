"""Points in spheres, against a table of all pairs."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy import points_in_spheres as spheres
from jaxgrow.energy.points_in_spheres import count_inside, list_inside, Spheres


POINTS, SPHERES = 150, 1100  # more than one word of bundles, and neither fills its last


WAYS = {
    "table": {},
    "bundles": {"FEW_PAIRS": 0},
    "many rounds": {"FEW_PAIRS": 0, "ROUND": 64},
    "two keys": {"FEW_PAIRS": 0, "KEYS": 0},
}
SIZE = 16_000


@pytest.fixture(scope="module", params=WAYS)
def way(request):
    """Each way to list; one has rounds so short that there are many."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in WAYS[request.param].items():
            patch.setattr(spheres, name, value)
        yield request.param


def scene(seed, giants=0, dead=0):
    """Spheres of all sizes about a wavy sheet, some dead, and points around it."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-10, 10, (SPHERES, 3))
    centre[:, 2] = np.sin(centre[:, 0]) + 0.1 * centre[:, 2]
    radius = rng.uniform(0.3, 1.5, SPHERES)
    radius[rng.choice(SPHERES, giants, replace=False)] = 30.0
    radius[rng.choice(SPHERES, dead, replace=False)] = 0.0
    points = rng.uniform(-10, 10, (POINTS, 3)) * [1, 1, 0.3]
    alive = np.ones(POINTS, bool)
    alive[rng.choice(POINTS, dead, replace=False)] = False
    return points, alive, centre, radius


def oracle(points, alive, centre, radius):
    """All pairs by row, then by column."""
    near = np.linalg.norm(points[:, None] - centre[None], axis=2) < radius
    return np.nonzero(near & alive[:, None])


@functools.cache
def programs(way):
    """Of their own for every way."""

    def listing(points, alive, centre, radius, size):
        return list_inside(points, alive, Spheres(centre, radius), size)

    def counting(points, alive, centre, radius):
        return count_inside(points, alive, Spheres(centre, radius))

    assert way in WAYS
    return jax.jit(listing, static_argnums=4), jax.jit(counting)


def listed(way, made, size=SIZE):
    listing, counting = programs(way)
    found = listing(*map(jnp.asarray, made), size)
    assert counting(*map(jnp.asarray, made)) == found.total
    return tuple(np.asarray(part) for part in found)


@pytest.mark.parametrize("giants, dead", [(0, 0), (3, 60), (40, 149), (0, 150)])
def test_list_is_that_of_the_table_in_its_order(way, giants, dead):
    made = scene(1, giants, dead)
    wanted = oracle(*made)
    point, sphere, count = listed(way, made)
    assert count == len(wanted[0]) <= SIZE
    assert dead == POINTS or count > 20
    np.testing.assert_array_equal(point[:count], wanted[0])
    np.testing.assert_array_equal(sphere[:count], wanted[1])
    assert not np.any(point[count:])
    assert not np.any(sphere[count:])


def test_count_tells_what_has_no_room(way):
    made = scene(2, giants=5)
    wanted = oracle(*made)
    size = 500
    point, sphere, count = listed(way, made, size)
    assert count == len(wanted[0]) > size
    pairs = set(zip(point.tolist(), sphere.tolist(), strict=True))
    assert len(pairs) == size
    assert pairs <= set(zip(*(part.tolist() for part in wanted), strict=True))


def test_spheres_that_are_nowhere_hold_nothing_and_hide_no_other(way):
    points, alive, centre, radius = scene(3)
    lost = np.random.default_rng(0).choice(SPHERES, 90, replace=False)
    centre[lost[:30]] = np.nan
    radius[lost[30:60]] = np.nan
    centre[lost[60:]], radius[lost[60:]] = np.inf, np.nan
    points[:5] = np.nan
    wanted = oracle(points, alive, centre, radius)
    point, sphere, count = listed(way, (points, alive, centre, radius))
    assert count == len(wanted[0]) > 100
    np.testing.assert_array_equal(point[:count], wanted[0])
    np.testing.assert_array_equal(sphere[:count], wanted[1])


def test_spheres_at_one_place_are_all_listed(way):
    points, alive, centre, radius = scene(4)
    centre[:], points[:7] = 0.5, 0.5
    wanted = oracle(points, alive, centre, radius)
    point, sphere, count = listed(way, (points, alive, centre, radius))
    assert count == len(wanted[0]) >= 7 * SPHERES
    np.testing.assert_array_equal(point[:count], wanted[0])
    np.testing.assert_array_equal(sphere[:count], wanted[1])


def test_no_table_of_all_pairs_is_made_of_many_points_and_spheres():
    points, faces, size = 20_000, 5_000, 30_000
    shapes = (
        jax.ShapeDtypeStruct((points, 3), float),
        jax.ShapeDtypeStruct((points,), bool),
        Spheres(
            jax.ShapeDtypeStruct((faces, 3), float),
            jax.ShapeDtypeStruct((faces,), float),
        ),
    )
    lowered = jax.jit(list_inside, static_argnums=3).lower(*shapes, size)
    memory = lowered.compile().memory_analysis()
    assert memory.temp_size_in_bytes < 0.2 * points * faces
