"""Connectivity."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxgrow.mesh.topology import (
    build_topology,
    component_labels,
    euler_number,
    expand,
    greedy_independent,
    is_manifold,
    vertex_fans,
)


def test_a_grid_has_the_edges_that_counting_gives(grid):
    surface = grid(5)
    topology = build_topology(surface.faces, 36)
    assert len(topology.edges) == 2 * 5 * 6 + 25
    assert np.count_nonzero(~topology.interior) == 20
    assert np.array_equal(topology.rim_vertices, surface.fixed)
    assert topology.valence[14] == 6


def test_faces_lie_on_the_side_that_their_direction_says(sphere):
    faces = sphere(1).faces
    topology = build_topology(faces, 42)
    for side in (0, 1):
        face = faces[topology.edge_faces[:, side]]
        tail, head = topology.edges[:, side], topology.edges[:, 1 - side]
        at = np.argmax(face == tail[:, None], axis=1)
        rows = np.arange(len(face))
        assert np.array_equal(face[rows, (at + 1) % 3], head)
        assert np.array_equal(face[rows, (at + 2) % 3], topology.opposite[:, side])


def test_face_edges_run_from_corner_to_corner(sphere):
    faces = sphere(1).faces
    topology = build_topology(faces, 42)
    runs = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2)
    assert np.array_equal(topology.edges[topology.face_edges], np.sort(runs, axis=2))


def test_has_edge_knows_edges_in_both_directions(grid):
    topology = build_topology(grid(2).faces, 9)
    first, second = np.array([0, 1, 0, 8]), np.array([1, 0, 8, 0])
    assert topology.has_edge(first, second).tolist() == [True, True, False, False]


def test_no_faces_have_no_edges():
    topology = build_topology(np.zeros((0, 3), dtype=np.int64), 4)
    assert len(topology.edges) == 0
    assert not topology.has_edge(np.array([0]), np.array([1])).any()


def test_a_face_with_a_repeated_vertex_is_refused():
    with pytest.raises(ValueError, match="face 1 has a vertex twice"):
        build_topology(np.array([[0, 1, 2], [1, 1, 2]]), 3)


@pytest.mark.parametrize(
    "faces",
    [[[0, 1, 2], [0, 1, 3]], [[0, 1, 2], [1, 0, 3], [0, 1, 4]]],
    ids=["turned", "three faces"],
)
def test_an_edge_run_twice_in_one_direction_is_refused(faces):
    with pytest.raises(ValueError, match=r"edge \(0, 1\) is run twice"):
        build_topology(np.array(faces), 5)


def test_euler_numbers_of_disc_sphere_and_two_spheres(grid, sphere):
    faces = sphere(1).faces
    assert euler_number(grid(4).faces) == 1
    assert euler_number(faces) == 2
    assert euler_number(np.concatenate([faces, faces + 42])) == 4


def _torus_vertex(i, j, di, dj):
    return (((i + di) % 5) * 7 + (j + dj) % 7).ravel()


def test_a_torus_has_euler_number_zero():
    i, j = np.mgrid[:5, :7]
    corner = partial(_torus_vertex, i, j)
    a, b, c, d = corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    assert euler_number(faces) == 0
    assert is_manifold(faces, 35)


def test_components_are_numbered(sphere):
    faces = sphere(0).faces
    labels = component_labels(np.concatenate([faces, faces + 12]), 24)
    assert labels.tolist() == [0] * 20 + [1] * 20


def test_two_fans_at_one_vertex_are_not_a_manifold():
    bow_tie = np.array([[0, 1, 2], [0, 3, 4]])
    topology = build_topology(bow_tie, 5)
    assert vertex_fans(bow_tie, topology).tolist() == [2, 1, 1, 1, 1]
    assert not is_manifold(bow_tie, 5)


def test_a_turned_face_is_not_a_manifold(sphere):
    faces = sphere(0).faces.copy()
    faces[3] = faces[3, ::-1]
    assert not is_manifold(faces, 12)


def test_expand_lists_ranges():
    owner, place = expand(np.array([5, 9, 2]), np.array([2, 0, 3]))
    assert owner.tolist() == [0, 0, 2, 2, 2]
    assert place.tolist() == [5, 6, 2, 3, 4]


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_rounds_choose_what_a_serial_greedy_pass_chooses(seed):
    rng = np.random.default_rng(seed)
    touched = rng.integers(0, 40, (25, 4))
    taken, serial = set(), []
    for row in touched.tolist():
        serial.append(not taken & set(row))
        if serial[-1]:
            taken |= set(row)
    rank = np.repeat(np.arange(25), 4)
    assert greedy_independent(rank, touched.ravel(), 25).tolist() == serial
