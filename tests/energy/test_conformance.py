"""What every energy term keeps: one battery over pairs, springs and contact."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from .conftest import sheets_at_rest


IDENTITY = 1e-12  # 64 eps, times the magnitude of sums over all pairs


def moved(scene, map_points):
    """Particles and membrane with all positions mapped."""
    position = map_points(np.asarray(scene.particles.position))
    vertices = map_points(np.asarray(scene.membrane.vertices))
    return (
        eqx.tree_at(lambda p: p.position, scene.particles, jnp.asarray(position)),
        eqx.tree_at(lambda m: m.vertices, scene.membrane, jnp.asarray(vertices)),
    )


def test_term_is_not_trivial_here(term, scene):
    energy, gradient = term(scene.particles, scene.membrane)
    assert abs(energy) > 0.1
    assert max(np.abs(g).max() for g in jax.tree.leaves(gradient)) > 0.1


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_precision_of_the_positions_is_kept(term, scene, dtype):
    exact, _ = term(scene.particles, scene.membrane)
    cast = jax.tree.map(
        lambda x: x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x,
        (scene.particles, scene.membrane),
    )
    energy, gradient = term(*cast)
    assert energy.dtype == dtype
    assert {g.dtype for g in jax.tree.leaves(gradient)} == {jnp.dtype(dtype)}
    np.testing.assert_allclose(energy, exact, rtol=1e3 * jnp.finfo(dtype).eps)


def test_translation_changes_nothing(term, scene):
    before, slope = term(scene.particles, scene.membrane)
    after, same = term(*moved(scene, lambda x: x + np.array([3.0, -2.0, 7.0])))
    np.testing.assert_allclose(after, before, atol=IDENTITY, rtol=IDENTITY)
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, atol=100 * IDENTITY), same, slope
    )


def test_rotation_changes_nothing_but_turns_the_forces(term, scene):
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    before, slope = term(scene.particles, scene.membrane)
    after, turned = term(*moved(scene, lambda x: x @ turn.T))
    np.testing.assert_allclose(after, before, atol=IDENTITY, rtol=IDENTITY)
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b @ turn.T, atol=100 * IDENTITY),
        turned,
        slope,
    )


def test_order_of_everything_is_irrelevant(term, scene):
    rng = np.random.default_rng(5)
    particles, membrane = scene.particles, scene.membrane
    order = rng.permutation(particles.position.shape[0])
    vertex = rng.permutation(membrane.vertices.shape[0])
    face = rng.permutation(membrane.faces.shape[0])
    edge = rng.permutation(membrane.edges.shape[0])
    new_index = np.append(np.argsort(vertex), -1)
    mixed = eqx.tree_at(
        lambda m: (
            *(m.vertices, m.faces, m.edges, m.opposite, m.rest),
            *(m.reference, m.hyperplasia),
        ),
        membrane,
        (
            membrane.vertices[vertex],
            jnp.asarray(np.roll(new_index[membrane.faces][face], 1, axis=1)),
            jnp.asarray(new_index[membrane.edges][edge][:, ::-1].copy()),
            jnp.asarray(new_index[membrane.opposite][edge][:, ::-1].copy()),
            {
                name: rest[edge if len(rest) == len(edge) else face]
                for name, rest in membrane.rest.items()
            },
            membrane.reference[vertex],
            membrane.hyperplasia[vertex],
        ),
    )
    mixed = sheets_at_rest(mixed)  # their metric is that of the first two edges
    before, slope = term(particles, membrane)
    after, same = term(jax.tree.map(lambda x: x[order], particles), mixed)
    np.testing.assert_allclose(after, before, rtol=IDENTITY)
    np.testing.assert_allclose(
        same.particles, slope.particles[order], atol=100 * IDENTITY
    )
    np.testing.assert_allclose(
        same.vertices, slope.vertices[vertex], atol=100 * IDENTITY
    )


def test_forces_add_up_to_nothing(term, scene):
    _, gradient = term(scene.particles, scene.membrane)
    total = sum(np.asarray(g).sum(axis=0) for g in jax.tree.leaves(gradient))
    np.testing.assert_allclose(total, np.zeros(3), atol=IDENTITY)


def test_torques_add_up_to_nothing(term, scene):
    _, slope = term(scene.particles, scene.membrane)
    torque = np.cross(scene.particles.position, slope.particles).sum(axis=0)
    torque += np.cross(scene.membrane.vertices, slope.vertices).sum(axis=0)
    np.testing.assert_allclose(torque, np.zeros(3), atol=10 * IDENTITY)


def padded(scene, garbage, like):
    """The scene with dead slots up to the shapes of another, of random values."""
    rng = np.random.default_rng(garbage)
    particles, membrane = scene.particles, scene.membrane
    count = len(like.membrane.vertices)

    def more(array, full, values):
        extra = (len(full) - len(array), *full.shape[1:])
        return jnp.concatenate([array, jnp.asarray(values(extra)).astype(array.dtype)])

    def filled(body, other, **values):
        return dataclasses.replace(
            body,
            **{
                name: more(getattr(body, name), getattr(other, name), some)
                for name, some in values.items()
            },
        )

    def somewhere(shape):
        return rng.uniform(-1, 4, shape)

    def perhaps(shape):
        return rng.random(shape) < 0.5

    particles = filled(
        particles,
        like.particles,
        position=somewhere,
        species=lambda shape: rng.integers(0, 2, shape),
        alive=np.zeros,
        held=perhaps,
    )
    rest = {
        name: more(of, like.membrane.rest[name], lambda shape: rng.uniform(0, 2, shape))
        for name, of in membrane.rest.items()
    }
    return particles, filled(
        membrane.with_rest(rest),
        like.membrane,
        vertices=somewhere,
        faces=lambda shape: rng.integers(0, count, shape),
        edges=lambda shape: rng.integers(0, count, shape),
        opposite=lambda shape: rng.integers(-1, count, shape),
        reference=somewhere,
        hyperplasia=rng.random,
        vertex_alive=np.zeros,
        face_alive=np.zeros,
        edge_alive=np.zeros,
        pinned=perhaps,
    )


@pytest.mark.parametrize("garbage", [1, 2])
def test_padding_is_inert_whatever_it_holds(term, scene, small, garbage):
    before, slope = term(small.particles, small.membrane)
    after, with_padding = term(*padded(small, garbage, like=scene))
    np.testing.assert_allclose(after, before, rtol=IDENTITY)
    for long, short in zip(
        jax.tree.leaves(with_padding), jax.tree.leaves(slope), strict=True
    ):
        np.testing.assert_allclose(long[: len(short)], short, atol=IDENTITY)
        assert len(long) > len(short)
        assert not np.any(long[len(short) :])


def coincidences(scene):
    """Everything that can lie on each other, in one scene."""
    position = np.array(scene.particles.position)
    vertices = np.array(scene.membrane.vertices)
    faces = np.asarray(scene.membrane.faces)
    vertices[1] = vertices[0]  # an edge of length 0, triangles without area
    position[1] = position[0]  # two particles at one point
    position[2] = vertices[7]  # a particle on a vertex
    position[3] = vertices[faces[20]].mean(axis=0)  # in a triangle
    position[4] = vertices[faces[25]][:2].mean(axis=0)  # on an edge
    position[5] = vertices[0]  # on the edge of length 0
    return (
        eqx.tree_at(lambda p: p.position, scene.particles, jnp.asarray(position)),
        eqx.tree_at(lambda m: m.vertices, scene.membrane, jnp.asarray(vertices)),
    )


def test_value_and_gradient_are_finite_at_coincidence(term, scene):
    energy, gradient = term(*coincidences(scene))
    assert np.isfinite(energy)
    for part in jax.tree.leaves(gradient):
        assert np.isfinite(part).all()
