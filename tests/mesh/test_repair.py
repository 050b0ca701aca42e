"""Repair of pleats and slivers."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxgrow.mesh import repair as module
from jaxgrow.mesh.fairing import fair
from jaxgrow.mesh.intersection import intersecting_pairs
from jaxgrow.mesh.intersection_guard import Crossing
from jaxgrow.mesh.quality import area_vectors, radius_ratio, unit
from jaxgrow.mesh.repair import repair
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.topology import build_topology, euler_number, is_manifold
from jaxgrow.mesh.winding import winding_number


def _with(surface, **change):
    names = ("vertices", "faces", "fixed", "source")
    return Surface(**{n: change.get(n, getattr(surface, n)) for n in names})


def _moved(surface, index, to, **change):
    vertices = surface.vertices.copy()
    vertices[index] = to
    return _with(surface, vertices=vertices, **change)


def _pleat(grid, n=6):
    """A grid with an inner vertex drawn over its neighbour's fan: it folds there."""
    surface = grid(n)
    i = (n // 2) * (n + 1) + n // 2
    vertices = surface.vertices
    return _moved(surface, i, vertices[i] + [1.4, 0.2, 0.2], source=-1), i


def _cone(grid, at, n=6):
    """A grid with a vertex of valence three in one of its triangles, at barycentric."""
    surface = grid(n)
    middle = surface.vertices.mean(axis=0)
    centre = surface.vertices[surface.faces].mean(axis=1)
    face = int(np.linalg.norm(centre - middle, axis=1).argmin())
    a, b, c = surface.faces[face]
    new = len(surface.vertices)
    vertices = np.concatenate(
        [surface.vertices, [np.array(at) @ surface.vertices[[a, b, c]]]]
    )
    faces = np.delete(surface.faces, face, axis=0)
    faces = np.concatenate([faces, [(a, b, new), (b, c, new), (c, a, new)]])
    return Surface(vertices, faces, np.append(surface.fixed, False)), new


def _creases(surface):
    topology = build_topology(surface.faces, len(surface.vertices))
    normal = unit(area_vectors(surface.vertices[surface.faces]))
    near, far = topology.edge_faces[topology.interior].T
    return np.einsum("ni,ni->n", normal[near], normal[far])


def _ratios(surface):
    return radius_ratio(surface.vertices[surface.faces])


def _defects(surface):
    crease = np.maximum(0, _creases(surface) / np.cos(module.CREASE) - 1).sum()
    return crease + np.maximum(0, 1 - _ratios(surface) / module.SLIVER).sum()


def _crossings(surface):
    return sum(map(len, intersecting_pairs(surface.vertices, surface.faces)))


def _crumpled(sphere, rng, noise=0.25):
    surface = sphere(2, 2.0, rng)
    vertices = surface.vertices + noise * rng.normal(size=surface.vertices.shape)
    return _with(surface, vertices=vertices)


def test_a_pleat_is_unfolded(grid, nobody):
    before, _ = _pleat(grid)
    assert _creases(before).min() < -0.5
    after, done = repair(before, nobody, max_area=2.0)
    assert done.counts["repaired"] >= 1
    assert _creases(after).min() > -0.5
    assert is_manifold(after.faces, len(after.vertices))
    assert np.array_equal(done.apply(before.vertices), after.vertices)


def test_the_rest_of_fairing_leaves_that_pleat(grid, nobody, monkeypatch):
    monkeypatch.setattr(module, "GAIN", np.inf)
    after, done = fair(_pleat(grid)[0], nobody)
    assert done.counts["repaired"] == 0
    assert _creases(after).min() < -0.5


def test_a_vertex_of_valence_three_that_is_folded_over_is_taken_away(grid, nobody):
    before, new = _cone(grid, (1.2, 1.2, -1.4))
    assert _creases(before).min() < -0.99
    after, done = repair(before, nobody, max_area=2.0)
    assert done.counts["repaired"] == 1
    assert new not in done.origin()
    assert np.array_equal(after.vertices, grid(6).vertices)
    assert len(after.faces) == len(grid(6).faces)


def test_a_cap_is_repaired(grid, nobody):
    # A vertex of the grid lies almost on the edge opposite to it.
    surface = grid(6)
    before = _moved(surface, 24, surface.vertices[24] + [0.48, -0.48, 0], source=-1)
    assert _ratios(before).min() < 0.05
    after, done = repair(before, nobody, max_area=2.0)
    assert done.counts["repaired"] >= 1
    assert _ratios(after).min() >= module.SLIVER


def test_a_needle_is_repaired(grid, nobody):
    surface = grid(6)
    before = _moved(surface, 24, surface.vertices[25] - [0.02, 0, 0], source=-1)
    assert _ratios(before).min() < 0.05
    after, done = repair(before, nobody, max_area=2.0)
    assert done.counts["repaired"] >= 1
    assert _ratios(after).min() >= module.SLIVER


def test_a_clean_surface_is_untouched(sphere, nobody):
    before = sphere(2, 2.0)
    after, done = repair(before, nobody)
    assert after is before
    assert done.parents == ()
    assert done.counts == {"repaired": 0}


def test_a_particle_in_the_pleat_refuses_its_repair(grid):
    before, i = _pleat(grid)
    triangles = before.vertices[before.faces]
    # Just under and over every triangle of the pleat: no sweep can miss all of them.
    fan = triangles[(before.faces == i).any(axis=1)]
    normal = unit(area_vectors(fan))
    middle = fan.mean(axis=1)
    sides = [middle + s * 0.01 * normal for s in (-1, 1)]
    after, done = repair(before, np.concatenate(sides), max_area=2.0, clearance=0.0)
    assert done.counts["repaired"] == 0
    assert done.counts["repair_refused_particle"] > 0
    assert after is before


@pytest.mark.parametrize("checked", [True, False])
def test_only_the_exact_check_keeps_repairs_from_crossing_what_is_near(
    sphere, nobody, checked, monkeypatch
):
    if not checked:
        monkeypatch.setattr(
            Crossing, "admits", lambda _, moves: np.ones(len(moves.apex), dtype=bool)
        )
    surface, crossings = _crumpled(sphere, np.random.default_rng(5), 0.2), []
    for _ in range(20):
        crossings.append(_crossings(surface))
        surface, _ = repair(surface, nobody, max_area=2.0, max_repairs=1)
    assert (np.diff(crossings) <= 0).all() == checked


def test_a_large_sweep_is_refused(grid, nobody):
    before, _ = _pleat(grid)
    assert repair(before, nobody, max_area=2.0)[1].counts["repaired"] > 0
    tall = _with(before, vertices=100 * before.vertices)
    assert repair(tall, nobody, max_area=2.0)[1].counts["repaired"] == 0


def test_fixed_vertices_and_the_source_stay_where_they_are(grid, nobody):
    before, i = _pleat(grid)
    held = _with(before, fixed=np.ones(len(before.vertices), dtype=bool), source=i)
    after, done = repair(held, nobody, max_area=2.0)
    assert np.array_equal(after.vertices, held.vertices)
    assert after.source == i
    assert np.array_equal(done.origin(), np.arange(len(held.vertices)))


def test_the_number_of_repairs_is_bounded(sphere, nobody):
    before = _crumpled(sphere, np.random.default_rng(0))
    assert repair(before, nobody)[1].counts["repaired"] > 3
    assert repair(before, nobody, max_repairs=3)[1].counts["repaired"] == 3


def test_fairing_reports_its_repairs(grid, nobody):
    _, done = fair(_pleat(grid)[0], nobody)
    assert done.counts["repaired"] > 0


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_repairs_make_nothing_worse(sphere, seed):
    rng = np.random.default_rng(seed)
    before = _crumpled(sphere, rng)
    particles = rng.uniform(-2.5, 2.5, (300, 3))
    after, done = repair(before, particles, max_area=0.7)
    repaired = done.counts["repaired"]
    assert _defects(after) <= _defects(before) - module.GAIN * repaired + 1e-9
    assert _creases(after).min() >= min(0.0, _creases(before).min()) - 1e-12
    assert _ratios(after).min() >= min(module.FAIR_SHAPE, _ratios(before).min())
    assert _crossings(after) <= _crossings(before)
    assert is_manifold(after.faces, len(after.vertices))
    assert euler_number(after.faces) == 2
    topology = build_topology(after.faces, len(after.vertices))
    assert topology.valence.min() >= 3
    sides = [winding_number(particles, s.vertices, s.faces) for s in (before, after)]
    assert np.abs(sides[0] - sides[1]).max() < 1e-6
    assert np.array_equal(done.apply(before.vertices), after.vertices)
    assert np.isin(np.flatnonzero(before.kept), done.origin()).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_crumpled_sphere_loses_most_of_its_defects(sphere, nobody, seed):
    before = _crumpled(sphere, np.random.default_rng(seed))
    after, _ = repair(before, nobody, max_area=2.0)
    assert _defects(after) < 0.3 * _defects(before)
