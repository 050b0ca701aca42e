"""Sides of a closed surface."""

import igl
import numpy as np
import pytest

from jaxgrow.mesh.winding import ON_SURFACE, particles_outside, winding_number

from ..brute_force import winding


def test_the_number_is_one_inside_and_zero_outside(sphere):
    surface = sphere(2, 3.0)
    points = np.random.default_rng(0).normal(size=(400, 3)) * 2
    radius = np.linalg.norm(points, axis=1)
    points = points[np.abs(radius - 2.95) > 0.1]
    number = winding_number(points, surface.vertices, surface.faces)
    inside = np.linalg.norm(points, axis=1) < 2.95
    assert np.abs(number - inside).max() < 1e-12


@pytest.mark.parametrize("moved", [0.0, 1e3])
def test_the_loop_sums_up_all_solid_angles(sphere, moved):
    """Near and far, in faces, edges and vertices, and for faces without an area."""
    surface = sphere(2)
    faces = np.concatenate([surface.faces, surface.faces[:3, [0, 1, 1]]])
    corners = surface.vertices[surface.faces[:4]]
    on = [corners.mean(axis=1), corners[:, :2].mean(axis=1), corners[:, 0]]
    spread = np.random.default_rng(0).normal(size=(300, 3))
    points = np.concatenate([spread, 30 * spread, *on]) + moved
    vertices = surface.vertices + moved
    by_loop = winding_number(points, vertices, faces)
    wanted = winding(points, vertices, faces, ON_SURFACE)
    surely = slice(None) if moved == 0.0 else slice(600)  # rounding moves what is on it
    np.testing.assert_allclose(by_loop[surely], wanted[surely], atol=1e-11)


def test_inside_out_the_number_changes_its_sign(sphere):
    surface = sphere(1)
    number = winding_number(np.zeros((1, 3)), surface.vertices, surface.faces[:, ::-1])
    assert number[0] == pytest.approx(-1.0)


def test_a_surface_inside_another_counts_twice(sphere):
    outer, inner = sphere(1, 2.0), sphere(1, 1.0)
    vertices = np.concatenate([outer.vertices, inner.vertices])
    faces = np.concatenate([outer.faces, inner.faces + 42])
    points = np.array([[0.0, 0, 0], [0, 0, 1.5], [0, 0, 3]])
    assert winding_number(points, vertices, faces) == pytest.approx([2, 1, 0])


def test_the_number_agrees_with_libigl_on_an_open_surface(grid):
    surface = grid(5)
    points = np.random.default_rng(0).normal(size=(100, 3)) * 3
    number = winding_number(points, surface.vertices, surface.faces)
    theirs = igl.winding_number(surface.vertices, surface.faces, points)
    assert np.allclose(number, theirs, atol=1e-12)


@pytest.mark.parametrize(
    "tissue, wrong",
    [("outside", [True, False]), ("inside", [False, True])],
)
def test_particles_on_the_wrong_side_on_the_surface_or_nowhere_are_named(
    sphere, tissue, wrong
):
    surface = sphere(1)
    corner = surface.vertices[surface.faces[0]]
    on = [corner.mean(axis=0), corner[:2].mean(axis=0), corner[0]]
    points = np.array([[0.0, 0, 0], [0, 0, 2], *on, [np.nan, 0, 0]])
    found = particles_outside(surface.vertices, surface.faces, points, tissue)
    assert found.tolist() == [*wrong, True, True, True, True]


def test_a_tissue_that_is_neither_side_is_refused(sphere):
    surface = sphere(0)
    with pytest.raises(ValueError, match='must be "outside"'):
        particles_outside(surface.vertices, surface.faces, np.zeros((1, 3)), "within")
