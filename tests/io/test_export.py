"""Files: exact round trips, readable by others, whole or absent."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.visual import ColorVisuals

from jaxgrow.io import export
from jaxgrow.io.formats.format import HEALTHY_COLOUR, LESION_COLOUR


FORMATS = (".ply", ".obj", ".stl", ".glb")


@pytest.fixture
def organ() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A closed surface whose coordinates need all 53 bits."""
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=np.pi)
    jitter = np.random.default_rng(3).normal(scale=1e-3, size=sphere.vertices.shape)
    vertices = np.asarray(sphere.vertices) + jitter
    return vertices, np.asarray(sphere.faces), (vertices[:, 2] > 1).astype(np.uint8)


def _particles() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(5)
    return (
        random.normal(size=(50, 3)),
        random.integers(0, 3, 50),
        random.uniform(0.2, 0.9, 50),
    )


def _write(path: Path, organ: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    vertices, faces, label = organ
    export.write_mesh(path, vertices, faces, label)


def test_organ_ply_comes_back_bit_for_bit(organ, tmp_path) -> None:
    _write(tmp_path / "organ.ply", organ)
    vertices, faces, label = export.read_organ_ply(tmp_path / "organ.ply")
    assert vertices.tobytes() == organ[0].tobytes()
    assert np.array_equal(faces, organ[1])
    assert np.array_equal(label, organ[2])


def test_boolean_labels_are_written_as_zero_and_one(organ, tmp_path) -> None:
    vertices, faces, label = organ
    export.write_mesh(tmp_path / "a.ply", vertices, faces, label.astype(bool))
    assert np.array_equal(export.read_organ_ply(tmp_path / "a.ply")[2], label)


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_another_reader_finds_the_same_doubles(organ, tmp_path, suffix) -> None:
    _write(tmp_path / f"organ{suffix}", organ)
    mesh = trimesh.load_mesh(
        tmp_path / f"organ{suffix}", process=False, maintain_order=True
    )
    assert np.array_equal(mesh.vertices, organ[0])
    assert np.array_equal(mesh.faces, organ[1])


@pytest.mark.parametrize("suffix", [".stl", ".glb"])
def test_another_reader_finds_the_same_triangles_in_single_precision(
    organ, tmp_path, suffix
) -> None:
    _write(tmp_path / f"organ{suffix}", organ)
    mesh = trimesh.load_mesh(tmp_path / f"organ{suffix}", process=False)
    expected = organ[0].astype(np.float32)[organ[1]]
    assert np.array_equal(mesh.triangles.astype(np.float32), expected)


def test_glb_carries_the_label_and_the_colours(organ, tmp_path) -> None:
    _write(tmp_path / "organ.glb", organ)
    mesh = trimesh.load_mesh(tmp_path / "organ.glb", process=False)
    assert np.array_equal(np.ravel(mesh.vertex_attributes["_LABEL"]), organ[2])
    assert isinstance(mesh.visual, ColorVisuals)
    lesion = mesh.visual.vertex_colors[organ[2] == 1, :3]
    assert np.all(lesion == LESION_COLOUR)


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_viewers_see_the_lesion_in_its_own_colour(organ, tmp_path, suffix) -> None:
    _write(tmp_path / f"organ{suffix}", organ)
    mesh = trimesh.load_mesh(
        tmp_path / f"organ{suffix}", process=False, maintain_order=True
    )
    assert isinstance(mesh.visual, ColorVisuals)
    colours = mesh.visual.vertex_colors[:, :3]
    assert np.all(colours[organ[2] == 1] == LESION_COLOUR)
    assert np.all(colours[organ[2] == 0] == HEALTHY_COLOUR)


@pytest.fixture
def values(organ) -> dict[str, np.ndarray]:
    share = np.clip(organ[0][:, 2] / 2, 0, 1).astype(np.float32)
    return {"lesion": share, "region": (3 * share).astype(np.uint8)}


def test_further_values_come_back_with_their_types(organ, values, tmp_path) -> None:
    values["depth"] = organ[0][:, 0]
    values["piece"] = np.arange(len(organ[0]), dtype=np.int64)
    export.write_mesh(tmp_path / "a.ply", *organ, values)
    back = export.read_attributes(tmp_path / "a.ply")
    assert list(back) == list(values)
    assert all(np.array_equal(back[name], values[name]) for name in values)
    assert back["lesion"].dtype == np.float32
    assert back["region"].dtype == np.uint8
    assert export.read_organ_ply(tmp_path / "a.ply")[0].tobytes() == organ[0].tobytes()


def test_another_reader_finds_further_values_of_ply(organ, values, tmp_path) -> None:
    export.write_mesh(tmp_path / "a.ply", *organ, values)
    mesh = trimesh.load_mesh(tmp_path / "a.ply", process=False)
    data = mesh.metadata["_ply_raw"]["vertex"]["data"]
    assert np.array_equal(data["lesion"], values["lesion"])
    assert np.array_equal(data["region"], values["region"])


def test_another_reader_finds_further_values_of_glb(organ, values, tmp_path) -> None:
    export.write_mesh(tmp_path / "a.glb", *organ, values)
    mesh = trimesh.load_mesh(tmp_path / "a.glb", process=False)
    assert np.array_equal(np.ravel(mesh.vertex_attributes["_LESION"]), values["lesion"])
    assert np.array_equal(np.ravel(mesh.vertex_attributes["_REGION"]), values["region"])
    assert np.array_equal(np.ravel(mesh.vertex_attributes["_LABEL"]), organ[2])


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
def test_colours_follow_the_smooth_label(organ, values, tmp_path, suffix) -> None:
    export.write_mesh(tmp_path / f"a{suffix}", *organ, values)
    mesh = trimesh.load_mesh(
        tmp_path / f"a{suffix}", process=False, maintain_order=True
    )
    assert isinstance(mesh.visual, ColorVisuals)
    span = np.subtract(LESION_COLOUR, HEALTHY_COLOUR)
    expected = HEALTHY_COLOUR + values["lesion"][:, None] * span
    assert np.abs(mesh.visual.vertex_colors[:, :3] - expected).max() <= 1


@pytest.mark.parametrize("bad", [np.zeros(3), np.full(162, np.nan)])
def test_further_values_are_one_finite_number_a_vertex(organ, bad, tmp_path) -> None:
    with pytest.raises(
        ValueError, match=r"attribute 'depth' .* give one finite number"
    ):
        export.write_mesh(tmp_path / "a.ply", *organ, {"depth": bad})


def test_particles_come_back_bit_for_bit(tmp_path) -> None:
    position, species, radius = _particles()
    export.write_particles(tmp_path / "p.ply", position, species, radius)
    back = export.read_particles(tmp_path / "p.ply")
    assert back[0].tobytes() == position.tobytes()
    assert np.array_equal(back[1], species)
    assert np.array_equal(back[2], radius.astype(np.float32))


def test_one_radius_serves_all_particles(tmp_path) -> None:
    position, species, _ = _particles()
    export.write_particles(tmp_path / "p.ply", position, species, 0.5)
    assert np.all(export.read_particles(tmp_path / "p.ply")[2] == 0.5)


def test_another_reader_finds_the_particles(tmp_path) -> None:
    position, species, radius = _particles()
    export.write_particles(tmp_path / "p.ply", position, species, radius)
    cloud = trimesh.load(tmp_path / "p.ply", process=False)
    assert isinstance(cloud, trimesh.PointCloud)
    assert np.array_equal(cloud.vertices, position)


@pytest.mark.parametrize("suffix", FORMATS)
def test_an_interrupted_write_leaves_nothing(
    organ, tmp_path, suffix, monkeypatch
) -> None:
    def power_cut(descriptor: int) -> None:
        del descriptor
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", power_cut)
    with pytest.raises(KeyboardInterrupt):
        _write(tmp_path / f"organ{suffix}", organ)
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_write_leaves_the_older_file_as_it_was(tmp_path) -> None:
    target = tmp_path / "organ.ply"
    target.write_bytes(b"older")

    def half(file) -> None:
        file.write(b"half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        export.write_atomically(target, half)
    assert target.read_bytes() == b"older"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_same_mesh_gives_the_same_bytes(organ, tmp_path, suffix) -> None:
    _write(tmp_path / f"a{suffix}", organ)
    _write(tmp_path / f"b{suffix}", organ)
    assert (tmp_path / f"a{suffix}").read_bytes() == (
        tmp_path / f"b{suffix}"
    ).read_bytes()


def test_an_unknown_suffix_names_the_known_ones(organ, tmp_path) -> None:
    with pytest.raises(ValueError, match=r"use one of \.glb, \.obj, \.ply, \.stl"):
        _write(tmp_path / "organ.xyz", organ)


def test_a_coordinate_that_is_not_finite_is_refused(organ, tmp_path) -> None:
    organ[0][4, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        _write(tmp_path / "organ.ply", organ)


def test_a_face_without_its_vertex_is_refused(organ, tmp_path) -> None:
    organ[1][0, 0] = len(organ[0])
    with pytest.raises(ValueError, match="vertex that does not exist"):
        _write(tmp_path / "organ.obj", organ)


def test_a_label_other_than_zero_and_one_is_refused(organ, tmp_path) -> None:
    organ[2][0] = 2
    with pytest.raises(ValueError, match="one label"):
        _write(tmp_path / "organ.ply", organ)


def test_particles_go_to_ply_only(tmp_path) -> None:
    with pytest.raises(ValueError, match=r"\.ply only"):
        export.write_particles(tmp_path / "p.obj", *_particles())


def test_a_particle_that_is_not_finite_is_refused(tmp_path) -> None:
    position, species, radius = _particles()
    position[0, 0] = np.inf
    with pytest.raises(ValueError, match="not finite"):
        export.write_particles(tmp_path / "p.ply", position, species, radius)


def test_a_species_beyond_eight_bits_is_refused(tmp_path) -> None:
    position, species, radius = _particles()
    with pytest.raises(ValueError, match="from 0 to 255"):
        export.write_particles(tmp_path / "p.ply", position, species + 300, radius)


def _damaged(tmp_path: Path, organ, damage) -> Path:
    path = tmp_path / "organ.ply"
    _write(path, organ)
    path.write_bytes(damage(path.read_bytes()))
    return path


@pytest.mark.parametrize(
    "damage, sentence",
    [
        (lambda _: b"", "not a PLY file"),
        (lambda _: b"solid cube", "not a PLY file"),
        (lambda content: content[:-1], "cut short in its element 'face'"),
        (lambda content: content[:900], "cut short in its element 'vertex'"),
        (lambda content: content + b"x", "does not end where"),
        (
            lambda content: content.replace(b"little", b"big", 1),
            "not binary and little",
        ),
        (lambda content: content.replace(b"uchar label", b"uchar lapel"), "no label"),
        (lambda content: content.replace(b"double x", b"quad x"), "bad line"),
        (lambda content: content.replace(b"vertex_ind", b"person_ind"), "no faces"),
        (lambda content: content[:-13] + b"\4" + content[-12:], "not triangles"),
    ],
)
def test_a_damaged_file_gets_one_clear_sentence(
    organ, tmp_path, damage, sentence
) -> None:
    path = _damaged(tmp_path, organ, damage)
    with pytest.raises(ValueError, match=sentence):
        export.read_organ_ply(path)


def test_a_surface_is_no_particle_file(organ, tmp_path) -> None:
    _write(tmp_path / "organ.ply", organ)
    with pytest.raises(ValueError, match="no species, radius"):
        export.read_particles(tmp_path / "organ.ply")
