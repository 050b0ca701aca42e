"""The bending of the membrane."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.bending import Bending, hinge_angle
from jaxgrow.energy.parameters import Parameters
from jaxgrow.energy.term import energy_of_elements
from jaxgrow.transfer.constructors import make_membrane

from .conftest import grid


MODULUS = 0.7


def total(membrane):
    elements = Bending().elements(None, membrane)
    parameters = Parameters(bending_stiffness=MODULUS)
    return energy_of_elements(Bending(), membrane.vertices, elements, parameters)


def columns(points):
    return tuple(tuple(jnp.asarray(x) for x in point) for point in points)


@pytest.mark.parametrize("angle", [-2.5, -0.3, 0.0, 1e-9, 0.4, 3.0])
def test_angle_is_that_between_the_normals_and_positive_where_convex(angle):
    # the left triangle lies flat, its normal up; the other is turned down by the angle
    right = [0.3, -np.cos(angle), -np.sin(angle)]
    found = hinge_angle(columns(np.array([[0, 0, 0], [1, 0, 0], [0.4, 1, 0], right])))
    np.testing.assert_allclose(found, angle, atol=1e-15)


def test_energy_of_one_hinge_is_the_formula(scene):
    fold = np.array([[0, 0, 0], [2.0, 0, 0], [1, 1.5, 0], [1, -1.0, 0.4]])
    flat = make_membrane(fold * [1, 1, 0], [[0, 1, 2], [1, 0, 3]], pinned=False)
    area = 0.5 * 2 * (1.5 + 1.0)
    angle = np.arctan2(0.4, 1.0)
    wanted = 0.5 * MODULUS * 3 * 2.0**2 / area * angle**2
    np.testing.assert_allclose(total(flat.at(jnp.asarray(fold))), wanted, rtol=1e-13)


def lattice(long, wide, spacing):
    """An equilateral lattice, rows along x."""
    y, x = np.mgrid[:wide, :long].astype(float)
    points = np.stack([x + 0.5 * (y % 2), np.sqrt(0.75) * y, 0 * x], axis=-1)
    index = np.arange(long * wide).reshape(wide, long)
    a, b = index[:-1, :-1], index[:-1, 1:]
    d, c = index[1:, :-1], index[1:, 1:]
    odd = (np.arange(wide - 1) % 2 == 1)[:, None]
    first = np.where(odd[..., None], np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    other = np.where(odd[..., None], np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    faces = np.concatenate([first.reshape(-1, 3), other.reshape(-1, 3)])
    return spacing * points.reshape(-1, 3), faces


def rolled(flat, radius, turn):
    """A sheet rolled up around an axis in its plane."""
    way = np.array([np.cos(turn), np.sin(turn), 0])
    along, across = flat @ way, flat @ np.array([-way[1], way[0], 0])
    around = radius * np.sin(along / radius)
    height = radius * (1 - np.cos(along / radius))
    return (
        around[:, None] * way
        + across[:, None] * [-way[1], way[0], 0]
        + (height[:, None] * [0, 0, 1])
    )


def energy_per_area(spacing, turn, radius=6.0):
    """Energy of a rolled lattice over its area, in units of κ / R²."""
    count = round(12 / spacing)
    flat, faces = lattice(count, count, spacing)
    membrane = make_membrane(flat, faces, pinned=False)
    area = len(faces) * np.sqrt(0.75) / 2 * spacing**2
    energy = total(membrane.at(jnp.asarray(rolled(flat, radius, turn))))
    return float(energy) / area / MODULUS * radius**2


@pytest.mark.parametrize("turn", [0.0, 0.3, np.pi / 2])
def test_modulus_does_not_depend_on_the_triangulation(turn):
    # edges of the rim have no hinge: their share vanishes as the lattice is refined
    coarse, fine = energy_per_area(0.4, turn), energy_per_area(0.1, turn)
    np.testing.assert_allclose(fine, 1.5, rtol=0.03)
    assert abs(fine - 1.5) < abs(coarse - 1.5)


def test_flat_surface_has_no_energy_and_no_force(scene):
    vertices, faces, _ = grid(5)
    flat = make_membrane(vertices, faces, pinned=False)
    value, slope = jax.value_and_grad(lambda x: total(flat.at(x)))(flat.vertices)
    assert value == 0
    assert not np.any(slope)


def test_rim_has_no_hinges(scene):
    _, alive = Bending().stencil(scene.membrane)
    rim = 4 * 4
    assert int(alive.sum()) == len(alive) - rim
