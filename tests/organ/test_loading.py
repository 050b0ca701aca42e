import numpy as np
import pytest
import trimesh

from jaxgrow.organ import load_organ, OrganError
from jaxgrow.organ.validity import (
    check_surface,
    is_closed_manifold,
    merge_duplicates,
    signed_volume,
)


def sphere(radius=10.0):
    return trimesh.creation.icosphere(subdivisions=2, radius=radius)


def written(tmp_path, vertices, faces, kind="off"):
    """A file with exactly these vertices and faces, nothing tidied up."""
    path = tmp_path / f"organ.{kind}"
    rows = [" ".join(map(repr, map(float, vertex))) for vertex in vertices]
    if kind == "off":
        sides = [f"{len(face)} " + " ".join(map(str, face)) for face in faces]
        lines = ["OFF", f"{len(rows)} {len(sides)} 0", *rows, *sides]
    else:
        sides = ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
        lines = [*(f"v {row}" for row in rows), *sides]
    path.write_text("\n".join(lines) + "\n")
    return path


def check(path):
    """The message of the refusal, which must be one sentence."""
    with pytest.raises(OrganError) as caught:
        load_organ(path)
    message = str(caught.value)
    assert message.endswith((".", ")"))
    assert "\n" not in message
    assert ". " not in message
    return message


@pytest.mark.parametrize("kind", ["obj", "ply", "stl", "glb", "off"])
def test_every_format_gives_the_same_closed_surface(tmp_path, kind):
    mesh = sphere()
    mesh.export(tmp_path / f"organ.{kind}")
    organ = load_organ(tmp_path / f"organ.{kind}")
    assert len(organ.vertices) == len(mesh.vertices)
    assert len(organ.faces) == len(mesh.faces)
    assert signed_volume(organ.vertices, organ.faces) == pytest.approx(
        mesh.volume, rel=1e-5
    )


@pytest.mark.parametrize("kind", ["obj", "off"])
def test_vertices_keep_their_order_and_every_bit(tmp_path, kind):
    mesh = sphere()
    organ = load_organ(written(tmp_path, mesh.vertices, mesh.faces, kind))
    np.testing.assert_array_equal(organ.vertices, mesh.vertices)
    np.testing.assert_array_equal(organ.faces, mesh.faces)


def test_an_organ_is_named_after_its_file_and_has_no_sites(tmp_path):
    mesh = sphere()
    organ = load_organ(written(tmp_path, mesh.vertices, mesh.faces), tissue="inside")
    assert organ.name == "organ.off"
    assert organ.tissue == "inside"
    assert dict(organ.sites) == {}


def test_normals_and_textures_of_an_obj_file_do_not_split_its_vertices(tmp_path):
    mesh = sphere()
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += ["mtllib none.mtl", "vt 0 0", "vt 1 0", "vn 0 0 1", "vn 1 0 0"]
    for row, (a, b, c) in enumerate(mesh.faces + 1):
        k = row % 2 + 1
        lines.append(f"f {a}/{k}/{k} {b}/1/{k} {c}/{k}/1")
    path = tmp_path / "organ.obj"
    path.write_text("\n".join(lines))
    np.testing.assert_array_equal(load_organ(path).faces, mesh.faces)


def test_the_unit_scales_the_surface(tmp_path):
    mesh = sphere(radius=0.01)
    organ = load_organ(written(tmp_path, mesh.vertices, mesh.faces), unit_mm=1000.0)
    np.testing.assert_array_equal(organ.vertices, mesh.vertices * 1000)


def test_node_transforms_of_a_glb_scene_are_applied(tmp_path):
    scene = trimesh.Scene()
    shift = trimesh.transformations.translation_matrix([100.0, 0, 0])
    scene.add_geometry(sphere(), transform=shift)
    scene.export(tmp_path / "organ.glb")
    organ = load_organ(tmp_path / "organ.glb")
    np.testing.assert_allclose(organ.vertices.mean(axis=0), [100, 0, 0], atol=1e-4)


def test_seams_of_a_glb_file_are_closed(tmp_path):
    mesh = sphere()
    split = trimesh.Trimesh(
        mesh.vertices[mesh.faces].reshape(-1, 3),
        np.arange(3 * len(mesh.faces)).reshape(-1, 3),
        process=False,
    )
    split.export(tmp_path / "organ.glb")
    assert len(load_organ(tmp_path / "organ.glb").vertices) == len(mesh.vertices)


