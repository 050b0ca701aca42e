"""Base ring, contact angle and sphericity of spheres cut by a plane."""

import jax
import numpy as np
import pytest

from jaxgrow.metrics.elevation import height_and_direction
from jaxgrow.metrics.field import patches_of
from jaxgrow.metrics.ring import contact_angle, ring_of

from .surfaces import cap, cylinder, disc_of, leaning, mesh, roomy


@jax.jit
def measure(state):
    membrane = state.membrane
    above, gradient = height_and_direction(membrane.vertices, state.frame.former)
    patches = patches_of(membrane)
    ring = ring_of(membrane, patches, above)
    return ring, ring.sphericity, contact_angle(membrane, patches, above, gradient)


@pytest.fixture(scope="module")
def found(make_state):
    def of(profile, turned=lambda vertices: vertices):
        vertices, faces, rim = mesh(profile, 0.8)
        surface = turned(vertices), faces, rim
        return measure(roomy(make_state(surface, disc_of(vertices, rim))))

    return of


@pytest.mark.parametrize("share", [0.25, 0.4, 0.5, 0.68, 0.8, 0.9])
def test_contact_angle_of_a_sphere_cut_by_a_plane(found, share):
    radius = 5.0
    _, _, angle = found(cap(radius, 2 * radius * share))
    wanted = np.degrees(np.arccos(2 * share - 1))
    np.testing.assert_allclose(angle, wanted, atol=4)


def test_contact_angle_of_a_tube_is_right(found):
    np.testing.assert_allclose(found(cylinder(2.0, 8.0))[2], 90, atol=2)


def test_ring_of_a_leaning_tube_is_its_ellipse(found):
    lean = np.radians(40)
    ring, _, _ = found(
        cylinder(2.0, 8.0), lambda vertices: leaning(vertices, lean, 2.0, 8.0)
    )
    np.testing.assert_allclose(ring.centre, [0.5 * np.tan(lean), 0, 0.5], atol=0.08)
    area = np.pi * 4 / np.cos(lean)
    np.testing.assert_allclose(ring.vector, [0, 0, area], rtol=0.03, atol=0.2)


@pytest.mark.parametrize("share", [0.25, 0.5, 0.8, 0.95])
def test_sphericity_is_that_of_the_body_and_at_most_one(found, share):
    radius, height = 4.0, 8 * share
    _, sphericity, _ = found(cap(radius, height))
    raised = height - 0.5
    volume = np.pi * raised**2 * (3 * radius - raised) / 3
    base = np.pi * raised * (2 * radius - raised)
    wanted = np.pi ** (1 / 3) * (6 * volume) ** (2 / 3)
    wanted /= 2 * np.pi * radius * raised + base
    np.testing.assert_allclose(sphericity, wanted, rtol=0.02)
    assert sphericity <= 1
