"""Mean curvature of meshes of spheres, prisms, saddles and tori."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from jax.test_util import check_grads

from jaxgrow.metrics.curvature import mean_and_spread, mean_curvature


measure = jax.jit(mean_curvature)


def measured(vertices, faces):
    alive = jnp.ones(len(faces), bool)
    found = measure(jnp.asarray(vertices), jnp.asarray(faces), alive)
    return tuple(np.asarray(x) for x in found)


def tube(radius, rows, columns):
    """A grid around an axis, closed around it, open at both ends, normals outward."""
    angle = 2 * np.pi * np.arange(columns) / columns
    z = np.arange(rows)
    vertices = np.stack(
        np.broadcast_arrays(
            radius * np.cos(angle), radius * np.sin(angle), 0.7 * z[:, None]
        ),
        axis=-1,
    ).reshape(-1, 3)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b = index[:-1], np.roll(index, -1, axis=1)[:-1]
    c, d = np.roll(index, -1, axis=1)[1:], index[1:]
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    return vertices, faces


@pytest.mark.parametrize("inside_out, sign", [(False, 1), (True, -1)])
def test_sphere_has_the_curvature_of_its_radius_positive_outside(inside_out, sign):
    ball = trimesh.creation.icosphere(3, radius=3.0)
    faces = ball.faces[:, ::-1] if inside_out else ball.faces
    integral, area = measured(ball.vertices, faces)
    np.testing.assert_allclose(integral / area, sign / 3, rtol=0.01)


def irregular(fineness, seed):
    """Points of a unit sphere that are not where an icosphere has them."""
    ball = trimesh.creation.icosphere(fineness)
    noise = np.random.default_rng(seed).normal(size=ball.vertices.shape)
    points = ball.vertices + 0.12 * ball.edges_unique_length.mean() * noise
    return points / np.linalg.norm(points, axis=1, keepdims=True), ball.faces


def test_irregular_sphere_has_the_curvature_of_its_radius_at_single_vertices():
    vertices, faces = irregular(3, 0)
    corners = vertices[faces]
    sides = corners[:, [[1, 2], [2, 0], [0, 1]]] - corners[:, :, None]
    obtuse = (sides[:, :, 0] * sides[:, :, 1]).sum(axis=-1) < 0
    assert obtuse.any(axis=1).mean() > 0.05
    integral, area = measured(vertices, faces)
    np.testing.assert_allclose(integral / area, 1, rtol=0.01)


def test_areas_of_vertices_are_positive_on_a_bad_mesh():
    vertices, faces = irregular(2, 0)
    squeezed = vertices * [1, 1, 0.02]
    _, area = measured(squeezed, faces)
    assert area.min() > 0


def test_error_of_a_sphere_is_of_second_order():
    errors = []
    for fineness in (2, 3, 4):
        ball = trimesh.creation.icosphere(fineness)
        integral, area = measured(ball.vertices, ball.faces)
        errors.append(np.abs(integral / area - 1).max())
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(rates, 2, atol=0.3)


def test_prism_has_half_the_curvature_of_its_radius_exactly():
    vertices, faces = tube(1.5, 6, 20)
    integral, area = measured(vertices, faces)
    within = slice(20, -20)
    np.testing.assert_allclose((integral / area)[within], 1 / 3, rtol=1e-12)


def test_plane_and_saddle_have_none():
    x, y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9))
    for z in (0 * x, x**2 - y**2):
        points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
        index = np.arange(81).reshape(9, 9)
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
        faces = np.stack([[a, b, c], [a, c, d]]).transpose(0, 2, 3, 1).reshape(-1, 3)
        integral, _ = measured(points, faces)
        np.testing.assert_allclose(integral[40], 0, atol=1e-14)


def test_total_over_a_torus_is_known():
    torus = trimesh.creation.torus(4.0, 1.0, major_sections=96, minor_sections=48)
    integral, _ = measured(torus.vertices, torus.faces)
    # H = (1/a + cos t / (R + a cos t)) / 2 over dA = a (R + a cos t) dt dp
    np.testing.assert_allclose(integral.sum(), 2 * np.pi**2 * 4.0, rtol=0.005)


def test_areas_of_vertices_are_a_partition():
    vertices, faces = irregular(2, 1)
    _, area = measured(vertices, faces)
    whole = trimesh.Trimesh(vertices, faces, process=False).area
    np.testing.assert_allclose(area.sum(), whole, rtol=1e-12)


def padded(vertices, faces):
    """With vertices without faces, a dead face, and one without area."""
    more = np.concatenate([vertices, [[7.0, 7, 7], [8, 8, 8]]])
    extra = np.array([[0, 1, len(vertices)], [3, 3, 3]])
    alive = np.concatenate([np.ones(len(faces), bool), [False, True]])
    return (
        jnp.asarray(more),
        jnp.asarray(np.concatenate([faces, extra])),
        jnp.asarray(alive),
    )


def test_padding_and_faces_without_area_are_inert():
    vertices, faces = tube(1.5, 6, 20)
    without = measured(vertices, faces)
    found = measure(*padded(vertices, faces))
    for one, other in zip(found, without, strict=True):
        np.testing.assert_allclose(one[:-2], other, atol=1e-14)
        assert not one[-2:].any()


def test_slopes_are_finite_and_those_of_differences():
    rng = np.random.default_rng(0)
    vertices, faces = tube(1.5, 6, 20)
    noisy = vertices + 0.05 * rng.normal(size=vertices.shape)
    weight = jnp.asarray(rng.uniform(size=len(vertices) + 2))
    points, faces, alive = padded(noisy, faces)

    @jax.jit
    def mean(points):
        return mean_and_spread(*mean_curvature(points, faces, alive), weight)

    assert np.isfinite(jax.jacrev(lambda p: jnp.stack(mean(p)))(points)).all()
    check_grads(mean, (points,), 1, ("rev",), atol=1e-6, rtol=1e-6, eps=1e-6)


def test_mean_and_spread_are_weighted_by_area():
    rng = np.random.default_rng(1)
    curvature, area, weight = rng.uniform(0.5, 2, size=(3, 30))
    mean, spread = mean_and_spread(
        *(jnp.asarray(x) for x in (curvature * area, area, weight))
    )
    wanted = np.average(curvature, weights=area * weight)
    np.testing.assert_allclose(mean, wanted, rtol=1e-13)
    square = np.average((curvature - wanted) ** 2, weights=area * weight)
    np.testing.assert_allclose(spread, np.sqrt(square), rtol=1e-13)


def test_mean_and_spread_of_nothing_are_zero_with_slope_zero():
    def both(integral, weight):
        return jnp.stack(mean_and_spread(integral, jnp.ones(4), weight))

    where = jnp.ones(4), jnp.zeros(4)
    assert not both(*where).any()
    assert all(np.isfinite(s).all() for s in jax.jacrev(both, (0, 1))(*where))
