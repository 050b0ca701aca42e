"""Body of a tumour against the convex hull of its particles, and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import ConvexHull, distance

from jaxgrow.metrics.body import body_of
from jaxgrow.transfer.device import put_particles


ROOM = 1024


def particles(position, species=None):
    species = np.ones(len(position), int) if species is None else species
    return put_particles(position, species, np.zeros(len(position), bool), ROOM)


@jax.jit
def measure(of):
    found = body_of(of, None)
    return found.diameter, found.equivalent_diameter, found.sphericity


@jax.jit
def smooth_diameter(of):
    return body_of(of, 0.2).diameter


def in_a_ball(radius, seed=0, count=900):
    rng = np.random.default_rng(seed)
    away = rng.normal(size=(count, 3))
    away *= radius / np.linalg.norm(away, axis=1, keepdims=True)
    return away * rng.uniform(size=(count, 1)) ** (1 / 3)


SHAPES = {
    "ball": in_a_ball(5.0),
    "egg": in_a_ball(5.0, 1) * [1, 1, 1.6],
    "finger": in_a_ball(5.0, 2) * [0.5, 0.5, 1.5],
    "disc": in_a_ball(5.0, 3) * [1.2, 1.2, 0.3],
}


def hull_of_balls(centres):
    """Volume and area of the hull of balls of diameter 1, from points on them."""
    away = np.random.default_rng(4).normal(size=(400, 3))
    away *= 0.5 / np.linalg.norm(away, axis=1, keepdims=True)
    outer = centres[ConvexHull(centres).vertices]
    hull = ConvexHull((outer[:, None] + away).reshape(-1, 3))
    return hull.volume, hull.area


@pytest.mark.parametrize("name", list(SHAPES))
def test_body_is_the_hull_of_the_balls(name):
    centres = SHAPES[name]
    diameter, equivalent, sphericity = measure(particles(centres))
    volume, area = hull_of_balls(centres)
    ball = np.cbrt(6 * volume / np.pi)
    np.testing.assert_allclose(diameter, distance.pdist(centres).max() + 1, rtol=0.01)
    np.testing.assert_allclose(equivalent, ball, rtol=0.02)
    np.testing.assert_allclose(sphericity, np.pi * ball**2 / area, rtol=0.02)


@pytest.mark.parametrize("seed", range(8))
def test_sphericity_is_never_above_one(seed):
    rng = np.random.default_rng(seed)
    centres = in_a_ball(3.0, seed, 4 + 30 * seed) * rng.uniform(0.1, 2, 3)
    assert 0 < measure(particles(centres))[2] <= 1


def test_a_single_particle_is_a_ball():
    diameter, equivalent, sphericity = measure(particles(np.array([[7.0, 1, -2]])))
    np.testing.assert_allclose(diameter, 1, rtol=1e-12)
    np.testing.assert_allclose(equivalent, 1, rtol=5e-3)
    np.testing.assert_allclose(sphericity, 1, rtol=5e-3)


def test_tissue_and_padding_belong_to_no_body():
    centres = SHAPES["ball"][:100]
    far = np.concatenate([centres, [[50.0, 0, 0]]])
    species = np.append(np.ones(100, int), 0)
    np.testing.assert_allclose(
        measure(particles(far, species)), measure(particles(centres)), rtol=1e-12
    )


def test_without_a_tumour_there_is_no_body():
    found = measure(particles(np.zeros((3, 3)), np.zeros(3, int)))
    assert [float(x) for x in found] == [0, 0, 0]


@pytest.mark.parametrize("name", list(SHAPES))
def test_smooth_diameter_is_as_near_as_stated(name):
    of = particles(SHAPES[name])
    assert -1e-12 <= smooth_diameter(of) - measure(of)[0] <= 0.2


def test_derivatives_are_those_of_differences():
    of = particles(SHAPES["egg"])
    along = np.random.default_rng(5).normal(size=of.position.shape)

    @jax.jit
    def at(position):
        return jnp.stack(measure(of.at(position)))

    _, slope = jax.jvp(at, (of.position,), (jnp.asarray(along),))
    h = 1e-6
    up, down = at(of.position + h * along), at(of.position - h * along)
    np.testing.assert_allclose(slope, (up - down) / (2 * h), rtol=1e-5)
