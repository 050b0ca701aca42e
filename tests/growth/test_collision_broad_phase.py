"""Sheets that are pressed against each other come to rest apart, and never cross."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.collision import collision_energy
from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.descent import descend
from jaxgrow.equilibrium.fire import FIRE
from jaxgrow.equilibrium.lbfgs import LBFGS
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.relax import relax
from jaxgrow.growth.collision_broad_phase import CAUTION, CollisionFinder
from jaxgrow.mesh.collision_mesh import Walls
from jaxgrow.mesh.intersection import intersecting_pairs
from jaxgrow.mesh.surface import Surface
from jaxgrow.runtime.results import Result
from jaxgrow.transfer.device import get, get_surface, put_membrane

from ..quick_jit import quick_jit


energy_of = quick_jit(collision_energy)
distances = quick_jit(lambda listed, membrane: listed.distances(membrane))
PARAMETERS = Parameters(spring_stiffness=0.3)
TOLERANCE = 1e-4


def sheet(gap, seed=0):
    """A folded strip: the lower half pinned, the upper one held at two rows."""
    x, y = np.meshgrid(np.arange(12.0), np.arange(4.0), indexing="ij")
    index = np.arange(48).reshape(12, 4)
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    over = x > 5.5
    place = np.where(over, 11.0 - x + 0.35, x)
    vertices = np.stack([place, y, np.where(over, gap, 0.0)], axis=-1).reshape(-1, 3)
    free = ((x > 6.5) & (x < 10.5)).ravel()
    vertices[free] += 0.02 * np.random.default_rng(seed).normal(size=(free.sum(), 3))
    return Surface(vertices, faces, ~free)


def names(surface):
    return np.full(len(surface.vertices), -1)


def finder(surface, walls=None, parameters=PARAMETERS):
    return CollisionFinder.of(put_membrane(surface), names(surface), walls, parameters)


def press(membrane, force):
    """A load that drives all free vertices down, through what lies below."""
    load = jnp.where(membrane.free[:, None], jnp.array([0.0, 0.0, -force]), 0.0)
    return load.astype(membrane.vertices.dtype)


def crossings(membrane, vertices=None):
    surface = get_surface(membrane)
    if vertices is not None:
        vertices = get(vertices)[: len(surface.vertices)]
        surface = Surface(vertices, surface.faces, surface.fixed)
    return sum(len(p) for p in intersecting_pairs(surface.vertices, surface.faces))


def pressed(collide):
    surface = sheet(0.8)
    membrane = put_membrane(surface)
    return relax(
        None,
        membrane,
        parameters=PARAMETERS,
        tolerance=TOLERANCE,
        load=press(membrane, 0.1),
        collide=finder(surface) if collide else None,
    )


@pytest.fixture(scope="module")
def rest():
    return pressed(collide=True)


def test_sheets_that_are_pressed_together_come_to_rest_apart(rest):
    assert rest.result is Result.CONVERGED
    assert crossings(rest.state[1]) == 0
    gap = finder(sheet(0.8)).gap(get(rest.state[1].vertices))
    assert 0.05 < gap < PARAMETERS.collision_range


def test_without_the_term_they_go_through_each_other():
    outcome = pressed(collide=False)
    assert crossings(outcome.state[1]) > 0


def test_rest_does_not_depend_on_where_the_lists_were_made(rest):
    again = relax(
        None,
        rest.state[1],
        parameters=PARAMETERS,
        tolerance=TOLERANCE,
        load=press(rest.state[1], 0.1),
        collide=finder(sheet(0.8)),
    )
    assert again.stats.steps == 0


@pytest.mark.parametrize("minimiser", [LBFGS(), FIRE()], ids=["lbfgs", "fire"])
@pytest.mark.parametrize("force", [0.1, 30.0])
def test_no_step_of_a_relaxation_lets_sheets_cross(minimiser, force):
    surface = sheet(0.8)
    membrane = put_membrane(surface)
    find = finder(surface)
    parameters = eqx.tree_at(lambda p: p.spring_stiffness, PARAMETERS, jnp.asarray(0.3))
    problem = Problem(None, membrane, parameters, press(membrane, force))
    lists, memory, moved = None, minimiser.init(jnp.zeros_like(membrane.vertices)), 0.0
    compiled = eqx.filter_jit(descend)
    for _ in range(120):
        if lists is None or bool(lists.stale):
            lists = Lists(None, None, collisions=find(problem.membrane.vertices, None))
        outcome = compiled(
            problem,
            lists,
            minimiser,
            jnp.asarray(1e-6),
            jnp.asarray(1),
            jnp.asarray(0.1),
            memory,
        )
        step = np.abs(outcome.nodes.vertices - problem.membrane.vertices).max()
        moved += float(step)
        problem, memory = problem.at(outcome.nodes), outcome.memory
        lists = outcome.lists
        assert crossings(problem.membrane) == 0
    assert moved > 0.5


def test_gap_is_infinite_exactly_if_the_energy_is_zero():
    for gap in (0.3, 0.8):
        surface = sheet(gap)
        membrane, find = put_membrane(surface), finder(surface)
        listed = find(membrane.vertices, None)
        energy = float(energy_of(membrane, listed, PARAMETERS))
        assert np.isfinite(find.gap(get(membrane.vertices))) == (energy > 0)


def test_neighbours_repel_from_half_of_their_distance_at_rest_on():
    large = sheet(2.0)
    surface = Surface(0.4 * large.vertices, large.faces, large.fixed)
    membrane, find = put_membrane(surface), finder(surface)
    listed = find(membrane.vertices, None)
    vertex, _ = distances(listed, membrane)
    local = np.asarray(~listed.apart & (listed.vertex_margin > 0))
    assert local.any()
    limit = CAUTION * np.asarray(vertex)[local] / PARAMETERS.collision_range
    np.testing.assert_allclose(
        np.asarray(listed.vertex_margin)[local],
        np.minimum(PARAMETERS.barrier_range, limit),
    )
    # and so a surface at rest feels nothing of them
    alone = eqx.tree_at(lambda c: c.apart, listed, jnp.zeros_like(listed.apart))
    assert energy_of(membrane, alone, PARAMETERS) == 0


def wall_below():
    """One large static triangle under the pinned half and beyond."""
    vertices = np.array([[-20.0, -20, -0.8], [40, -20, -0.8], [-20, 40, -0.8]])
    return Walls(vertices, np.array([[0, 1, 2]]), np.array([100, 101, 102]))


def test_static_walls_hold_the_surface_up():
    x, y = np.meshgrid(np.arange(6.0), np.arange(6.0), indexing="ij")
    flat = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    index = np.arange(36).reshape(6, 6)
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    fixed = np.zeros(36, bool)
    fixed[np.concatenate([index[0], index[-1], index[:, 0], index[:, -1]])] = True
    surface = Surface(flat, faces, fixed)
    membrane = put_membrane(surface)
    outcomes = [
        relax(
            None,
            membrane,
            parameters=PARAMETERS,
            tolerance=TOLERANCE,
            load=press(membrane, 0.3),
            collide=collide,
        )
        for collide in (None, finder(surface, wall_below()))
    ]
    heights = [get(o.state[1].vertices)[:36, 2].min() for o in outcomes]
    assert heights[0] < -1.0
    assert -0.8 < heights[1] < -0.3
    assert outcomes[1].result is Result.CONVERGED


def test_lists_keep_their_capacity():
    surface = sheet(0.8)
    find = finder(surface, wall_below())
    first = find(put_membrane(surface).vertices, None)
    second = find(put_membrane(surface).vertices, first)
    assert first.vertex.shape == second.vertex.shape
    assert first.still.shape == second.still.shape
    assert len(first.vertex) > int((first.vertex_margin > 0).sum())
