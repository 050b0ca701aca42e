"""Adaptive subdivision."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxgrow.mesh.fairing import refine
from jaxgrow.mesh.quality import areas, radius_ratio, side_lengths, SLIVER
from jaxgrow.mesh.subdivide import subdivide, subdivide_all
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.topology import build_topology, euler_number, is_manifold


def _shapes(done):
    return [done.counts[name] for name in ("quaternary", "a_shape", "t_shape")]


def _star(n_large, large=3.0, small=0.5):
    """A unit triangle whose first n neighbours are large, the others small."""
    angle = 2 * np.pi * np.arange(3) / 3
    corner = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1) / np.sqrt(3)
    height = np.where(np.arange(3) < n_large, large, small)
    middle = (corner + np.roll(corner, -1, axis=0)) / 2
    out = middle / np.linalg.norm(middle, axis=1)[:, None]
    vertices = np.concatenate([corner, middle + height[:, None] * out])
    faces = np.array([[0, 1, 2], [1, 0, 3], [2, 1, 4], [0, 2, 5]])
    return Surface(vertices, faces, np.zeros(6, dtype=bool))


@pytest.mark.parametrize(
    "n_large, shapes",
    [(0, [0, 0, 0]), (1, [0, 0, 2]), (2, [0, 1, 2]), (3, [1, 0, 3])],
)
def test_a_neighbour_is_closed_by_the_number_of_its_subdivided_neighbours(
    n_large, shapes
):
    # The large ones have two rim edges, so they themselves get T-shapes.
    _, done = subdivide(_star(n_large), 1.0)
    assert _shapes(done) == shapes


def test_a_large_triangle_is_quartered_and_its_neighbours_are_split_in_t_shape():
    surface, done = subdivide(_star(0), 0.4)
    assert _shapes(done) == [1, 0, 3]
    assert len(surface.faces) == 4 + 3 * 2
    assert (
        np.isclose(areas(surface.vertices[surface.faces]), np.sqrt(3) / 16).sum() == 4
    )


def test_rim_edges_are_never_split(grid):
    before = grid(3, 2.0)
    after, _ = subdivide_all(before, 0.3)
    rim = []
    for surface in (before, after):
        topology = build_topology(surface.faces, len(surface.vertices))
        rim.append(topology.edges[~topology.interior])
    assert np.array_equal(*rim)


def test_a_triangle_that_is_all_rim_is_left_alone():
    surface = Surface(
        np.array([[0.0, 0, 0], [9, 0, 0], [0, 9, 0]]),
        np.array([[0, 1, 2]]),
        np.zeros(3, dtype=bool),
    )
    after, done = subdivide_all(surface, 1.0)
    assert len(after.faces) == 1
    assert _shapes(done) == [0, 0, 0]


def test_a_surface_within_the_bounds_is_returned_itself(grid):
    surface = grid(3)
    after, done = subdivide(surface, 0.7, 2.0)
    assert after is surface
    assert done.parents == ()


def test_old_vertices_come_first_and_keep_every_bit(grid):
    before = grid(6, 1.5, np.random.default_rng(0), 0.2)
    after, done = subdivide(before, 0.7)
    n_old = len(before.vertices)
    assert np.array_equal(after.vertices[:n_old], before.vertices)
    assert np.array_equal(done.origin()[:n_old], np.arange(n_old))
    assert (done.origin()[n_old:] == -1).all()
    assert not after.fixed[n_old:].any()
    assert after.source == before.source


def test_the_diagonal_of_an_a_shape_is_the_better_one():
    surface, done = subdivide(_star(2), 1.0)
    assert done.counts["a_shape"] == 1
    # The quad under the tip is an isosceles trapezium with sides 1, 1/2, 1/2, 1/2 here,
    # where both diagonals are equal; sheared, one is better.
    vertices = _star(2).vertices.copy()
    vertices[1] += [0.0, 0.8, 0.0]
    surface, done = subdivide(Surface(vertices, _star(2).faces, _star(2).fixed), 1.0)
    assert done.counts["a_shape"] == 1
    middle = {tuple(p): 6 + k for k, p in enumerate(done.parents[0][6:].tolist())}
    quad = [2, 0, middle[(0, 1)], middle[(1, 2)]]
    pairs = [
        ([quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]),
        ([quad[1], quad[2], quad[3]], [quad[0], quad[1], quad[3]]),
    ]
    sums = [radius_ratio(surface.vertices[np.array(p)]).sum() for p in pairs]
    have = {frozenset(face) for face in surface.faces.tolist()}
    best = pairs[int(np.argmax(sums))]
    assert abs(sums[0] - sums[1]) > 0.05
    assert all(frozenset(face) in have for face in best)


def test_an_edge_over_the_length_bound_is_split_on_both_sides(diamond):
    thin = diamond([-3, 0, 0], [3, 0, 0], [0, 0.3, 0], [0, -0.3, 0], reach=1.0)
    after, done = subdivide(thin, 100.0, 4.0)
    assert _shapes(done) == [0, 0, 2]
    assert after.vertices[-1].tolist() == [0.0, 0.0, 0.0]


def test_a_long_edge_beside_a_longer_rim_edge_is_not_split():
    vertices = np.array([[0.0, 0, 0], [10, 0, 0], [9, 0.5, 0], [5, 6, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 3]])
    before = Surface(vertices, faces, np.zeros(4, dtype=bool))
    assert side_lengths(vertices[faces])[0, 2] > 4.0
    after, _ = subdivide_all(before, 100.0, 4.0)
    assert after is before


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), bound=st.floats(0.4, 2.0))
def test_after_subdivision_every_area_is_within_the_bound(grid, seed, bound):
    before = grid(5, 1.3, np.random.default_rng(seed), 0.3)
    after, done = subdivide_all(before, bound)
    assert areas(after.vertices[after.faces]).max() <= bound
    assert np.array_equal(done.apply(before.vertices), after.vertices)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), bound=st.floats(0.002, 0.1))
def test_beside_long_rim_edges_triangles_are_graded_and_not_thin(grid, seed, bound):
    before = grid(5, 1.3, np.random.default_rng(seed), 0.1)
    after, _ = refine(before, bound)
    triangles = after.vertices[after.faces]
    assert radius_ratio(triangles).min() >= 0.1
    middle = before.vertices.mean(axis=0)
    distance = np.linalg.norm((triangles.mean(axis=1) - middle)[:, :2], axis=1)
    assert areas(triangles)[distance < 1.0].max() <= bound
    largest = areas(triangles)[distance > 2.0].max()
    assert bound < largest < 1.3**2 / 2


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), bound=st.floats(0.01, 0.5))
def test_subdivision_never_opens_a_crack_and_keeps_the_shape(sphere, seed, bound):
    rng = np.random.default_rng(seed)
    before = sphere(1)
    vertices = before.vertices * rng.uniform(0.5, 2.0, (42, 1))
    before = Surface(vertices, before.faces, before.fixed)
    after, _ = subdivide(before, bound, 1.0)
    assert build_topology(after.faces, len(after.vertices)).interior.all()
    assert is_manifold(after.faces, len(after.vertices))
    assert euler_number(after.faces) == 2
    total = [areas(s.vertices[s.faces]).sum() for s in (before, after)]
    assert total[0] == pytest.approx(total[1], rel=1e-12)


def test_refinement_brings_a_coarse_patch_to_the_bound(grid):
    coarse = grid(3, 6.0)
    fine, done = refine(coarse, 0.7)
    triangles = fine.vertices[fine.faces]
    off = np.abs(triangles.mean(axis=1)[:, :2] - 9.0).max(axis=1)
    assert areas(triangles)[off < 5.0].max() <= 0.7
    assert radius_ratio(triangles).min() >= SLIVER
    assert euler_number(fine.faces) == 1
    assert np.array_equal(done.apply(coarse.vertices), fine.vertices)
    kept = done.origin()[fine.fixed]
    assert np.array_equal(kept, np.flatnonzero(coarse.fixed))


def test_refinement_ends_beside_a_very_long_rim_edge():
    vertices = np.array([[0.0, 0, 0], [200, 0, 0], [100, 3, 0], [100, -3, 0]])
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    before = radius_ratio(vertices[faces]).min()
    fine, _ = refine(Surface(vertices, faces, np.ones(4, dtype=bool)), 0.7)
    assert radius_ratio(fine.vertices[fine.faces]).min() >= before * (1 - 1e-9)


def test_refinement_refuses_a_bound_that_is_not_positive(grid):
    with pytest.raises(ValueError, match="must be positive"):
        refine(grid(2), 0.0)


def test_subdivision_halves_the_longest_side_of_a_long_triangle(grid):
    stretched = grid(4)
    vertices = stretched.vertices * np.array([4.0, 0.3, 1.0])
    surface = Surface(vertices, stretched.faces, stretched.fixed)
    after, _ = subdivide_all(surface, 0.7, 1.9)
    inner = ~surface.fixed[surface.faces].any(axis=1)
    assert side_lengths(vertices[surface.faces[inner]]).max() > 4.0
    free = ~after.fixed[after.faces].any(axis=1)
    assert side_lengths(after.vertices[after.faces[free]]).max() <= 2.1