def test_a_surface_far_from_the_origin_is_as_good(tmp_path):
    mesh = sphere()
    organ = load_organ(written(tmp_path, mesh.vertices + 1e6, mesh.faces))
    assert signed_volume(organ.vertices, organ.faces) == pytest.approx(
        mesh.volume, rel=1e-9
    )


def test_a_missing_file_is_refused(tmp_path):
    assert "does not exist" in check(tmp_path / "none.ply")


def test_a_folder_is_refused(tmp_path):
    (tmp_path / "folder.ply").mkdir()
    assert "is a folder" in check(tmp_path / "folder.ply")


def test_an_empty_file_is_refused(tmp_path):
    (tmp_path / "empty.ply").touch()
    assert "is empty (0 bytes)" in check(tmp_path / "empty.ply")


def test_an_unknown_ending_is_refused(tmp_path):
    assert "does not end in .obj, .ply, .stl, .glb or .off" in check(
        tmp_path / "organ.docx"
    )


@pytest.mark.parametrize("kind", ["obj", "ply", "stl", "glb", "off"])
@pytest.mark.parametrize("content", [b"this is no mesh\n", b"\x00\xff\x13" * 100])
def test_a_file_that_is_no_mesh_is_refused(tmp_path, kind, content):
    path = tmp_path / f"organ.{kind}"
    path.write_bytes(content)
    message = check(path)
    assert "can be read" in message or "holds no triangles" in message


@pytest.mark.parametrize("kind", ["ply", "stl", "glb"])
def test_a_truncated_file_is_refused(tmp_path, kind):
    path = tmp_path / f"organ.{kind}"
    sphere().export(path)
    path.write_bytes(path.read_bytes()[:-1000])
    check(path)


def test_points_without_triangles_are_refused(tmp_path):
    path = tmp_path / "points.ply"
    trimesh.PointCloud(np.eye(3)).export(path)
    assert "holds no triangles (only 3 points)" in check(path)


def test_several_geometries_are_refused(tmp_path):
    scene = trimesh.Scene({"liver": sphere(), "gall": sphere(3.0)})
    scene.export(tmp_path / "organ.glb")
    assert "holds 2 geometries (gall, liver)" in check(tmp_path / "organ.glb")


@pytest.mark.parametrize("unit_mm", [0.0, -1.0, float("nan")])
def test_a_unit_that_is_no_length_is_refused(tmp_path, unit_mm):
    with pytest.raises(OrganError, match="must be a positive number"):
        load_organ(tmp_path / "organ.ply", unit_mm=unit_mm)


def test_coordinates_that_are_not_finite_are_refused(tmp_path):
    mesh = sphere()
    vertices = np.array(mesh.vertices)
    vertices[[7, 9], 1] = np.nan
    message = check(written(tmp_path, vertices, mesh.faces))
    assert "2 vertices with a coordinate that is no finite number" in message
    assert "the first is vertex 7" in message


def test_indices_out_of_range_are_refused():
    mesh = sphere()
    faces = np.array(mesh.faces, dtype=np.int64)
    faces[5, 1] = 1000
    with pytest.raises(OrganError, match="the first is triangle 5"):
        check_surface(np.array(mesh.vertices), faces, "organ")


def test_no_faces_are_refused():
    with pytest.raises(OrganError, match="3 vertices and no triangles"):
        check_surface(np.eye(3), np.zeros((0, 3), dtype=np.int64), "organ")


def test_unused_vertices_are_refused(tmp_path):
    mesh = sphere()
    vertices = np.concatenate([mesh.vertices, [[1.0, 2.0, 3.0]]])
    assert "1 vertex that no triangle uses" in check(
        written(tmp_path, vertices, mesh.faces)
    )


def test_duplicate_vertices_are_refused_and_the_cure_is_named(tmp_path):
    mesh = sphere()
    vertices = np.concatenate([mesh.vertices, mesh.vertices[:1]])
    faces = np.array(mesh.faces)
    rows = np.flatnonzero((faces == 0).any(axis=1))[:3]
    faces[rows] = np.where(faces[rows] == 0, len(vertices) - 1, faces[rows])
    message = check(written(tmp_path, vertices, faces))
    assert "1 duplicate vertex" in message
    assert "merging them makes the surface closed" in message
    assert "mesh.merge_vertices(" in message


def test_duplicate_vertices_of_an_open_surface_promise_nothing(tmp_path):
    mesh = sphere()
    vertices = np.concatenate([mesh.vertices, mesh.vertices[:1]])
    faces = np.array(mesh.faces)[1:]
    row = int(np.argmax((faces == 0).any(axis=1)))
    faces[row] = np.where(faces[row] == 0, len(vertices) - 1, faces[row])
    assert "merging them alone does not make" in check(
        written(tmp_path, vertices, faces)
    )


