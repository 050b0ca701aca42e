"""The surface tension of the membrane."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxgrow.energy.parameters import Parameters
from jaxgrow.energy.springs import Springs
from jaxgrow.energy.tension import Tension
from jaxgrow.energy.term import energy_of_elements
from jaxgrow.transfer.constructors import make_membrane

from .conftest import grid


TENSION = 0.7
FILM = Tension()


def total(membrane, term=FILM, **parameters):
    law = Parameters(**{"surface_tension": TENSION, **parameters})
    elements = term.elements(None, membrane)
    return energy_of_elements(term, membrane.vertices, elements, law)


def forces(membrane, term=FILM, **parameters):
    slope = jax.grad(lambda x: total(membrane.at(x), term, **parameters))
    return -np.asarray(slope(membrane.vertices))


def ball(radius, subdivisions):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    membrane = make_membrane(np.array(mesh.vertices), np.array(mesh.faces))
    return mesh, membrane


def hexagon(side=1.0):
    """Six equilateral triangles around vertex 0."""
    turn = np.pi / 3 * np.arange(6)
    rim = side * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    faces = [[0, 1 + k, 1 + (k + 1) % 6] for k in range(6)]
    return make_membrane(np.vstack([np.zeros(3), rim]), faces, pinned=False)


def test_energy_is_the_tension_times_the_area():
    mesh, membrane = ball(3.0, 2)
    np.testing.assert_allclose(total(membrane), TENSION * mesh.area, rtol=1e-13)


def left_over(subdivisions, radius=3.0):
    """Forces on a film of this radius under its pressure of Laplace, by their mean."""
    mesh, membrane = ball(radius, subdivisions)
    pressure = 2 * TENSION / radius
    corners = mesh.triangles
    for_each = np.stack(
        [np.cross(corners[:, k - 2], corners[:, k - 1]) / 6 for k in range(3)], axis=1
    )
    pushed = np.zeros_like(mesh.vertices)
    np.add.at(pushed, mesh.faces, pressure * for_each)  # the volume's gradient
    own = forces(membrane)
    return np.linalg.norm(own + pushed) / np.linalg.norm(own)


def test_sphere_under_the_pressure_of_laplace_is_at_rest():
    coarse, fine = left_over(2), left_over(4)
    assert fine < 0.01
    assert fine < 0.5 * coarse


def test_force_on_the_rim_of_a_flat_disc_is_the_tension_of_the_edges_it_spans():
    side = 1.3
    force = forces(hexagon(side))
    outward = np.asarray(hexagon().vertices)
    wanted = -TENSION * np.sqrt(0.75) * side * outward
    np.testing.assert_allclose(force, wanted, atol=1e-15)


def test_flat_sheet_feels_nothing_inside_whatever_its_triangles():
    rng = np.random.default_rng(3)
    vertices, faces, _ = grid(6)
    inner = ~np.isin(vertices[:, :2], (0, 5)).any(axis=1)
    vertices[inner, :2] += 0.25 * rng.uniform(-1, 1, (inner.sum(), 2))
    force = forces(make_membrane(vertices, faces))
    np.testing.assert_allclose(force[inner], 0, atol=1e-15)
    assert np.abs(force[~inner]).max() > 0.1


def test_springs_just_reset_have_the_tension_of_their_pretension():
    stiffness, pretension = 0.04, 0.2
    flat = hexagon()
    lifted = flat.at(flat.vertices.at[0, 2].set(1e-5))
    law = {"spring_stiffness": stiffness, "pretension": pretension}
    springs = forces(lifted, Springs(), **law)[0, 2]
    film = forces(lifted, surface_tension=np.sqrt(3) * stiffness * pretension)[0, 2]
    assert springs < 0
    # springs have a share of their stiffness in it, of the order of the height squared
    np.testing.assert_allclose(film, springs, rtol=1e-8)


@pytest.mark.parametrize("flat", [[0, 1], [0, 1, 2]])
def test_triangle_without_area_has_no_force(flat):
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0.3, 1, 0]])
    membrane = make_membrane(vertices, [[0, 1, 2]])
    vertices[flat] = vertices[0]
    assert not np.any(forces(membrane.at(jnp.asarray(vertices))))


def test_there_is_nothing_to_reset(scene):
    assert scene.membrane.rest["tension"].shape == (len(scene.membrane.faces), 0)
