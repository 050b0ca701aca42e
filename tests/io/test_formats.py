"""Formats of one's own: registered, written by a run, and refused if they are none."""

import struct
from typing import Any

import numpy as np
import pytest
import trimesh

import jaxgrow as jg
from jaxgrow.cli.main import main
from jaxgrow.io.export import read_organ_ply, write_mesh
from jaxgrow.io.formats.format import SurfaceMesh
from jaxgrow.io.formats.ply import read_elements
from jaxgrow.io.run_folder import check_destination, write_run


class Counts:
    """A format of three numbers: vertices, faces, and vertices of the lesion."""

    suffix = "counts"
    content: Any = None

    def write(self, mesh):
        if self.content is not None:
            return self.content
        marked = int(mesh.attributes["label"].sum())
        return struct.pack("<3q", len(mesh.vertices), len(mesh.faces), marked)


@pytest.fixture
def counts(registries):
    return jg.register_format(Counts())


@pytest.fixture
def ball():
    sphere = trimesh.creation.icosphere(subdivisions=1)
    vertices = np.asarray(sphere.vertices)
    return vertices, np.asarray(sphere.faces), (vertices[:, 2] > 0.5).astype(np.uint8)


def test_run_writes_a_registered_format_and_replaces_it(counts, tiny_polyp, tmp_path):
    write_run(tiny_polyp, tmp_path, ["counts"])
    vertices, faces, label = tiny_polyp.surface()
    written = struct.unpack("<3q", (tmp_path / "organ.counts").read_bytes())
    assert written == (len(vertices), len(faces), label.sum())
    check_destination(tmp_path)
    write_run(tiny_polyp, tmp_path)
    assert not (tmp_path / "organ.counts").exists()


def test_command_writes_a_registered_format(counts, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text("[lesion]\nkind = 'polyp'\ndivisions = 1\n")
    out = tmp_path / "run"
    assert main(["grow", str(scene), "--out", str(out), "--format", "counts"]) == 0
    assert (out / "organ.counts").stat().st_size == 24


def test_attributes_of_vertices_are_properties_of_a_ply_file(ball, tmp_path):
    rng = np.random.default_rng(2)
    depth, region = rng.normal(size=len(ball[0])), rng.integers(0, 9, len(ball[0]))
    path = tmp_path / "ball.ply"
    write_mesh(path, *ball, {"depth": depth, "region": region})
    rows = read_elements(path)["vertex"]
    assert rows["depth"].tobytes() == depth.tobytes()
    assert np.array_equal(rows["region"], region)
    assert np.array_equal(read_organ_ply(path)[2], ball[2])


def test_attributes_of_vertices_are_attributes_of_a_glb_file(ball, tmp_path):
    depth = np.random.default_rng(2).normal(size=len(ball[0])).astype(np.float32)
    write_mesh(tmp_path / "ball.glb", *ball, {"depth": depth})
    mesh = trimesh.load_mesh(tmp_path / "ball.glb", process=False)
    assert np.array_equal(np.ravel(mesh.vertex_attributes["_DEPTH"]), depth)


@pytest.mark.parametrize(
    "name, values, sentence",
    [
        ("depth", np.zeros(3), "finite number for each of 42"),
        ("depth", np.full(42, np.nan), "finite number for each of 42"),
        ("red", np.zeros(42), "'red' is no name"),
        ("a b", np.zeros(42), "'a b' is no name"),
    ],
)
def test_attribute_that_is_none_is_refused(ball, name, values, sentence):
    with pytest.raises(ValueError, match=sentence):
        SurfaceMesh(ball[0], ball[1], {"label": ball[2], name: values})


def test_object_that_cannot_write_is_no_format(unchecked):
    with pytest.raises(TypeError, match="give an object with a suffix"):
        unchecked(jg.register_format)(Counts)
    with pytest.raises(TypeError, match="give an object with a suffix"):
        unchecked(jg.register_format)(object())


@pytest.mark.parametrize(
    "suffix, sentence", [(".off", "without a dot"), ("ply", "runs are read from it")]
)
def test_suffix_that_cannot_be_used_is_refused(registries, suffix, sentence):
    own = Counts()
    own.suffix = suffix
    with pytest.raises(ValueError, match=sentence):
        jg.register_format(own)


def test_format_that_returns_no_bytes_is_told(counts, ball, tmp_path):
    counts.content = "no bytes"
    with pytest.raises(TypeError, match="returned str; it must return bytes"):
        write_mesh(tmp_path / "ball.counts", *ball)
    assert list(tmp_path.iterdir()) == []
