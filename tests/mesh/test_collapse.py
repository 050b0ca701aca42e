"""Edge collapse."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxgrow.mesh.collapse import collapse
from jaxgrow.mesh.quality import areas, radius_ratio, side_lengths
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.topology import build_topology, euler_number, is_manifold


def _pinched(grid, gap=0.2, n=6):
    """A grid in which two inner neighbours have moved close together."""
    surface = grid(n)
    i = (n // 2) * (n + 1) + n // 2
    vertices = surface.vertices.copy()
    middle = (vertices[i] + vertices[i + 1]) / 2
    vertices[i] = middle - np.array([gap / 2, 0, 0])
    vertices[i + 1] = middle + np.array([gap / 2, 0, 0])
    return Surface(vertices, surface.faces, surface.fixed), i, i + 1


def _with(surface, **change):
    names = ("vertices", "faces", "fixed", "source")
    return Surface(**{n: change.get(n, getattr(surface, n)) for n in names})


def test_the_short_edge_of_a_small_triangle_goes_to_its_middle(grid, nobody):
    before, i, j = _pinched(grid)
    after, done = collapse(before, nobody, min_area=0.15)
    assert done.counts["collapsed"] == 1
    assert len(after.vertices) == len(before.vertices) - 1
    assert len(after.faces) == len(before.faces) - 2
    middle = (before.vertices[i] + before.vertices[j]) / 2
    assert (after.vertices == middle).all(axis=1).sum() == 1
    assert areas(after.vertices[after.faces]).min() > 0.15


def test_nothing_small_means_nothing_done(grid, nobody):
    after, done = collapse(grid(4), nobody, min_area=0.1)
    assert np.array_equal(after.faces, grid(4).faces)
    assert done.counts == {"collapsed": 0}


def test_a_needle_is_collapsed_by_its_short_edge(grid, nobody):
    before, _, _ = _pinched(grid, 0.3)
    assert collapse(before, nobody, min_area=0.05)[1].counts["collapsed"] == 0
    _, done = collapse(before, nobody, min_area=0.05, min_edge=0.35)
    assert done.counts["collapsed"] == 1


@pytest.mark.parametrize("which", ["first", "second"])
@pytest.mark.parametrize("how", ["fixed", "source"])
def test_a_kept_end_survives_where_it_is(grid, nobody, how, which):
    before, i, j = _pinched(grid)
    end = i if which == "first" else j
    if how == "fixed":
        fixed = before.fixed.copy()
        fixed[end] = True
        before = _with(before, fixed=fixed)
    else:
        before = _with(before, source=end)
    after, done = collapse(before, nobody, min_area=0.15)
    new = int(np.flatnonzero(done.origin() == end)[0])
    assert done.counts["collapsed"] == 1
    assert np.array_equal(after.vertices[new], before.vertices[end])
    if how == "source":
        assert after.source == new
    else:
        assert after.fixed[new]


def test_an_edge_between_the_source_and_a_fixed_vertex_is_refused(grid, nobody):
    before, i, j = _pinched(grid)
    fixed = before.fixed.copy()
    fixed[i] = True
    _, done = collapse(
        _with(before, fixed=fixed, source=j), nobody, min_area=0.15, max_rounds=1
    )
    assert done.counts["collapsed"] == 0
    assert done.counts["collapse_refused_rim"] == 1


def test_rim_edges_are_refused(grid, nobody):
    flat = grid(4, 0.1)
    after, done = collapse(flat, nobody, min_area=1.0)
    rim = np.flatnonzero(done.origin() >= 0)
    assert done.counts["collapse_refused_rim"] > 0
    kept = done.origin()[rim]
    assert set(np.flatnonzero(flat.fixed)) <= set(kept.tolist())
    assert is_manifold(after.faces, len(after.vertices))


def test_rim_vertices_are_kept_even_if_not_marked_fixed(grid, nobody):
    flat = grid(4, 0.1)
    loose = _with(flat, fixed=np.zeros(25, dtype=bool), source=-1)
    _, done = collapse(loose, nobody, min_area=1.0)
    assert done.counts["collapsed"] > 0
    assert set(np.flatnonzero(flat.fixed)) <= set(done.origin().tolist())


def test_valences_of_three_refuse_the_collapse(sphere, nobody):
    # Each face of an icosahedron is cut into three: the new vertices have valence 3.
    base = sphere(0)
    middle = base.vertices[base.faces].mean(axis=1)
    new = 12 + np.arange(20)
    faces = np.concatenate(
        [
            np.stack([base.faces[:, k], base.faces[:, (k + 1) % 3], new], axis=1)
            for k in range(3)
        ]
    )
    surface = Surface(
        np.concatenate([base.vertices, middle]), faces, np.zeros(32, dtype=bool)
    )
    after, done = collapse(surface, nobody, min_area=10.0)
    assert done.counts["collapse_refused_valence"] > 0
    assert done.counts["collapsed"] == 0
    assert after is surface


def test_the_link_condition_refuses_to_pinch_a_tube(nobody):
    # A closed tube with a triangular cross-section: three rings of three vertices
    # would become an edge with two sheets. Ends are closed by apices.
    rings = 8
    angle = 2 * np.pi * np.arange(3) / 3
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * 0.2
    vertices = np.concatenate([ring + np.array([0, 0, z]) for z in range(rings)])
    faces = []
    for z in range(rings - 1):
        for k in range(3):
            a, b = 3 * z + k, 3 * z + (k + 1) % 3
            faces += [(a, b, b + 3), (a, b + 3, a + 3)]
    faces += [(2, 1, 0), (3 * rings - 3, 3 * rings - 2, 3 * rings - 1)]
    surface = Surface(vertices, np.array(faces), np.zeros(len(vertices), dtype=bool))
    after, done = collapse(surface, nobody, min_area=0.01, min_edge=0.5)
    assert done.counts["collapse_refused_link"] > 0
    assert is_manifold(after.faces, len(after.vertices))
    assert euler_number(after.faces) == 2


def test_a_triangle_that_would_turn_refuses_the_collapse(grid, nobody):
    before, i, j = _pinched(grid)
    vertices = before.vertices.copy()
    vertices[i, 2] += 1.5
    vertices[j, 2] += 1.5
    fixed = before.fixed.copy()
    fixed[i] = True
    vertices[i] += [0, 0, 0.6]
    steep = _with(before, vertices=vertices, fixed=fixed)
    _, done = collapse(steep, nobody, min_area=0.0, min_edge=0.8, max_angle=0.1)
    assert done.counts["collapsed"] == 0
    assert done.counts["collapse_refused_shape"] >= 1


def test_a_triangle_over_the_area_bound_refuses_the_collapse(grid, nobody):
    before, _, _ = _pinched(grid)
    for bound, collapsed in ((0.7, 0), (0.8, 1)):
        _, done = collapse(before, nobody, min_area=0.15, max_area=bound)
        assert done.counts["collapsed"] == collapsed
        assert done.counts.get("collapse_refused_shape", 0) == 1 - collapsed


def test_an_edge_over_the_length_bound_refuses_the_collapse(grid, nobody):
    before, _, _ = _pinched(grid)
    long_ = side_lengths(before.vertices[before.faces]).max()
    after, done = collapse(before, nobody, min_area=0.15, max_edge=0.5)
    assert done.counts["collapsed"] == 0 or (
        side_lengths(after.vertices[after.faces]).max() <= long_
    )


def test_a_particle_in_the_swept_volume_refuses_the_collapse(grid):
    before, i, j = _pinched(grid)
    vertices = before.vertices.copy()
    vertices[i, 2] = 0.3
    fixed = before.fixed.copy()
    fixed[j] = True
    bump = _with(before, vertices=vertices, fixed=fixed)
    under = np.array([vertices[i] - [0.05, 0, 0.15]])
    far = under - [0, 0, 3.0]
    run = partial(
        collapse, bump, min_area=0.0, min_edge=0.4, clearance=0.01, max_angle=1.5
    )
    assert run(far)[1].counts["collapsed"] == 1
    refused = run(under)[1].counts
    assert refused["collapsed"] == 0
    assert refused["collapse_refused_particle"] == 1


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_collapses_make_no_sliver_and_no_fold(grid, nobody, seed):
    rng = np.random.default_rng(seed)
    before = grid(8, 0.5, rng, 0.12)
    worst = radius_ratio(before.vertices[before.faces]).min()
    after, done = collapse(before, nobody, min_area=0.1, max_area=0.7)
    assert radius_ratio(after.vertices[after.faces]).min() >= min(0.3, worst)
    assert done.counts["collapsed"] > 0
    topology = build_topology(after.faces, len(after.vertices))
    assert topology.valence.min() >= 2
    assert is_manifold(after.faces, len(after.vertices))
    assert euler_number(after.faces) == 1
    assert np.array_equal(done.apply(before.vertices), after.vertices)
