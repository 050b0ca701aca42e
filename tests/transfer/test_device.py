"""Crossing between host and device."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.mesh.fairing import fair
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.topology import build_topology
from jaxgrow.runtime.compilations import count_compilations
from jaxgrow.transfer.device import (
    get,
    get_particles,
    get_surface,
    put,
    put_membrane,
    put_particles,
    put_remeshed,
    reset_springs,
    with_capacity,
)


@pytest.fixture(scope="module")
def surface():
    """A bumpy square of 49 vertices with its rim fixed."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:7, :7]
    vertices = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(float)
    index = np.arange(49).reshape(7, 7)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    fixed = np.ones((7, 7), bool)
    fixed[1:-1, 1:-1] = False
    fixed = fixed.ravel()
    vertices[~fixed] += 0.2 * rng.normal(size=(25, 3))
    return Surface(vertices, faces, fixed, 24)


@pytest.mark.parametrize("shape", [(3,), (257, 3), (4099, 3)])
def test_what_is_put_is_a_copy_and_no_program(shape):
    """Memory at a multiple of 64 bytes is what a processor would take as it is."""
    count = int(np.prod(shape))
    raw = np.zeros(8 * count + 64, np.uint8)
    begin = -raw.ctypes.data % 64
    array = raw[begin : begin + 8 * count].view(float).reshape(shape)
    with count_compilations() as compilations:
        there = put(array)
    array[:] = 1.0
    assert compilations.count == 0
    np.testing.assert_array_equal(there, 0.0)


def test_surface_comes_back_as_it_went(surface):
    back = get_surface(put_membrane(surface))
    np.testing.assert_array_equal(back.vertices, surface.vertices)
    np.testing.assert_array_equal(back.faces, surface.faces)
    np.testing.assert_array_equal(back.fixed, surface.fixed)
    assert back.source == surface.source


def test_membrane_has_every_edge_once_at_its_current_length(surface):
    membrane = put_membrane(surface)
    alive = get(membrane.edge_alive)
    edges = get(membrane.edges)[alive]
    wanted = build_topology(surface.faces, 49).edges
    assert {tuple(sorted(e)) for e in edges.tolist()} == {
        tuple(sorted(e)) for e in wanted.tolist()
    }
    assert len(edges) == len(wanted)
    start, end = surface.vertices[edges.T]
    np.testing.assert_allclose(
        get(membrane.rest_length)[alive],
        np.linalg.norm(end - start, axis=1),
        rtol=1e-15,
    )


def test_padding_of_a_membrane_is_dead(surface):
    membrane = put_membrane(surface)
    assert membrane.vertex_alive.sum() == 49
    assert membrane.face_alive.sum() == 72
    for name in ("vertices", "faces", "edges", "rest_length", "pinned"):
        assert not np.any(get(getattr(membrane, name))[200:])


def test_particles_come_back_as_they_went():
    rng = np.random.default_rng(1)
    position, species = rng.normal(size=(5, 3)), np.array([0, 1, 1, 0, 1])
    held = np.array([True, False, False, False, False])
    particles = put_particles(position, species, held, 12)
    back, kind = get_particles(particles)
    np.testing.assert_array_equal(back, position)
    np.testing.assert_array_equal(kind, species)
    np.testing.assert_array_equal(particles.held[:5], held)
    np.testing.assert_array_equal(particles.free[:5], ~held)
    assert not np.any(particles.free[5:])


def test_more_room_changes_nobody_and_parks_the_new_slots_apart():
    particles = put_particles(
        np.zeros((2, 3)), np.array([1, 1]), np.array([False, True]), 6
    )
    more = with_capacity(particles, 10)
    for name in ("position", "species", "alive", "held"):
        before = get(getattr(particles, name))
        np.testing.assert_array_equal(get(getattr(more, name))[:6], before)
    assert not np.any(more.alive[6:])
    gap = np.linalg.norm(more.position[2:, None] - more.position[None, 2:], axis=2)
    assert (gap + 10 * np.eye(8)).min() >= 4


def test_remeshed_membrane_is_the_surface_of_the_host_to_the_bit(surface):
    membrane = put_membrane(surface)
    faired, remeshing = fair(surface, np.zeros((0, 3)), max_area=0.3, min_area=0.05)
    assert len(faired.vertices) > 60
    after = get_surface(put_remeshed(membrane, remeshing))
    np.testing.assert_array_equal(after.vertices, faired.vertices)
    np.testing.assert_array_equal(after.faces, faired.faces)
    np.testing.assert_array_equal(after.fixed, faired.fixed)
    assert after.source == faired.source


def test_remeshed_membrane_never_shrinks_in_capacity(surface):
    membrane = put_membrane(surface)
    faired, remeshing = fair(surface, np.zeros((0, 3)), max_area=0.05, min_area=1e-3)
    grown = put_remeshed(membrane, remeshing)
    assert grown.vertices.shape[0] > 256
    assert grown.faces.shape[0] == 2 * grown.vertices.shape[0]
    _, remeshing = fair(faired, np.zeros((0, 3)), max_area=9, min_area=0.0)
    again = put_remeshed(grown, remeshing)
    assert again.vertices.shape == grown.vertices.shape


def test_remeshing_carries_derivatives(surface):
    membrane = put_membrane(surface)
    _, remeshing = fair(surface, np.zeros((0, 3)), max_area=0.3, min_area=0.05)
    weight = np.random.default_rng(2).normal(size=(256, 3))

    def value(vertices):
        import equinox as eqx

        moved = eqx.tree_at(lambda m: m.vertices, membrane, vertices)
        after = put_remeshed(moved, remeshing)
        return jnp.sum(after.vertices * weight) + jnp.sum(after.rest_length**2)

    slope = jax.grad(value)(membrane.vertices)
    along = np.zeros((256, 3))
    along[:49] = np.random.default_rng(3).normal(size=(49, 3))
    h = 1e-6
    up, down = (value(membrane.vertices + s * h * along) for s in (1, -1))
    np.testing.assert_allclose((slope * along).sum(), (up - down) / (2 * h), rtol=1e-7)


def test_reset_takes_the_current_lengths(surface):
    import equinox as eqx

    membrane = put_membrane(surface)
    wide = eqx.tree_at(lambda m: m.vertices, membrane, 2 * membrane.vertices)
    np.testing.assert_allclose(
        reset_springs(wide).rest_length, 2 * membrane.rest_length, rtol=1e-15
    )


def test_values_on_the_host_are_cut_off_from_derivatives():
    def value(x):
        assert isinstance(get(x), np.ndarray)
        return jnp.sum(x) * float(get(x).sum())

    np.testing.assert_array_equal(jax.grad(value)(jnp.ones(3)), 3.0)
