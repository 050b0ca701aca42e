"""A surface cut along a line: on circles of a sphere, and on random fields."""

import numpy as np
import pytest

from jaxgrow.mesh.audit import audit_surface
from jaxgrow.mesh.cut import cut_along
from jaxgrow.mesh.isoline import trace_isolines
from jaxgrow.mesh.quality import areas


LEVEL = 0.5
TURN = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]


def _field(sphere, seed=0):
    """A sphere and a rough field on it: a tilted height and noise."""
    surface = sphere(3)
    vertices = surface.vertices @ TURN.T * np.sign(np.linalg.det(TURN))
    faces = surface.faces
    noise = np.random.default_rng(seed).normal(scale=0.05, size=len(vertices))
    return vertices, faces, 0.3 + vertices[:, 2] + noise


def _turning(points):
    side = np.roll(points, -1, axis=0) - points
    side /= np.linalg.norm(side, axis=1)[:, None]
    cosine = np.einsum("ki,ki->k", side, np.roll(side, -1, axis=0))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean()


def _border(faces, values):
    """Directed edges round the faces whose vertices all are within."""
    within = faces[(values[faces] >= LEVEL).all(axis=1)]
    edges = np.concatenate([within[:, [0, 1]], within[:, [1, 2]], within[:, [2, 0]]])
    known = set(map(tuple, edges.tolist()))
    return [(a, b) for a, b in known if (b, a) not in known]


@pytest.mark.parametrize("moving", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_the_part_within_is_bounded_by_one_closed_curve_of_edges(sphere, seed, moving):
    vertices, faces, field = _field(sphere, seed)
    cut = cut_along(vertices, faces, field, LEVEL, moving=moving)
    border = _border(cut.faces, cut.values)
    follow = dict(border)
    assert len(follow) == len(border)
    assert set(follow) == set(follow.values())
    (line,) = trace_isolines(cut.vertices, cut.faces, cut.values, LEVEL)
    assert len(line.points) == len(border)


def test_a_spike_of_one_edge_is_taken_off(sphere):
    surface = sphere(3)
    vertices, faces = surface.vertices, surface.faces
    field = np.where(vertices[:, 2] > 0.6, 1.0, 0.0)
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    above = np.bincount(pairs[:, 0], weights=field[pairs[:, 1]])
    tail = int(np.flatnonzero((above == 1) & (field == 0))[0])
    around = np.unique(faces[(faces == tail).any(axis=1)])
    field[around[field[around] == 1]] = 0.55
    field[tail] = 0.55
    cut = cut_along(vertices, faces, field, LEVEL)
    border = np.unique(_border(cut.faces, cut.values))
    lines = trace_isolines(cut.vertices, cut.faces, cut.values, LEVEL)
    assert np.array_equal(border, np.unique([v for x in lines for v in x.within]))
    assert cut.values[tail] < LEVEL


def test_a_part_of_one_vertex_does_not_vanish(sphere):
    surface = sphere(2)
    field = np.where(np.arange(len(surface.vertices)) == 7, 0.55, 0.0)
    cut = cut_along(surface.vertices, surface.faces, field, LEVEL)
    assert cut.values[7] > LEVEL
    assert len(_border(cut.faces, cut.values)) >= 5


@pytest.mark.parametrize("moving", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_no_edge_crosses_the_line(sphere, seed, moving):
    vertices, faces, field = _field(sphere, seed)
    cut = cut_along(vertices, faces, field, LEVEL, moving=moving)
    side = np.sign(cut.values[cut.faces] - LEVEL)
    assert (side.max(axis=1) - side.min(axis=1) < 2).all()


@pytest.mark.parametrize("moving", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_a_cut_surface_is_clean_and_has_no_sliver(sphere, seed, moving):
    vertices, faces, field = _field(sphere, seed)
    cut = cut_along(vertices, faces, field, LEVEL, moving=moving)
    audit = audit_surface(cut.vertices, cut.faces)
    assert audit.clean
    assert audit.euler_number == 2
    assert audit.quality_min > 0.2
    assert cut.quality >= audit.quality_min


def test_vertices_keep_their_side(sphere):
    vertices, faces, field = _field(sphere)
    cut = cut_along(vertices, faces, field, LEVEL)
    old = cut.values[: len(vertices)]
    on = old == LEVEL
    assert on.any()
    assert np.array_equal((old > LEVEL)[~on], (field > LEVEL)[~on])


def test_everything_off_the_line_stays_bit_for_bit(sphere):
    vertices, faces, field = _field(sphere)
    cut = cut_along(vertices, faces, field, LEVEL)
    stayed = np.ones(len(vertices), dtype=bool)
    stayed[cut.moved] = False
    old = cut.vertices[: len(vertices)]
    assert old[stayed].tobytes() == vertices[stayed].tobytes()
    assert (cut.values[cut.moved] == LEVEL).all()
    within = (field >= LEVEL)[faces].sum(axis=1)
    crossed = (within > 0) & (within < 3)
    kept = set(map(tuple, cut.faces.tolist()))
    assert all(tuple(face) in kept for face in faces[~crossed].tolist())


def test_without_moves_the_surface_stays_where_it_is(sphere):
    vertices, faces, field = _field(sphere)
    cut = cut_along(vertices, faces, field, LEVEL, moving=False)
    assert len(cut.moved) == 0
    assert cut.met > 0
    assert cut.vertices[: len(vertices)].tobytes() == vertices.tobytes()
    before, after = audit_surface(vertices, faces), audit_surface(*cut[:2])
    assert after.volume == pytest.approx(before.volume, rel=1e-13)
    assert areas(cut.vertices[cut.faces]).sum() == pytest.approx(
        areas(vertices[faces]).sum(), rel=1e-13
    )


def test_moves_make_the_line_smoother(sphere):
    vertices, faces, field = _field(sphere)
    turning = []
    for moving in (False, True):
        cut = cut_along(vertices, faces, field, LEVEL, moving=moving)
        (line,) = trace_isolines(cut.vertices, cut.faces, cut.values, LEVEL)
        turning.append(_turning(line.points))
    assert turning[1] < 0.7 * turning[0]


def test_a_circle_stays_a_circle_of_its_length(sphere):
    surface = sphere(4)
    vertices = surface.vertices @ TURN.T
    cut = cut_along(vertices, surface.faces, vertices[:, 2], 0.3)
    (line,) = trace_isolines(cut.vertices, cut.faces, cut.values, 0.3)
    assert line.length == pytest.approx(2 * np.pi * np.sqrt(1 - 0.09), rel=2e-3)
    assert np.abs(line.points[:, 2] - 0.3).max() < 5e-3


def test_a_move_that_would_meet_another_sheet_is_not_made(sphere):
    inner, faces, field = _field(sphere)
    moved = cut_along(inner, faces, field, LEVEL).moved
    # a second sheet, so near that any move of a vertex crosses it
    vertices = np.concatenate([inner, inner * (1 + 1e-9)])
    both = np.concatenate([faces[:, ::-1], faces + len(inner)])
    doubled = np.concatenate([field, np.zeros(len(inner))])
    assert len(moved)
    assert len(cut_along(vertices, both, doubled, LEVEL).moved) == 0


def test_another_scalar_is_interpolated_on_the_edges(sphere):
    vertices, faces, field = _field(sphere)
    cut = cut_along(vertices, faces, field, LEVEL, moving=False)
    expected = vertices @ [1.0, 2.0, 3.0]
    found = cut.interpolate(expected)
    assert np.allclose(found, cut.vertices @ [1.0, 2.0, 3.0], atol=1e-14)
