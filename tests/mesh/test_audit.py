"""The audit finds each defect, and that one only."""

import json

import numpy as np
import pytest

from jaxgrow.mesh.audit import audit_surface


def _arrays(surface):
    return surface.vertices.copy(), surface.faces.copy()


def test_a_sphere_is_clean(sphere):
    vertices, faces = _arrays(sphere(3, 2.0))
    audit = audit_surface(vertices, faces)
    assert audit.clean
    assert audit.defects == {}
    assert (audit.components, audit.euler_number) == (1, 2)
    assert audit.volume == pytest.approx(4 / 3 * np.pi * 8, rel=0.02)
    assert 0.9 < audit.quality_min <= audit.quality_percentile_1
    assert audit.quality_percentile_1 <= audit.quality_median <= 1.0


def test_a_box_with_coplanar_faces_is_clean(grid):
    n = 3
    index = {}
    faces = []
    for axis in range(3):
        for end in (0, n):
            for i in range(n):
                for j in range(n):
                    quad = []
                    for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)):
                        point = [i + di, j + dj]
                        point.insert(axis, end)
                        quad.append(index.setdefault(tuple(point), len(index)))
                    # Counter-clockwise from outside; axis 1 has the other parity.
                    if (end == n) == (axis == 1):
                        quad = quad[::-1]
                    a, b, c, d = quad
                    faces += [(a, b, c), (a, c, d)]
    audit = audit_surface(np.array(list(index), dtype=float), np.array(faces))
    assert audit.clean
    assert audit.volume == pytest.approx(27.0)


def test_the_audit_can_be_written_as_json(sphere):
    audit = audit_surface(*_arrays(sphere(1)))
    read = json.loads(json.dumps(audit.as_dict()))
    assert read["clean"] is True
    assert read["faces"] == 80


def test_normals_that_point_inwards_are_not_clean(sphere):
    vertices, faces = _arrays(sphere(1))
    audit = audit_surface(vertices, faces[:, ::-1])
    assert audit.volume < 0
    assert audit.defects == {}
    assert not audit.clean


def test_two_components_are_not_clean(sphere):
    vertices, faces = _arrays(sphere(1))
    audit = audit_surface(
        np.concatenate([vertices, vertices + 5]), np.concatenate([faces, faces + 42])
    )
    assert audit.components == 2
    assert audit.defects == {}
    assert not audit.clean


def test_a_missing_face_leaves_three_boundary_edges(sphere):
    vertices, faces = _arrays(sphere(1))
    assert audit_surface(vertices, faces[1:]).defects == {"boundary_edges": 3}


def test_a_coordinate_that_is_no_number_is_found(sphere):
    vertices, faces = _arrays(sphere(1))
    vertices[7, 1] = np.nan
    vertices[9, 0] = np.inf
    assert audit_surface(vertices, faces).defects == {"non_finite_vertices": 2}


def test_an_index_out_of_range_is_found(sphere):
    vertices, faces = _arrays(sphere(1))
    faces[0, 0] = 42
    assert audit_surface(vertices, faces).defects == {
        "invalid_faces": 1,
        "boundary_edges": 3,
    }


def test_a_turned_face_has_three_misoriented_edges(sphere):
    vertices, faces = _arrays(sphere(1))
    faces[5] = faces[5, ::-1]
    assert audit_surface(vertices, faces).defects == {"misoriented_edges": 3}


def test_a_third_face_at_an_edge_is_not_a_manifold(sphere):
    vertices, faces = _arrays(sphere(1))
    a, b = faces[0, :2]
    fin = (vertices[a] + vertices[b]) * 0.8
    defects = audit_surface(
        np.concatenate([vertices, fin[None]]), np.concatenate([faces, [[a, b, 42]]])
    ).defects
    assert defects == {"boundary_edges": 2, "non_manifold_edges": 1}


def test_two_spheres_that_share_a_vertex_are_not_a_manifold(sphere):
    vertices, faces = _arrays(sphere(1))
    other = 2 * vertices[0] - vertices
    mirrored = np.where(faces[:, ::-1] == 0, 0, faces[:, ::-1] + 42)
    audit = audit_surface(
        np.concatenate([vertices, other]), np.concatenate([faces, mirrored])
    )
    assert audit.defects == {"non_manifold_vertices": 1}
    assert audit.unused_vertices == 1


def test_a_duplicated_face_is_found(sphere):
    vertices, faces = _arrays(sphere(1))
    defects = audit_surface(vertices, np.concatenate([faces, faces[3:4]])).defects
    assert defects["duplicate_faces"] == 1
    assert defects["non_manifold_edges"] == 3


def test_a_face_with_a_repeated_vertex_is_degenerate(sphere):
    vertices, faces = _arrays(sphere(1))
    a, b = faces[0, :2]
    defects = audit_surface(vertices, np.concatenate([faces, [[a, b, b]]])).defects
    assert defects["degenerate_faces"] == 1


def test_a_face_without_area_is_degenerate(sphere):
    # A T-shape that was left open on one side: the tip lies on the opposite edge.
    vertices, faces = _arrays(sphere(1))
    a, b, c = faces[0]
    middle = (vertices[a] + vertices[b]) / 2
    faces = np.concatenate([faces[1:], [[a, 42, c], [42, b, c], [a, b, 42]]])
    audit = audit_surface(np.concatenate([vertices, middle[None]]), faces)
    assert audit.degenerate_faces == 1
    assert audit.quality_min < 1e-12
    assert audit.boundary_edges == audit.misoriented_edges == 0


@pytest.mark.parametrize("angle, folded", [(1.0, 1), (8.0, 0)])
def test_neighbours_closer_than_five_degrees_are_folded(angle, folded):
    turn = np.deg2rad(angle)
    vertices = np.array(
        [[0.0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, np.cos(turn), np.sin(turn)]]
    )
    audit = audit_surface(vertices, np.array([[0, 1, 2], [1, 0, 3]]))
    assert audit.folded_edges == folded


def test_a_vertex_pushed_through_the_other_side_intersects_it(sphere):
    vertices, faces = _arrays(sphere(2))
    top = int(np.argmax(vertices[:, 2] + 0.1 * vertices[:, 0]))
    vertices[top] = -1.5 * vertices[top]
    defects = audit_surface(vertices, faces).defects
    assert set(defects) <= {"self_intersections", "hinged_intersections"}
    assert defects["self_intersections"] >= 5


def test_two_spheres_that_overlap_intersect(sphere):
    vertices, faces = _arrays(sphere(2))
    audit = audit_surface(
        np.concatenate([vertices, vertices + 0.7]),
        np.concatenate([faces, faces + len(vertices)]),
    )
    assert set(audit.defects) == {"self_intersections"}


def test_triangles_that_meet_beyond_their_common_vertex_are_found():
    vertices = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, 1], [1.5, 1, -1]])
    audit = audit_surface(vertices, np.array([[0, 1, 2], [0, 3, 4]]))
    assert audit.hinged_intersections == 1
    assert audit.self_intersections == 0


def test_unused_vertices_are_reported_but_no_defect(sphere):
    vertices, faces = _arrays(sphere(1))
    audit = audit_surface(np.concatenate([vertices, [[9.0, 9, 9]]]), faces)
    assert audit.unused_vertices == 1
    assert audit.euler_number == 2
    assert audit.clean


def test_a_mesh_without_faces_is_not_clean():
    audit = audit_surface(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int64))
    assert not audit.clean
    assert np.isnan(audit.quality_min)
