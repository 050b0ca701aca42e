"""Which part of the surface is the lesion, and how large it is."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.distance import pdist

from jaxgrow.lesions.myoma import Myoma
from jaxgrow.lesions.polyp import Polyp
from jaxgrow.lesions.size import (
    diameter,
    height_above,
    lesion_vertices,
    raised,
)
from jaxgrow.mesh.surface import Surface
from jaxgrow.state import FormerSurface, Frame, Species, State
from jaxgrow.transfer.device import put_membrane, put_particles


SIDE = 13


def level(x, _):
    return 0 * x


def grid(height):
    line = np.arange(SIDE) - SIDE // 2
    x, y = np.meshgrid(line.astype(float), line.astype(float))
    vertices = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    index = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    rim = (abs(vertices[:, :2]) == SIDE // 2).any(axis=1)
    return vertices, faces, rim


def two_bumps(x, y):
    """A bump of the tumour at the middle, and one of tissue alone at (4, 0)."""
    bump = np.where(abs(x) + abs(y) <= 1, 2.0, 0.0)
    return bump + np.where((abs(x - 4) <= 0.5) & (abs(y) <= 0.5), 1.0, 0.0)


@pytest.fixture(scope="module")
def state():
    vertices, faces, rim = grid(two_bumps)
    flat, _, _ = grid(level)
    tumour = np.array([[0, 0, 1.5], [0.2, 0, 0.5], [-3.0, 0, -0.4], [4, 0, 0.3]])
    species = np.array([1, 1, 1, 0])
    particles = put_particles(tumour, species, np.zeros(4, bool), 8)
    frame = Frame(
        jnp.zeros(3),
        jnp.array([0.0, 0, 1]),
        jnp.asarray(1.0),
        FormerSurface(jnp.asarray(flat), jnp.asarray(faces)),
    )
    membrane = put_membrane(Surface(vertices, faces, rim, SIDE * SIDE // 2))
    return State(particles, membrane, frame)


def places(state, mask):
    vertices = np.asarray(state.membrane.vertices)[: SIDE * SIDE]
    return {(round(x), round(y)) for x, y, _ in vertices[mask]}


CROSS = {(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)}


def test_raised_is_what_the_tumour_lifted_and_not_what_tissue_did(state):
    assert places(state, raised(state)) == CROSS


def test_lesion_is_raised_or_close_to_its_tumour(state):
    # the particle under (-3, 0) is closer to it than one r0
    assert places(state, lesion_vertices(state)) == CROSS | {(-3, 0)}


def test_surface_raised_by_a_tumour_under_tissue_belongs_to_the_lesion(state):
    # 2 r0 under the top of the bump, so that it covers nothing closely
    deep = eqx.tree_at(
        lambda s: s.particles.position,
        state,
        state.particles.position.at[:3].set(jnp.array([0.0, 0.0, 0.0])),
    )
    assert places(deep, raised(deep)) == CROSS


def test_surface_lower_than_half_r0_is_not_raised(state):
    low = eqx.tree_at(
        lambda s: s.membrane.vertices,
        state,
        state.membrane.vertices * jnp.asarray([[1, 1, 0.24]]),
    )
    assert not raised(low).any()


def test_size_of_a_polyp_is_the_diameter_of_its_raised_surface(state):
    assert Polyp(divisions=1).size(state) == 2.0


def test_size_of_a_myoma_is_the_diameter_of_its_body(state):
    wanted = np.linalg.norm([3.0, 0, 1.9]) + 1
    assert Myoma(divisions=1).size(state) == pytest.approx(wanted, rel=1e-14)


def test_size_of_a_polyp_carries_the_derivative_of_its_diameter(state):
    # the diameter lies across the axis
    def size(factor):
        across = jnp.stack([factor, factor, jnp.ones(())])
        wider = eqx.tree_at(
            lambda s: s.membrane.vertices,
            state,
            state.membrane.vertices * across[None, :],
        )
        return Polyp(divisions=1).size(wider)

    value, slope = jax.value_and_grad(size)(jnp.ones(()))
    assert value == 2.0
    assert slope == pytest.approx(2.0, rel=1e-14)


def test_size_of_a_myoma_carries_the_derivative_of_its_diameter(state):
    def size(factor):
        wider = eqx.tree_at(
            lambda s: s.particles.position, state, factor * state.particles.position
        )
        return Myoma(divisions=1).size(wider)

    value, slope = jax.value_and_grad(size)(jnp.ones(()))
    assert value == size(1.0)
    assert slope == pytest.approx(np.linalg.norm([3.0, 0, 1.9]), rel=1e-14)


def test_no_tumour_means_no_lesion(state):
    healthy = eqx.tree_at(
        lambda s: s.particles.species, state, jnp.full(8, int(Species.TISSUE))
    )
    assert not lesion_vertices(healthy).any()


@pytest.mark.parametrize("count", [2, 49, 51, 400])
def test_diameter_is_the_largest_distance(count):
    points = np.random.default_rng(count).normal(size=(count, 3))
    assert diameter(points) == pytest.approx(pdist(points).max(), rel=1e-15)


def test_diameter_of_points_in_a_plane_is_found_without_a_hull():
    points = np.random.default_rng(0).normal(size=(80, 3))
    points[:, 2] = 0
    assert diameter(points) == pytest.approx(pdist(points).max(), rel=1e-15)


@pytest.mark.parametrize("count", [0, 1])
def test_diameter_of_fewer_than_two_points_is_zero(count):
    assert diameter(np.zeros((count, 3))) == 0


def test_height_has_the_sign_of_the_side():
    vertices, faces, _ = grid(level)
    points = np.array([[0.3, 0.2, 1.5], [1.0, 1.0, -0.7]])
    np.testing.assert_allclose(height_above(points, vertices, faces), [1.5, -0.7])


def test_size_in_a_growth_is_that_of_its_state(tiny_polyp):
    scene = tiny_polyp.scene
    size = scene.lesion.size(tiny_polyp.state) * scene.r0_mm
    assert tiny_polyp.size_mm == size
    assert tiny_polyp.history[-1].size_mm == size
