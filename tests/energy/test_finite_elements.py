"""The membrane as a continuum: elements against closed forms."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrow.energy.finite_elements import (
    CRUSHED,
    FlowingSheet,
    Kirchhoff,
    NeoHookean,
    SMALL,
)
from jaxgrow.energy.healthy import HealthySprings
from jaxgrow.energy.parameters import Parameters
from jaxgrow.energy.term import energy_of_elements
from jaxgrow.transfer.constructors import make_membrane

from ..quick_jit import quick_jit
from .conftest import grid


MODULUS, POISSON = 1.7, 0.4
SHEETS = [NeoHookean(), Kirchhoff(), FlowingSheet()]
SHEAR = MODULUS / 2 / (1 + POISSON)


@pytest.fixture(params=SHEETS, ids=[term.name for term in SHEETS])
def sheet(request):
    return request.param


def law(modulus=MODULUS, poisson=POISSON):
    each = dict.fromkeys([term.modulus for term in SHEETS], modulus)
    # arrays, as each number would be another program
    return jax.tree.map(jnp.asarray, Parameters(**each, membrane_poisson=poisson))


def healthy(vertices, faces, marks=0.0):
    """A membrane at rest; healthy where it is not marked."""
    membrane = make_membrane(vertices, faces, pinned=False)
    marks = jnp.broadcast_to(jnp.asarray(marks), len(vertices))
    membrane = dataclasses.replace(membrane, hyperplasia=marks, rest={})
    known = [*SHEETS, HealthySprings()]
    return membrane.with_rest({term.name: term.at_rest(membrane) for term in known})


def energy(vertices, term, membrane, parameters):
    elements = term.elements(None, membrane)
    return energy_of_elements(term, vertices, elements, parameters)


energy_there = quick_jit(energy)
slope_there = quick_jit(jax.value_and_grad(energy))
stiffness_there = quick_jit(jax.hessian(energy))


def slope(term, membrane, vertices):
    """Energy and its gradient with the vertices elsewhere."""
    return slope_there(jnp.asarray(vertices), term, membrane, law())


def stiffness(term, membrane, vertices, parameters=None):
    """The energy's second derivative with the vertices elsewhere."""
    given = jnp.asarray(vertices), term, membrane, parameters or law()
    return np.asarray(stiffness_there(*given))


@pytest.fixture(scope="module")
def uneven():
    """A square of side 4 in uneven triangles, somewhere in space, and its plane."""
    rng = np.random.default_rng(7)
    vertices, faces, _ = grid(5)
    inner = ~np.isin(vertices[:, :2], (0, 4)).any(axis=1)
    vertices[inner, :2] += 0.3 * rng.uniform(-1, 1, (inner.sum(), 2))
    plane = Rotation.from_rotvec([0.4, 0.9, -0.3]).as_matrix()
    return vertices, plane, inner, healthy(vertices @ plane.T, faces)


def stretched(uneven, gradient):
    vertices, plane, _, _ = uneven
    flat = vertices.copy()
    flat[:, :2] = vertices[:, :2] @ np.asarray(gradient).T
    return flat @ plane.T


def per_area(term, uneven, gradient):
    place = jnp.asarray(stretched(uneven, gradient))
    return float(energy_there(place, term, uneven[3], law())) / 16


def stress(term, uneven, gradient, step=1e-5):
    """Nominal stress of the sheet: the derivative of its energy per area."""
    found = np.zeros((2, 2))
    for i, j in np.ndindex(2, 2):
        change = np.zeros((2, 2))
        change[i, j] = step
        ends = [per_area(term, uneven, gradient + s * change) for s in (1, -1)]
        found[i, j] = (ends[0] - ends[1]) / (2 * step)
    return found


def test_uniform_strain_leaves_no_force_inside_whatever_the_triangles(sheet, uneven):
    gradient = np.array([[1.3, 0.25], [-0.1, 0.8]])
    _, force = slope(sheet, uneven[3], stretched(uneven, gradient))
    inner = uneven[2]
    np.testing.assert_allclose(force[inner], 0, atol=1e-14)
    assert np.abs(force[~inner]).max() > 0.1


