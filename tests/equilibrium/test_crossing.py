"""Nothing crosses the membrane, at any step of a relaxation from a hard start."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.descent import descend
from jaxgrow.equilibrium.fire import FIRE
from jaxgrow.equilibrium.lbfgs import LBFGS
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.runtime.results import Result


compiled = eqx.filter_jit(descend)
PARAMETERS = Parameters()


def below(points, vertices, faces):
    """Whether points are on the tissue's side, by the solid angle of a closed cone.

    The patch is closed by triangles from its rim to an apex far below; the solid angle
    of van Oosterom and Strackee is 4π inside and 0 outside. No distance is involved.
    """
    halves = {tuple(h) for f in faces for h in (f[[0, 1]], f[[1, 2]], f[[2, 0]])}
    rim = np.array([h for h in halves if h[::-1] not in halves])
    apex = len(vertices)
    vertices = np.concatenate([vertices, [[0.0, 0.0, -50.0]]])
    closing = np.column_stack([rim[:, 1], rim[:, 0], np.full(len(rim), apex)])
    corners = vertices[np.concatenate([faces, closing])]
    a, b, c = np.moveaxis(corners[None] - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(x, axis=-1) for x in (a, b, c))
    top = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
    ab, bc, ca = (np.sum(x * y, -1) for x, y in ((a, b), (b, c), (c, a)))
    bottom = la * lb * lc + ab * lc + bc * la + ca * lb
    return 2 * np.arctan2(top, bottom).sum(axis=1) > 2 * np.pi


def heap(seed=0, depth=0.05):
    """30 particles at nearly one point close under the middle of the membrane."""
    rng = np.random.default_rng(seed)
    heap = 1e-3 * rng.normal(size=(30, 3)) + np.array([0.1, 0.2, -depth])
    floor = rng.uniform([-2.2, -2.2, -2.0], [2.2, 2.2, -0.8], (20, 3))
    return np.concatenate([heap, floor])


def daughter(seed=1, depth=1e-6):
    """One particle a millionth under the source vertex, above tissue at rest."""
    rng = np.random.default_rng(seed)
    floor = rng.uniform([-2.2, -2.2, -2.0], [2.2, 2.2, -0.5], (49, 3))
    return np.concatenate([[[0.0, 0.0, -depth]], floor])


STARTS = {"heap": heap, "daughter": daughter}


def states(make_particles, make_membrane, start, minimiser, steps):
    """The states after the given numbers of steps of one relaxation."""
    position = STARTS[start]()
    particles = make_particles(position, position[:, 2] < -1.6)
    membrane = make_membrane()
    problem = Problem(particles, membrane, PARAMETERS)
    lists = allocate_lists(problem)
    live = np.asarray(membrane.vertex_alive)
    faces = np.asarray(membrane.faces)[np.asarray(membrane.face_alive)]
    assert below(position, np.asarray(membrane.vertices)[live], faces).all()
    for count in steps:
        outcome = compiled(
            problem,
            lists,
            minimiser,
            jnp.asarray(1e-6),
            jnp.asarray(count),
            jnp.asarray(0.1),
        )
        nodes = outcome.nodes
        yield (
            np.asarray(nodes.particles)[: len(position)],
            np.asarray(nodes.vertices)[live],
            faces,
            outcome,
        )


@pytest.mark.parametrize("start", list(STARTS))
@pytest.mark.parametrize("minimiser", [LBFGS(), FIRE()], ids=["lbfgs", "fire"])
def test_no_particle_crosses_the_membrane_at_any_step(
    make_particles, make_membrane, start, minimiser
):
    steps = [*range(1, 41), 60, 100, 200, 400]
    moved = 0.0
    first = STARTS[start]()
    for position, vertices, faces, outcome in states(
        make_particles, make_membrane, start, minimiser, steps
    ):
        assert Result.of(outcome.code) in (Result.STEP_LIMIT, Result.CONVERGED)
        assert below(position, vertices, faces).all()
        moved = max(moved, np.abs(position - first).max())
    assert moved > 0.3  # it was pushed away in earnest


@pytest.mark.parametrize("start", list(STARTS))
def test_no_node_moves_by_half_of_its_distance_to_what_it_must_not_cross(
    make_particles, make_membrane, start
):
    from jaxgrow.mesh.proximity import closest_on_triangles

    before = None
    for position, vertices, faces, _ in states(
        make_particles, make_membrane, start, LBFGS(), range(1, 16)
    ):
        if before is not None:
            old, corners = before[0], before[1][faces]
            pairs = (len(old), len(faces))
            table, _ = closest_on_triangles(
                np.repeat(old, len(faces), axis=0), np.tile(corners, (len(old), 1, 1))
            )
            table = table.reshape(pairs)
            clearance = np.full(len(vertices), np.inf)
            np.minimum.at(clearance, faces.ravel(), np.repeat(table.min(axis=0), 3))
            step = np.linalg.norm(position - old, axis=1)
            assert np.all(step <= 0.4 * table.min(axis=1) * (1 + 1e-9) + 1e-15)
            step = np.linalg.norm(vertices - before[1], axis=1)
            assert np.all(step <= 0.4 * clearance * (1 + 1e-9) + 1e-15)
            assert step.max() <= 0.1 * (1 + 1e-9)
        before = position, vertices


def test_sign_test_sees_both_sides(make_membrane):
    membrane = make_membrane(height=lambda x, _: 0.5 * np.cos(x) * (abs(x) < 2.9))
    live = np.asarray(membrane.vertex_alive)
    faces = np.asarray(membrane.faces)[np.asarray(membrane.face_alive)]
    points = np.array([[0.1, 0.1, 0.3], [0.1, 0.1, 0.6], [2, 1, -0.5], [2, 1, 0.5]])
    found = below(points, np.asarray(membrane.vertices)[live], faces)
    assert found.tolist() == [True, False, True, False]