def test_degenerate_triangles_are_refused_with_their_place(tmp_path):
    mesh = sphere()
    vertices = np.array(mesh.vertices)
    a, b, c = mesh.faces[3]
    vertices[c] = (vertices[a] + vertices[b]) / 2
    message = check(written(tmp_path, vertices, mesh.faces))
    assert "1 degenerate triangle of no area (the first is triangle 3 at (" in message


def test_non_manifold_edges_are_refused(tmp_path):
    mesh = sphere()
    vertices = np.concatenate([mesh.vertices, [[0.0, 0.0, 0.0]]])
    a, b, _ = mesh.faces[0]
    faces = np.concatenate([mesh.faces, [[a, b, len(vertices) - 1]]])
    message = check(written(tmp_path, vertices, faces))
    assert "1 edge with more than two triangles" in message
    assert "has 3)" in message


def test_holes_are_counted_and_the_largest_is_placed(tmp_path):
    mesh = sphere()
    centres = mesh.triangles_center
    top = int(np.argmax(centres[:, 2]))
    low = (mesh.faces == mesh.faces[int(np.argmin(centres[:, 2]))][0]).any(axis=1)
    keep = ~low
    keep[top] = False
    # the vertex that the larger hole leaves without triangles is the file's last
    lone = mesh.faces[int(np.argmin(centres[:, 2]))][0]
    order = np.append(np.delete(np.arange(len(mesh.vertices)), lone), lone)
    faces = np.argsort(order)[mesh.faces[keep]]
    message = check(written(tmp_path, mesh.vertices[order[:-1]], faces))
    assert "2 holes" in message
    assert f"with {int(low.sum())} rim edges" in message


def test_inconsistent_winding_is_refused(tmp_path):
    mesh = sphere()
    faces = np.array(mesh.faces)
    faces[4] = faces[4, ::-1]
    message = check(written(tmp_path, mesh.vertices, faces))
    assert "3 edges whose two triangles are wound in opposite senses" in message
    assert "fix_normals" in message


def test_sheets_that_touch_in_a_point_are_refused(tmp_path):
    one, other = sphere(), sphere(radius=3.0)
    corner = other.vertices[5] / 3
    turn = trimesh.geometry.align_vectors(corner, -one.vertices[0])
    other.apply_transform(turn)
    other.apply_translation(one.vertices[0] - other.vertices[5])
    vertices = np.concatenate([one.vertices, np.delete(other.vertices, 5, axis=0)])
    renumber = len(one.vertices) + np.arange(len(other.vertices))
    renumber[6:] -= 1
    renumber[5] = 0
    faces = np.concatenate([one.faces, renumber[other.faces]])
    message = check(written(tmp_path, vertices, faces))
    assert "1 vertex where two sheets touch in a single point" in message
    assert "vertex 0" in message


def test_several_components_are_refused_with_their_sizes(tmp_path):
    one, other = sphere(), trimesh.creation.icosphere(subdivisions=1, radius=3)
    vertices = np.concatenate([one.vertices, other.vertices])
    faces = np.concatenate([one.faces, other.faces + len(one.vertices)])
    message = check(written(tmp_path, vertices, faces))
    assert "2 separate components (of 320, 80 triangles)" in message


def test_normals_that_point_inwards_are_refused(tmp_path):
    mesh = sphere()
    message = check(written(tmp_path, mesh.vertices, mesh.faces[:, ::-1]))
    assert "normals that point the wrong way" in message
    assert "mesh.invert()" in message


@pytest.mark.parametrize("radius", [0.05, 5000.0])
def test_a_size_that_no_organ_has_asks_for_the_unit(tmp_path, radius):
    mesh = sphere(radius=radius)
    message = check(written(tmp_path, mesh.vertices, mesh.faces))
    assert "give the length of the file's unit with unit_mm" in message


def test_merging_duplicates_keeps_the_order_of_first_occurrence():
    vertices = np.array([[2.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, -0.0], [0, 0, 0]])
    merged, faces = merge_duplicates(vertices, np.array([[0, 1, 3], [2, 4, 1]]))
    np.testing.assert_array_equal(merged[:, 0], [2, 1, 0])
    np.testing.assert_array_equal(faces, [[0, 1, 2], [0, 2, 1]])


def test_a_closed_manifold_is_told_from_an_open_one():
    faces = np.array(sphere().faces, dtype=np.int64)
    assert is_closed_manifold(faces)
    assert not is_closed_manifold(faces[1:])
