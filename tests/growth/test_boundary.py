"""The border of a patch: what it feels, and where."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.equilibrium.relax import Relaxation
from jaxgrow.growth.boundary import (
    boundary_reaction,
    BoundaryReaction,
    check_reaction,
    CONTACT_DISTANCE,
    EscapedParticles,
    find_escaped,
    FORCE_CHANGE_LIMIT,
    SHARE,
)
from jaxgrow.mesh.collision_mesh import Walls
from jaxgrow.mesh.surface import Surface
from jaxgrow.runtime.results import Result
from jaxgrow.state import Nodes, Species
from jaxgrow.transfer.device import put_particles


PLACES = np.array([[5.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, -3.0]])


def border(force=None):
    """Two vertices of the rim and a held particle, with the force on that."""
    force = np.zeros(3) if force is None else np.asarray(force, float)
    return BoundaryReaction(PLACES[:2], PLACES[2:], force[None])


NOBODY = EscapedParticles(np.zeros((0, 3)))


def felt(now, before, particles, beside=NOBODY):
    return check_reaction(now, before, particles, beside)


def tumour_at(*points):
    points = np.reshape(np.asarray(points, float), (-1, 3))
    tissue = np.array([[0.0, 5.1, 0.0]])
    species = np.array([int(Species.TUMOUR)] * len(points) + [int(Species.TISSUE)])
    position = np.concatenate([points, tissue])
    return put_particles(position, species, np.zeros(len(position), bool), 8)


def test_border_that_nothing_touches_feels_nothing():
    found = felt(border(), border(), tumour_at([0.0, 0.0, 0.0]))
    assert found.place is None
    assert found.force == 0
    assert found.distance == pytest.approx(3.0)


def test_healthy_tissue_does_not_count():
    found = felt(border(), border(), tumour_at())
    assert found.place is None
    assert found.distance == np.inf


def test_tumour_that_presses_on_the_border_is_felt_where_it_does():
    point = PLACES[1] + [0.0, -0.99 * CONTACT_DISTANCE, 0.0]
    found = felt(border(), border(), tumour_at(point))
    np.testing.assert_array_equal(found.place, PLACES[1])
    point = PLACES[1] + [0.0, -1.01 * CONTACT_DISTANCE, 0.0]
    assert felt(border(), border(), tumour_at(point)).place is None


@pytest.mark.parametrize("factor, feels", [(0.99, False), (1.01, True)])
@pytest.mark.parametrize("before", [0.1, 4.0])
def test_force_on_held_tissue_is_felt_above_a_bound(factor, feels, before):
    start = np.array([0, 0, before])
    now = start + np.array([factor * max(FORCE_CHANGE_LIMIT, SHARE * before), 0, 0])
    found = felt(border(now), border(start), tumour_at([0.0, 0.0, 0.0]))
    assert found.force == pytest.approx(now[0])
    assert (found.place is not None) == feels
    if feels:
        np.testing.assert_array_equal(found.place, PLACES[2])


def test_pull_of_the_springs_on_the_rim_does_not_count(tiny_polyp):
    state = tiny_polyp.state
    force = jnp.where(state.membrane.pinned[:, None], 9.0, 0.0)
    force = force * jnp.ones_like(state.membrane.vertices)
    nothing = jnp.zeros_like(state.particles.position)

    def after(on_vertices):
        forces = Nodes(nothing, on_vertices)
        both = (state.particles, state.membrane)
        return boundary_reaction(Relaxation(both, Result.CONVERGED, None, None, forces))

    now, before = after(force), after(jnp.zeros_like(force))
    assert len(now.rim) == int(state.membrane.pinned.sum()) > 0
    assert len(now.held) == int(state.particles.held.sum()) > 0
    found = felt(now, before, tumour_at([0.0, 0.0, 0.0]))
    assert found.force == 0


def patch_with_a_wall():
    """A square of membrane beside a square of wall, in one plane, lumen above."""
    square = np.array([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    surface = Surface(square, faces, np.ones(4, bool))
    return surface, Walls(square + np.array([4.0, 0, 0]), faces, np.arange(4))


@pytest.mark.parametrize(
    "point, beside, crossed",
    [
        ([2.0, 2.0, -0.3], 0, 0),  # under the membrane
        ([5.0, 2.0, -0.3], 1, 0),  # under the wall
        ([5.0, 2.0, 0.3], 1, 1),  # through the wall
        ([5.0, 2.0, -0.9], 0, 0),  # deep under it
        ([3.5, 2.0, -0.6], 0, 0),  # nearer to the membrane
    ],
)
def test_particles_that_leave_the_patch_are_noticed(point, beside, crossed):
    found = find_escaped(tumour_at(point), *patch_with_a_wall(), 0.7)
    assert len(found.position) == beside
    assert found.crossed == crossed
    feels = felt(border(), border(), tumour_at([0.0, 0.0, 0.0]), found)
    assert feels.crossed == crossed
    assert (feels.place is not None) == bool(beside)


def test_lesion_against_the_opposite_wall_has_not_left_its_patch():
    surface, _ = patch_with_a_wall()
    below = np.array([[0.0, 0, 0.2], [4, 0, 0.2], [4, 4, 0.2], [0, 4, 0.2]])
    opposite = Walls(below, np.array([[0, 2, 1], [0, 3, 2]]), np.arange(4))
    found = find_escaped(tumour_at([2.0, 2.0, -0.3]), surface, opposite, 0.7)
    assert len(found.position) == 0


def test_padding_is_not_felt():
    particles = tumour_at([0.0, 0.0, 0.0])
    assert not bool(jnp.all(particles.alive))
    assert felt(border(), border(), particles).distance == pytest.approx(3.0)
