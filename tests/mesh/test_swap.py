"""Edge swaps."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxgrow.mesh.quality import radius_ratio
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.swap import swap
from jaxgrow.mesh.topology import build_topology, euler_number, is_manifold


# A rhombus split along its long diagonal, which the short one would split better.
RHOMBUS = ([-1.0, 0, 0], [1, 0, 0], [0, 0.6, 0], [0, -0.6, 0])


def _has_edge(surface, a, b):
    topology = build_topology(surface.faces, len(surface.vertices))
    return bool(topology.has_edge(np.array([a]), np.array([b]))[0])


def _bent(height):
    return [np.add(p, [0, 0, height * (k > 1)]) for k, p in enumerate(RHOMBUS)]


def _normal(a, b, c):
    normal = np.cross(b - a, c - a)
    return normal / np.linalg.norm(normal)


def test_a_long_diagonal_is_flipped(diamond, nobody):
    after, done = swap(diamond(*RHOMBUS), nobody)
    assert done.counts["swapped"] == 1
    assert _has_edge(after, 2, 3)
    assert not _has_edge(after, 0, 1)
    assert is_manifold(after.faces, 8)


def test_a_flip_keeps_the_normals(diamond, nobody):
    before = diamond(*RHOMBUS)
    after, _ = swap(before, nobody)
    for surface in (before, after):
        a, b, c = surface.vertices[surface.faces].transpose(1, 0, 2)
        assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_equal_diagonals_are_left_alone(grid, nobody):
    after, done = swap(grid(4), nobody)
    assert done.counts["swapped"] == 0
    assert np.array_equal(after.faces, grid(4).faces)


def test_an_edge_that_exists_already_is_not_made_again(nobody):
    # A tetrahedron: its other diagonal is the opposite edge.
    vertices = np.array([[-3.0, 0, 0], [3, 0, 0], [0, 0.5, 0], [0, -0.5, 0.2]])
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 2, 3], [1, 3, 2]])
    after, done = swap(Surface(vertices, faces, np.zeros(4, dtype=bool)), nobody)
    assert done.counts["swap_refused_edge_exists"] > 0
    assert np.array_equal(after.faces, faces)


def test_no_vertex_is_left_with_two_edges(nobody):
    # The two triangles alone: both ends of the diagonal have three edges.
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    before = Surface(np.array(RHOMBUS), faces, np.ones(4, dtype=bool))
    after, done = swap(before, nobody)
    assert done.counts["swap_refused_valence"] == 1
    assert np.array_equal(after.faces, faces)


@pytest.mark.parametrize("height, flipped", [(0.2, 1), (0.45, 0), (1.0, 0)])
def test_a_sharp_fold_is_not_flattened_by_a_flip(diamond, nobody, height, flipped):
    _, done = swap(diamond(*_bent(height)), nobody)
    assert done.counts["swapped"] == flipped
    assert done.counts["swap_refused_shape"] == 1 - flipped


def test_a_flat_cap_is_flipped_whatever_its_normal_says(diamond, nobody):
    # The cap's tip is 0.02 off the edge and out of the plane: its normal is upright.
    before = diamond([-1, 0, 0], [1, 0, 0], [0, 0.002, 0.02], [0, -0.9, 0])
    assert radius_ratio(before.vertices[before.faces[:1]])[0] < 0.01
    after, _ = swap(before, nobody)
    assert _has_edge(after, 2, 3)


def test_new_triangles_never_turn_over(nobody):
    # The four-sided patch is not convex at b: one new triangle would lie face down,
    # though the sum of the ratios, which have no sign, would grow. The other two
    # triangles at b lie face down already, so no crease with them is a new one.
    vertices = np.array(
        [[-1.0, 0], [1, 0], [1.2, 0.5], [1.2, -0.5], [0, 2], [0, -2]], dtype=float
    )
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 2, 4], [3, 0, 5]])
    vertices = np.concatenate([vertices, [[0.0, 0.1], [0.0, -0.1]]])
    faces = np.concatenate([faces, [[2, 1, 6], [1, 3, 7]]])
    flat = np.concatenate([vertices, np.zeros((8, 1))], axis=1)
    before = Surface(flat, faces, np.ones(8, dtype=bool))
    ratio = radius_ratio(flat[np.array([[0, 1, 2], [1, 0, 3], [0, 3, 2], [3, 1, 2]])])
    assert ratio[2:].sum() > ratio[:2].sum()
    after, done = swap(before, nobody, max_rounds=1)
    assert _has_edge(after, 0, 1)
    assert done.counts["swap_refused_shape"] > 0


def test_a_flip_does_not_make_a_sharp_crease_with_a_neighbour(diamond, nobody):
    # The outer triangle at a-d is turned about that edge until it makes less than 90
    # degrees with the old triangle, and would make more with the new one.
    before = diamond(*_bent(0.2))
    a, b, c, d = before.vertices[:4]
    old, new = _normal(b, a, d), _normal(a, d, c)
    along = (d - a) / np.linalg.norm(d - a)
    for angle in np.linspace(0, 2 * np.pi, 73):
        beyond = np.cos(angle) * old + np.sin(angle) * np.cross(along, old)
        if beyond @ old > 0.03 and beyond @ new < -0.03:
            break
    else:
        pytest.fail("there is no such direction")
    vertices = before.vertices.copy()
    vertices[4] = (a + d) / 2 + np.cross(along, beyond)
    assert np.allclose(_normal(d, a, vertices[4]), beyond)
    creased = Surface(vertices, before.faces, before.fixed)
    assert swap(before, nobody)[1].counts["swapped"] == 1
    refused = swap(creased, nobody)[1].counts
    assert (refused["swapped"], refused["swap_refused_shape"]) == (0, 1)


def test_a_particle_between_the_diagonals_refuses_the_flip(diamond):
    before = diamond(*_bent(0.2))
    for height, flipped in ((0.1, 0), (-3.0, 1)):
        _, done = swap(before, np.array([[0.0, 0, height]]))
        assert done.counts["swapped"] == flipped
        assert done.counts["swap_refused_particle"] == 1 - flipped


def test_the_clearance_refuses_the_flip(diamond):
    before = diamond(*_bent(0.2))
    above = np.array([[0.0, 0, 0.3]])
    assert swap(before, above, clearance=0.05)[1].counts["swapped"] == 1
    assert swap(before, above, clearance=0.15)[1].counts["swapped"] == 0


def test_the_number_of_rounds_is_bounded(grid, nobody):
    noisy = grid(8, 1.0, np.random.default_rng(1), 0.2)
    one = swap(noisy, nobody, max_rounds=1)[1].counts["swapped"]
    all_ = swap(noisy, nobody)[1].counts["swapped"]
    assert 0 < one < all_


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), rounds=st.integers(1, 6))
def test_the_sum_of_radius_ratios_never_falls(grid, nobody, seed, rounds):
    before = grid(6, 1.0, np.random.default_rng(seed), 0.25)
    total = radius_ratio(before.vertices[before.faces]).sum()
    for _ in range(rounds):
        after, done = swap(before, nobody, max_rounds=1)
        new = radius_ratio(after.vertices[after.faces]).sum()
        assert new > total if done.counts["swapped"] else new == total
        before, total = after, new


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_swaps_keep_vertices_rim_and_topology(grid, nobody, seed):
    before = grid(6, 1.0, np.random.default_rng(seed), 0.25)
    after, done = swap(before, nobody)
    rims = []
    for surface in (before, after):
        topology = build_topology(surface.faces, len(surface.vertices))
        rims.append(topology.edges[~topology.interior])
    assert np.array_equal(*rims)
    assert after.vertices is before.vertices
    assert done.parents == ()
    assert is_manifold(after.faces, len(after.vertices))
    assert euler_number(after.faces) == 1


def test_edge_that_a_wall_has_is_not_made_again():
    # two triangles whose common edge wants to be flipped, all their vertices fixed
    vertices = np.array([[0.0, 0, 0], [4, 0, 0], [2, 1, 0], [2, -1, 0]])
    surface = Surface(vertices, np.array([[0, 1, 2], [1, 0, 3]]), np.ones(4, bool))
    apex = np.array([2.0, 0.0, 3.0])
    beside = np.stack([vertices[3], vertices[2], apex])[None]
    other = np.stack([vertices[2], vertices[3], apex])[None]
    # two more triangles around each end give the edge's ends the valence they need
    ring = np.array([[-2.0, 1, 0], [-2, -1, 0], [6, 1, 0], [6, -1, 0]])
    vertices = np.concatenate([vertices, ring])
    more = np.array([[0, 2, 4], [0, 4, 5], [0, 5, 3], [1, 7, 6], [1, 6, 2], [1, 3, 7]])
    surface = Surface(vertices, np.concatenate([surface.faces, more]), np.ones(8, bool))
    free, done = swap(surface, np.zeros((0, 3)))
    assert done.counts["swapped"] == 1
    assert _has_edge(free, 2, 3)
    for walls in (beside, other):
        kept, done = swap(surface, np.zeros((0, 3)), walls=walls)
        assert done.counts["swap_refused_edge_exists"] == 1
        assert not _has_edge(kept, 2, 3)
    # a wall that is elsewhere does not matter
    _, done = swap(surface, np.zeros((0, 3)), walls=beside + 50.0)
    assert done.counts["swapped"] == 1