UNIAXIAL = {  # stretch, the width that has no stress, the stress along
    "neo_hookean": lambda a: (a**-POISSON, SHEAR * (a - a ** (-1 - 2 * POISSON))),
    "kirchhoff": lambda a: (
        np.sqrt(1 - POISSON * (a**2 - 1)),
        MODULUS * a * (a**2 - 1) / 2,
    ),
}
UNIAXIAL["flowing"] = UNIAXIAL["neo_hookean"]


@pytest.mark.parametrize("along", [0.8, 1.3])
def test_strip_that_is_stretched_narrows_and_pulls_as_the_closed_form(
    sheet, uneven, along
):
    across, pull = UNIAXIAL[sheet.name](along)
    found = stress(sheet, uneven, np.diag([along, across]))
    np.testing.assert_allclose(found, [[pull, 0], [0, 0]], atol=1e-8)


EXPONENT = POISSON / (1 - POISSON)
BIAXIAL = {
    "neo_hookean": lambda a: SHEAR * (a - a ** (-1 - 4 * EXPONENT)),
    "kirchhoff": lambda a: MODULUS / (1 - POISSON) * a * (a**2 - 1) / 2,
}
BIAXIAL["flowing"] = BIAXIAL["neo_hookean"]


@pytest.mark.parametrize("stretch", [0.7, 1.4])
def test_stretch_to_all_sides_pulls_as_the_closed_form(sheet, uneven, stretch):
    found = stress(sheet, uneven, stretch * np.eye(2))
    wanted = BIAXIAL[sheet.name](stretch) * np.eye(2)
    np.testing.assert_allclose(found, wanted, atol=1e-7)


def test_simple_shear_has_the_energy_of_the_closed_form(sheet, uneven):
    amount = 0.6
    found = per_area(sheet, uneven, np.array([[1, amount], [0, 1]]))
    wanted = SHEAR * amount**2 / 2
    if sheet.name == "kirchhoff":
        trace, square = amount**2 / 2, amount**2 / 2 + amount**4 / 4
        both = (1 - POISSON) * square + POISSON * trace**2
        wanted = MODULUS / 2 / (1 - POISSON**2) * both
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_rigid_motion_has_no_energy_and_no_force(sheet, uneven):
    turn = Rotation.from_rotvec([1.0, -2.0, 0.5]).as_matrix()
    moved = np.asarray(uneven[3].vertices) @ turn.T + [3.0, -1.0, 2.0]
    value, force = slope(sheet, uneven[3], moved)
    assert abs(float(value)) < 1e-13
    np.testing.assert_allclose(force, 0, atol=1e-13)


def test_materials_are_one_for_small_strains(uneven):
    direction = np.array([[0.7, 0.4], [-0.2, -0.5]])

    def gap(size):
        gradient = np.eye(2) + size * direction
        one, other = (per_area(term, uneven, gradient) for term in SHEETS[:2])
        return abs(one / other - 1)

    assert gap(1e-3) < 5e-3
    np.testing.assert_allclose(gap(1e-3) / gap(5e-4), 2, rtol=0.05)


@pytest.mark.parametrize("term", SHEETS, ids=lambda term: term.name)
def test_springs_on_an_equilateral_triangle_are_such_a_sheet(term):
    spring = 0.9
    corner = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0]])
    membrane = healthy(corner, [[0, 1, 2]])
    # two triangles share a spring
    springs = Parameters(healthy_stiffness=spring / 2)
    elements = law(2 * spring / np.sqrt(3), 1 / 3)
    one, other = (
        stiffness(kind, membrane, corner, parameters)
        for kind, parameters in ((HealthySprings(), springs), (term, elements))
    )
    assert np.abs(one).max() > 0.1
    np.testing.assert_allclose(other, one, atol=1e-13)


