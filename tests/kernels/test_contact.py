"""The loop over contacts computes what XLA does, and is used where it may be."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.contact import (
    _forces_by_autodiff,
    contact_energy,
    contact_forces,
    list_contacts,
    reach,
)
from jaxgrow.parameters import Parameters
from jaxgrow.state import Particles


COUNT = 60
CALL = "jaxgrow_contact"


def law(**values):
    return jax.tree.map(lambda v: jnp.asarray(v, float), Parameters(**values))


@pytest.fixture(scope="module")
def scene(make_sheet):
    """Particles on both sides of a wavy sheet, some of them dead, some very near."""
    rng = np.random.default_rng(2)
    membrane = make_sheet(lambda x, y: 0.3 * np.sin(x) * np.cos(y))
    position = rng.uniform([-0.5, -0.5, -1.2], [4.5, 4.5, 1.2], (COUNT, 3))
    corners = np.asarray(membrane.vertices)
    position[:2] = corners[17], np.mean(corners[[0, 1, 7]], axis=0)
    position[:2, 2] += 1e-3, -1e-3
    position[2] = [80.0, 0.0, 0.0]
    particles = Particles(
        jnp.asarray(position),
        jnp.zeros(COUNT, int),
        jnp.arange(COUNT) % 9 != 4,
        jnp.zeros(COUNT, bool),
    )
    return particles, membrane


@pytest.fixture(scope="module")
def contacts(scene):
    particles, membrane = scene
    listed = list_contacts(particles, membrane, reach(law()) + 0.3, 2048)
    assert not bool(listed.overflow)
    assert 500 < int(listed.real.sum()) < 1500
    return listed


def size(arrays):
    return max(float(np.abs(a[np.isfinite(a)]).max()) for a in arrays)


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"contact_sharpness": 4.0},
        {"contact_sharpness": 80.0, "contact_range": 0.9},
        {"smoothing": 0.0, "contact_adhesion": 0.0},
        {"barrier_stiffness": 0.0, "contact_stiffness": 3.0},
    ],
)
def test_forces_and_clearances_are_those_of_the_program(scene, contacts, values):
    given = *scene, contacts, law(**values)
    assert CALL in jax.jit(contact_forces).lower(*given).as_text()
    found = jax.jit(contact_forces)(*given)
    wanted = jax.jit(_forces_by_autodiff)(*given)
    scale = size(wanted[:2])
    assert scale > 1
    for a, b in zip(found[:2], wanted[:2], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-12 * scale)
    for a, b in zip(found.clearances, wanted.clearances, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-11)
    assert np.isinf(found.clearances[0][2])  # far from everything


def test_triangle_without_area_is_its_sides(scene, contacts):
    particles, membrane = scene
    vertices = membrane.vertices.at[22].set(membrane.vertices[21])
    given = particles, eqx.tree_at(lambda m: m.vertices, membrane, vertices)
    found = contact_forces(*given, contacts, law())
    wanted = _forces_by_autodiff(*given, contacts, law())
    scale = size(wanted[:2])
    np.testing.assert_allclose(found.particles, wanted.particles, atol=1e-12 * scale)
    # which of two vertices at one place is pushed nobody knows
    both = [
        f.vertices.at[21].add(f.vertices[22]).at[22].set(0) for f in (found, wanted)
    ]
    np.testing.assert_allclose(*both, atol=1e-12 * scale)


def test_reaction_is_equal_and_opposite(scene, contacts):
    found = contact_forces(*scene, contacts, law())
    total = np.sum(found.particles, axis=0) + np.sum(found.vertices, axis=0)
    assert np.abs(total).max() < 1e-13 * size(found[:2])


def test_padding_in_between_does_not_count(scene, contacts):
    keep = np.arange(len(contacts.real)) % 3 != 0
    fewer = eqx.tree_at(lambda c: c.real, contacts, contacts.real & keep)
    found = contact_forces(*scene, fewer, law())
    wanted = _forces_by_autodiff(*scene, fewer, law())
    scale = size([wanted.particles])
    np.testing.assert_allclose(found.particles, wanted.particles, atol=1e-12 * scale)
    np.testing.assert_array_equal(
        np.isinf(found.clearances[1]), np.isinf(wanted.clearances[1])
    )


def test_derivative_is_the_hessian_of_the_energy(scene, contacts):
    particles, membrane = scene
    rng = np.random.default_rng(3)
    # the two that nearly touch have curvatures of 1e12: nothing else would count
    position = particles.position.at[:2].add(jnp.asarray([0.0, 0.0, 0.4]))
    push = jnp.asarray(rng.normal(size=position.shape))
    bend = jnp.asarray(rng.normal(size=membrane.vertices.shape))

    def energy(position, vertices):
        there = eqx.tree_at(lambda p: p.position, particles, position)
        bent = eqx.tree_at(lambda m: m.vertices, membrane, vertices)
        return -contact_energy(there, bent, contacts, law())

    def forces(position, vertices):
        there = eqx.tree_at(lambda p: p.position, particles, position)
        bent = eqx.tree_at(lambda m: m.vertices, membrane, vertices)
        found = contact_forces(there, bent, contacts, law())
        return found.particles, found.vertices

    @jax.jit
    def both(position, vertices):
        given, along = (position, vertices), (push, bend)
        _, found = jax.jvp(forces, given, along)
        _, back = jax.vjp(forces, *given)
        _, wanted = jax.jvp(jax.grad(energy, argnums=(0, 1)), given, along)
        return found, back(along), wanted

    found, back, wanted = both(position, membrane.vertices)
    for a, b, c in zip(found, back, wanted, strict=True):
        np.testing.assert_allclose(a, c, atol=1e-11 * size(wanted))
        np.testing.assert_allclose(b, c, atol=1e-11 * size(wanted))


def test_other_types_are_left_to_xla(scene, contacts):
    single = jax.tree.map(
        lambda x: x.astype(jnp.float32) if x.dtype == jnp.float64 else x,
        (*scene, contacts, law()),
    )
    assert CALL not in jax.jit(contact_forces).lower(*single).as_text()
