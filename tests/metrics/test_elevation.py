"""Heights above the former surface against the host's, and what counts as raised."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from jax.test_util import check_grads

from jaxgrow.lesions import size as lesion
from jaxgrow.metrics.elevation import height_above, raisedness, smoothstep
from jaxgrow.state import FormerSurface


@pytest.fixture(scope="module")
def bowl():
    """A cap of a sphere seen from within, like the wall of a cavity."""
    ball = trimesh.creation.icosphere(3, radius=6.0)
    low = ball.triangles_center[:, 2] < -2
    cap = trimesh.Trimesh(ball.vertices, ball.faces[low][:, ::-1])
    return FormerSurface(jnp.asarray(cap.vertices), jnp.asarray(cap.faces))


POINTS = np.random.default_rng(0).normal(size=(200, 3)) * 1.5 - [0, 0, 4.5]


def test_height_is_that_of_the_search_on_the_host(bowl):
    wanted = lesion.height_above(
        POINTS, np.asarray(bowl.vertices), np.asarray(bowl.faces)
    )
    found = jax.jit(height_above)(jnp.asarray(POINTS), bowl)
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    assert (wanted > 0).sum() > 20
    assert (wanted < 0).sum() > 20


def test_slopes_of_heights_are_those_of_differences(bowl):
    def heights(points, vertices):
        return height_above(points, FormerSurface(vertices, bowl.faces))

    where = jnp.asarray(POINTS), bowl.vertices
    check_grads(jax.jit(heights), where, 1, ("rev",), atol=1e-6, rtol=1e-6, eps=1e-7)


def test_height_above_a_plane_has_the_sign_of_the_side():
    corners = jnp.asarray([[-9.0, -9, 0], [9, -9, 0], [0, 9, 0]])
    former = FormerSurface(corners, jnp.asarray([[0, 1, 2]]))
    points = jnp.asarray([[0.3, 0.2, 1.5], [1, 1, -0.7], [0.1, 0, 0]])
    found = jax.jit(height_above)(points, former)
    np.testing.assert_allclose(found, [1.5, -0.7, 0], atol=1e-14)


def test_slope_of_a_height_is_one_on_the_surface_itself():
    corners = jnp.asarray([[-9.0, -9, 0], [9, -9, 0], [0, 9, 0]])
    former = FormerSurface(corners, jnp.asarray([[0, 1, 2]]))
    slope = jax.jit(jax.jacrev(lambda p: height_above(p, former)))(jnp.zeros((1, 3)))
    np.testing.assert_allclose(slope[0, 0], [0, 0, 1], atol=1e-15)


def test_triangles_without_area_do_not_hide_the_nearest():
    corners = jnp.asarray([[-9.0, -9, 0], [9, -9, 0], [0, 9, 0], [0, 0, -3]])
    former = FormerSurface(corners, jnp.asarray([[3, 3, 3], [3, 0, 3], [0, 1, 2]]))
    found = height_above(jnp.asarray([[0.0, 0, 1]]), former)
    np.testing.assert_allclose(found, [1.0])


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.9, 1.0])
def test_smoothstep_is_the_part_of_a_ball_below_a_plane(share):
    segment = np.pi * share**2 * (3 * 0.5 - share) / 3
    np.testing.assert_allclose(
        smoothstep(jnp.asarray(share)), segment / (np.pi / 6), atol=1e-15
    )


def test_raised_is_nothing_to_all_between_a_quarter_and_half_an_r0():
    above = jnp.asarray([-1, 0.25, 0.375, 0.5, 3])
    np.testing.assert_allclose(raisedness(above), [0, 0, 0.5, 1, 1])
