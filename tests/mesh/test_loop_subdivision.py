"""Loop subdivision against another implementation, and of a part of a surface."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from jaxgrow.mesh.audit import audit_surface
from jaxgrow.mesh.loop_subdivision import BAND, subdivide_loop


def _bumpy(sphere, level=3):
    surface = sphere(level)
    noise = np.random.default_rng(2).normal(scale=0.02, size=surface.vertices.shape)
    return surface.vertices * [1.0, 1.4, 0.8] + noise, surface.faces


def _dihedral(vertices, faces):
    return trimesh.Trimesh(vertices, faces, process=False).face_adjacency_angles


@pytest.mark.parametrize("levels", [1, 2])
def test_of_a_whole_surface_it_is_what_others_compute(sphere, levels):
    vertices, faces = _bumpy(sphere, 1)
    found = subdivide_loop(vertices, faces, np.ones(len(vertices), bool), levels)
    expected, other = trimesh.remesh.subdivide_loop(vertices, faces, levels)
    assert len(found.faces) == len(other) == 4**levels * len(faces)
    distance, match = KDTree(expected).query(found.vertices)
    assert distance.max() < 1e-14
    assert {frozenset(face) for face in match[found.faces].tolist()} == {  # pyright: ignore[reportIndexIssue]
        frozenset(face) for face in other.tolist()
    }


def test_of_a_regular_plane_it_is_the_plane(sphere):
    cube = trimesh.creation.box()
    vertices, faces = trimesh.remesh.subdivide_to_size(  # pyright: ignore[reportAssignmentType]
        cube.vertices, cube.faces, max_edge=0.15
    )
    mesh = trimesh.Trimesh(vertices, faces)
    middle = np.abs(mesh.vertices - [0, 0, 0.5]).max(axis=1) < 0.1
    found = subdivide_loop(np.array(mesh.vertices), np.array(mesh.faces), middle, 1)
    new = found.vertices[len(mesh.vertices) :]
    top = new[:, 2] > 0.4
    assert np.allclose(new[top, 2], 0.5, atol=1e-15)


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_a_part_is_joined_to_the_rest_without_a_gap(sphere, levels):
    vertices, faces = _bumpy(sphere)
    chosen = vertices[:, 1] > 1.1
    found = subdivide_loop(vertices, faces, chosen, levels)
    audit = audit_surface(found.vertices, found.faces)
    assert audit.clean
    assert audit.euler_number == 2
    assert audit.quality_min > 0.4 * audit_surface(vertices, faces).quality_min


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_the_rest_stays_bit_for_bit(sphere, levels):
    vertices, faces = _bumpy(sphere)
    chosen = vertices[:, 1] > 1.1
    found = subdivide_loop(vertices, faces, chosen, levels)
    ring = np.where(chosen, 0, 99)
    for count in range(1, 20):
        reached = faces[(ring[faces] < count).any(axis=1)]
        ring[reached] = np.minimum(ring[reached], count)
    far = ring >= BAND + levels
    assert far.any()
    old = found.vertices[: len(vertices)]
    assert old[far].tobytes() == vertices[far].tobytes()
    outside = (ring[faces] >= BAND + levels).all(axis=1)
    kept = set(map(tuple, found.faces.tolist()))
    assert all(tuple(face) in kept for face in faces[outside].tolist())


def test_chosen_vertices_are_among_triangles_split_as_often_as_asked(sphere):
    vertices, faces = _bumpy(sphere)
    chosen = vertices[:, 1] > 1.1
    found = subdivide_loop(vertices, faces, chosen, 2)
    share = found.remeshing.apply(chosen.astype(float)[:, None])[:, 0]
    inner = (share[found.faces] > 0).any(axis=1)
    touched = chosen[faces].any(axis=1)
    assert np.count_nonzero((share[found.faces] == 1).all(axis=1)) == 16 * (
        np.count_nonzero(chosen[faces].all(axis=1))
    )
    assert np.count_nonzero(inner) <= 16 * np.count_nonzero(touched)


@pytest.mark.parametrize("levels", [1, 2])
def test_it_makes_the_part_smoother(sphere, levels):
    vertices, faces = _bumpy(sphere)
    found = subdivide_loop(vertices, faces, np.ones(len(vertices), bool), levels)
    before = _dihedral(vertices, faces).max()
    assert _dihedral(found.vertices, found.faces).max() < 0.75**levels * before


def test_displacements_of_old_vertices_are_told(sphere):
    vertices, faces = _bumpy(sphere)
    found = subdivide_loop(vertices, faces, vertices[:, 1] > 1.1, 1)
    moved = np.linalg.norm(found.vertices[: len(vertices)] - vertices, axis=1)
    assert np.allclose(found.displacement, moved, atol=1e-15)
    assert 0 < found.displacement.max() < 0.1


def test_scalars_are_interpolated_linearly(sphere):
    vertices, faces = _bumpy(sphere)
    found = subdivide_loop(vertices, faces, vertices[:, 1] > 1.1, 1)
    one = found.remeshing.apply(np.ones((len(vertices), 1)))
    assert (one == 1).all()
    assert len(one) == len(found.vertices)


@pytest.mark.parametrize("levels", [0, 5])
def test_a_number_of_levels_out_of_range_is_refused(sphere, levels):
    surface = sphere(1)
    with pytest.raises(ValueError, match="ask for 1 to 4"):
        subdivide_loop(surface.vertices, surface.faces, np.ones(42, bool), levels)
