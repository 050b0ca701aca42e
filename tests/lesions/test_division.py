"""The two division rules."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.parameters import Parameters
from jaxgrow.lesions.division import Division, point_on_sphere
from jaxgrow.lesions.myoma import choose_myoma, divide_myoma, HALF_DISTANCE
from jaxgrow.lesions.polyp import (
    choose_polyp,
    daughter_of_source,
    divide_polyp,
    divide_polyp_to,
    source_normal,
)
from jaxgrow.mesh.intersection import intersecting_pairs
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.winding import winding_number
from jaxgrow.state import Species
from jaxgrow.transfer.device import put_membrane, put_particles


@pytest.fixture(scope="module")
def particles():
    position = np.array([[0.0, 0, -1], [1, 0, -1], [0, 1, -1]])
    return put_particles(
        position, np.array([0, 1, 1]), np.array([True, False, False]), 8
    )


@pytest.fixture(scope="module")
def cone():
    """A six-sided cone whose tip is the source, normals outwards (up), turned."""
    angle = np.pi / 3 * np.arange(6)
    base = np.stack([np.cos(angle), np.sin(angle), -0.8 + 0 * angle], axis=1)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    vertices = np.concatenate([[[0.0, 0.0, 0.0]], base]) @ turn.T + 3.0
    around = 1 + np.arange(6)
    faces = np.stack([np.zeros(6, int), around, 1 + (around % 6)], axis=1)
    surface = Surface(vertices, faces, np.arange(7) > 0, 0)
    return put_membrane(surface), turn[:, 2]


def test_normal_at_the_source_is_that_of_the_cone(cone):
    membrane, axis = cone
    np.testing.assert_allclose(source_normal(membrane), axis, atol=1e-14)


def test_polyp_puts_its_particle_under_the_source_by_the_offset(particles, cone):
    membrane, axis = cone
    parameters = Parameters(daughter_offset=0.17)
    after = divide_polyp(
        particles, membrane, jnp.asarray(3), jnp.asarray(1.0), parameters
    )
    np.testing.assert_allclose(after.position[3], 3.0 - 0.17 * axis, atol=1e-14)
    assert after.alive[3]
    assert after.species[3] == Species.TUMOUR
    assert not after.held[3]


def test_polyps_further_particles_of_a_step_are_put_deeper(particles, cone):
    membrane, axis = cone
    depth, parameters = jnp.asarray(2.0), Parameters(daughter_offset=0.17)
    after = divide_polyp(particles, membrane, jnp.asarray(3), depth, parameters)
    np.testing.assert_allclose(after.position[3], 3.0 - 0.34 * axis, atol=1e-14)


def test_polyp_division_leaves_everybody_else_alone(particles, cone):
    after = divide_polyp(
        particles, cone[0], jnp.asarray(3), jnp.asarray(1.0), Parameters()
    )
    others = np.arange(8) != 3
    for name in ("position", "species", "alive", "held"):
        before, now = getattr(particles, name), getattr(after, name)
        np.testing.assert_array_equal(now[others], before[others])


def spiky(rng):
    """A disc around its source, crumpled, but without intersections."""
    while True:
        angle = np.pi / 3 * np.arange(6)
        ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        far = np.stack([4 * np.cos(angle), 4 * np.sin(angle), 0 * angle], axis=1)
        vertices = np.concatenate([[[0.0, 0, 0]], ring * rng.uniform(0.1, 1.5, (6, 1))])
        vertices[1:, 2] += rng.normal(size=6)
        vertices = np.concatenate([vertices, far])
        around, outer = 1 + np.arange(6), 7 + np.arange(6)
        after, beyond = 1 + (around % 6), 7 + (around % 6)
        faces = np.concatenate(
            [
                np.stack([np.zeros(6, int), around, after], axis=1),
                np.stack([around, outer, beyond], axis=1),
                np.stack([around, beyond, after], axis=1),
            ]
        )
        if not sum(map(len, intersecting_pairs(vertices, faces))):
            return Surface(vertices, faces, np.arange(13) > 6, 0)


def below(surface, point):
    """Whether a point is below a disc, by the solid angle of the disc closed far up."""
    rim = np.arange(7, 13)
    cap = [[rim[(k + 1) % 6], rim[k], 13] for k in range(6)]
    vertices = np.concatenate([surface.vertices, [[0.0, 0.0, 1e3]]])
    faces = np.concatenate([surface.faces, cap])
    return abs(winding_number(point[None], vertices, faces)[0]) < 0.25


def test_daughter_is_always_inside_the_tissue():
    rng, redirected = np.random.default_rng(8), 0
    for _ in range(300):
        surface = spiky(rng)
        place = np.asarray(daughter_of_source(put_membrane(surface), 1, Parameters()))
        division = choose_polyp(surface, 5, place)
        led_out = not below(surface, place)
        redirected += led_out
        assert any(division.offset) == led_out
        if led_out:
            place = surface.vertices[0] + np.array(division.offset)
            assert np.linalg.norm(division.offset) <= 0.1 + 1e-12
        assert below(surface, place)
    assert redirected >= 5


def test_redirected_daughter_is_put_at_its_offset(particles, cone):
    offset = jnp.asarray([0.01, -0.02, 0.03])
    after = divide_polyp_to(particles, cone[0], jnp.asarray(3), offset)
    np.testing.assert_allclose(after.position[3], 3.0 + offset, atol=1e-14)
    assert after.alive[3]
    assert after.species[3] == Species.TUMOUR


def test_source_without_room_has_no_division():
    """The tissue is a tetrahedron of a hundredth of the offset."""
    surface = Surface(
        1e-3 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
        np.zeros(4, bool),
        0,
    )
    assert choose_polyp(surface, 5, np.array([0.0, 0.0, -0.1])) is None
    assert choose_polyp(surface, 5, 1e-4 * np.ones(3)) == Division(5, source=0)


def test_myoma_divides_into_two_halves_about_where_its_parent_was(particles):
    offset = jnp.asarray([0.3, -0.4, 0.0])
    after = divide_myoma(particles, jnp.asarray(1), jnp.asarray(3), offset)
    centre = np.array([1.0, 0, -1])
    np.testing.assert_allclose(after.position[3], centre + offset, atol=1e-15)
    np.testing.assert_allclose(after.position[1], centre - offset, atol=1e-15)
    assert after.species[3] == Species.TUMOUR
    assert after.alive.sum() == 4
    others = np.array([0, 2, 4, 5, 6, 7])
    np.testing.assert_array_equal(after.position[others], particles.position[others])


def test_myoma_halves_are_one_r0_apart_in_free_space():
    rng = np.random.default_rng(1)
    for _ in range(20):
        division = choose_myoma(np.array([4, 7]), 9, np.full(2, np.inf), rng)
        assert division.slot == 9
        length = np.linalg.norm(division.offset)
        np.testing.assert_allclose(2 * length, 2 * HALF_DISTANCE, rtol=1e-14)
        assert 2 * HALF_DISTANCE == 1.0


def test_myoma_halves_keep_to_their_side_of_the_membrane():
    rng = np.random.default_rng(2)
    clearance = np.array([0.3, 1e-6, 5.0])
    for _ in range(60):
        division = choose_myoma(np.arange(3), 3, clearance, rng)
        length = np.linalg.norm(division.offset)
        near = clearance[division.parent]
        np.testing.assert_allclose(length, min(0.5, 0.4 * near), rtol=1e-14)
        assert length < 0.5 * near


def test_every_tumour_particle_divides_equally_often():
    rng = np.random.default_rng(3)
    tumour = np.array([2, 5, 6, 11])
    parents = [
        choose_myoma(tumour, 12, np.full(4, np.inf), rng).parent for _ in range(4000)
    ]
    counts = np.array([parents.count(int(t)) for t in tumour])
    assert counts.sum() == 4000
    # four standard deviations of a binomial
    assert np.abs(counts - 1000).max() < 4 * np.sqrt(4000 * 0.25 * 0.75)


def test_directions_are_uniform_on_the_sphere():
    rng = np.random.default_rng(4)
    points = np.array([point_on_sphere(rng) for _ in range(20_000)])
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1, atol=1e-14)
    sigma = 4 / np.sqrt(len(points))
    # moments of the uniform distribution: 0, I/3, and 1/5 for x⁴
    np.testing.assert_allclose(points.mean(axis=0), 0, atol=sigma)
    np.testing.assert_allclose(
        points.T @ points / len(points), np.eye(3) / 3, atol=sigma
    )
    np.testing.assert_allclose((points**4).mean(axis=0), 1 / 5, atol=sigma)
    # Archimedes: each coordinate is uniform on [-1, 1]
    for column in points.T:
        counts, _ = np.histogram(column, bins=10, range=(-1, 1))
        assert np.abs(counts - 2000).max() < 4 * np.sqrt(2000)


def test_same_generator_gives_the_same_choice():
    first, second = (
        choose_myoma(np.arange(9), 9, np.full(9, np.inf), np.random.default_rng(5))
        for _ in range(2)
    )
    assert first == second