@pytest.mark.parametrize("poisson", [0.0, 1e-9, 0.99 * SMALL, 1.01 * SMALL, 0.49])
def test_derivative_in_the_ratio_of_poisson_is_that_of_differences(sheet, poisson):
    corner = np.array([[0, 0, 0], [1, 0, 0], [0.4, 0.9, 0]])
    membrane = healthy(corner, [[0, 1, 2]])
    moved = jnp.asarray(corner * [1.5, 0.8, 1])

    def of(ratio):
        traced = dataclasses.replace(law(), membrane_poisson=ratio)
        return energy(moved, sheet, membrane, traced)

    value = jnp.asarray(poisson)
    found, step = jax.jit(jax.grad(of))(value), 1e-5
    at = jax.jit(of)
    # one-sided and of second order, as the ratio may be 0
    side = 1 if poisson < 0.4 else -1
    near, far = at(value + side * step), at(value + 2 * side * step)
    wanted = side * (4 * near - far - 3 * at(value)) / (2 * step)
    np.testing.assert_allclose(found, wanted, rtol=1e-6)


LINES = {
    "point": [[0.0, 0, 0], [0, 0, 0], [0, 0, 0]],
    "doubled": [[0.0, 0, 0], [1, 0, 0], [0, 0, 0]],
    "line": [[0.0, 0, 0], [1, 0, 0], [0.3, 0, 0]],
    "thin": [[0.0, 0, 0], [1, 0, 0], [0.3, 1e-9, 0]],
}


@pytest.mark.parametrize("corner", LINES.values(), ids=LINES)
def test_triangle_without_area_at_rest_has_no_stiffness(sheet, corner):
    membrane = healthy(np.array(corner), [[0, 1, 2]])
    regular = np.array([[0, 0, 0], [1, 0, 0], [0.4, 0.9, 0]])
    value, force = slope(sheet, membrane, regular)
    assert value == 0
    assert not np.any(force)


def test_stiffness_of_slivers_fades_with_their_height(sheet):
    def stiffest(height):
        corner = np.array([[0, 0, 0], [1, 0, 0], [0.4, height, 0]])
        membrane = healthy(corner, [[0, 1, 2]])
        return np.abs(stiffness(sheet, membrane, corner)).max()

    heights = [0.1, 0.03, 1e-2, 1e-3, 1e-5]
    assert (np.diff([stiffest(height) for height in heights]) < 0).all()


@pytest.mark.parametrize("height", [0.0, 1e-12, 0.9 * CRUSHED**0.5, -0.5])
def test_crushed_triangle_resists_with_finite_forces(sheet, height):
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [0.4, 1, 0]])
    membrane = healthy(corner, [[0, 1, 2]])
    crushed = corner * [1, height, 1]
    value, force = slope(sheet, membrane, crushed)
    assert float(value) > 0
    assert np.isfinite(force).all()
    assert np.isfinite(stiffness(sheet, membrane, crushed)).all()


def test_continued_logarithm_joins_with_its_derivatives():
    from jaxgrow.energy.finite_elements import _logarithm

    one, other = (jnp.asarray(CRUSHED * (1 + side * 1e-12)) for side in (1, -1))
    for order in (_logarithm, jax.grad(_logarithm), jax.grad(jax.grad(_logarithm))):
        np.testing.assert_allclose(order(one), order(other), rtol=1e-9)


def test_hyperplastic_endometrium_has_no_memory():
    vertices, faces, _ = grid(3)
    marks = np.zeros(9)
    marks[4] = 1.0  # the middle, a corner of every triangle but two
    around = (faces == 4).any(axis=1)
    for term in SHEETS[:2]:
        rest = np.asarray(healthy(vertices, faces, marks).rest[term.name])
        assert not rest[around, 4].any()
        assert (rest[~around, 4] == 1).all()
    assert healthy(vertices, faces, marks).rest["flowing"].shape[1] == 4
