"""The folder of a run: complete or not there, and readable again."""

import json

import numpy as np
import pytest
import trimesh
from PIL import Image

import jaxgrow as jg
from jaxgrow.io.lesion_surface import lesion_surface, LesionSurface, RefinementError
from jaxgrow.io.run_folder import (
    audit_run,
    check_destination,
    read_run,
    RunFolderError,
    write_run,
)


@pytest.fixture(scope="module")
def polyp_run(tiny_polyp, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "new" / "polyp"
    return folder, write_run(tiny_polyp, folder, ("obj", "stl", "glb"))


@pytest.fixture(scope="module")
def finished_run(tiny_polyp, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "finished"
    return folder, write_run(tiny_polyp, folder, ("glb",), rim=True, refine=1)


@pytest.fixture(scope="module")
def free_run(tiny_cluster, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "cluster"
    return folder, write_run(tiny_cluster, folder)


@pytest.fixture
def copy_of_run(polyp_run, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    for file in polyp_run[0].iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    return folder


def test_folder_holds_what_is_promised_and_nothing_else(polyp_run):
    folder, _ = polyp_run
    assert {file.name for file in folder.iterdir()} == {
        "organ.ply",
        "organ.obj",
        "organ.stl",
        "organ.glb",
        "base.obj",
        "particles.ply",
        "growth.png",
        "report.json",
    }
    assert [entry.name for entry in folder.parent.iterdir()] == ["polyp"]


def test_surface_comes_back_bit_for_bit(polyp_run, tiny_polyp):
    run = read_run(polyp_run[0])
    vertices, faces, label = tiny_polyp.surface()
    assert run.vertices is not None
    assert run.faces is not None
    assert run.label is not None
    assert np.array_equal(run.vertices, vertices)
    assert np.array_equal(run.faces, faces)
    assert np.array_equal(run.label, label)


def test_organ_run_and_surface_show_themselves_in_a_line(polyp_run, tiny_polyp):
    run = jg.read_run(polyp_run[0])
    vertices, particles = len(run.vertices), len(run.position)
    result = tiny_polyp.result.name
    assert repr(run) == f"Run({result}, {vertices} vertices, {particles} particles)"
    surface = jg.lesion_surface(tiny_polyp)
    lesion = int(run.label.sum())
    assert repr(surface).startswith(f"LesionSurface({vertices} vertices, {lesion} of ")
    assert repr(jg.uterus()).startswith("Organ('uterus', 2227 vertices, 4450 faces,")


def test_smooth_label_and_regions_come_back(polyp_run, tiny_polyp):
    run, surface = read_run(polyp_run[0]), lesion_surface(tiny_polyp)
    assert set(run.attributes) == {"lesion", "region"}
    assert np.array_equal(run.attributes["lesion"], surface.lesion)
    assert np.array_equal(run.attributes["region"], surface.region)
    assert np.array_equal(run.label == 1, run.attributes["lesion"] >= 0.5)


def test_ring_is_a_closed_line_of_an_obj_file(polyp_run, tiny_polyp):
    lines = (polyp_run[0] / "base.obj").read_text().splitlines()
    points = np.array([line.split()[1:] for line in lines if line[0] == "v"], float)
    assert np.array_equal(points, lesion_surface(tiny_polyp).ring)
    (element,) = [line for line in lines if line[0] == "l"]
    assert element.split()[1:] == [*map(str, range(1, len(points) + 1)), "1"]


def test_report_tells_ring_and_areas(polyp_run):
    surface = polyp_run[1]["surface"]
    assert surface["ring_mm"] > 0
    assert surface["rings"] >= 1
    assert surface["area_mm2"]["base"] > 0
    assert "rim" not in surface
    assert "refined" not in surface


def test_finished_surfaces_are_written_if_asked(finished_run, tiny_polyp):
    folder, report = finished_run
    names = {file.name for file in folder.iterdir()}
    assert {"refined.ply", "refined.glb", "organ.glb", "base.obj"} <= names
    assert "refined.obj" not in names
    cut = lesion_surface(tiny_polyp, rim=True)
    assert np.array_equal(read_run(folder).vertices, cut.vertices)
    assert report["surface"]["rim"]["worst_triangle"] > 0.2
    refined = report["surface"]["refined"]
    assert refined["refused"] is None
    mesh = trimesh.load_mesh(folder / "refined.ply", process=False)
    assert len(mesh.faces) == refined["triangles"] > report["surface"]["triangles"]
    assert mesh.is_watertight
    assert report["audit"]["clean"] is True


def test_surface_that_cannot_be_subdivided_is_told(tiny_polyp, tmp_path, monkeypatch):
    def fail(*_):
        raise RefinementError("the surface subdivided 1 times has defects")

    monkeypatch.setattr(LesionSurface, "refine", fail)
    report = write_run(tiny_polyp, tmp_path, refine=1)
    assert "has defects" in report["surface"]["refined"]["refused"]
    assert not (tmp_path / "refined.ply").exists()
    assert (tmp_path / "organ.ply").exists()


def test_too_many_levels_are_refused_before_anything_is_written(tiny_polyp, tmp_path):
    with pytest.raises(ValueError, match=r"refine is 5; ask for 0 \(none\) to 4"):
        write_run(tiny_polyp, tmp_path / "run", refine=5)
    assert list(tmp_path.iterdir()) == []


def test_particles_come_back_bit_for_bit(polyp_run, tiny_polyp):
    run = read_run(polyp_run[0])
    position, species = tiny_polyp.particles()
    assert np.array_equal(run.position, position)
    assert np.array_equal(run.species, species)


@pytest.mark.parametrize("kind", ["ply", "obj", "stl", "glb"])
def test_another_program_reads_a_closed_organ(polyp_run, kind):
    mesh = trimesh.load_mesh(polyp_run[0] / f"organ.{kind}")
    assert mesh.is_watertight
    assert mesh.euler_number == 2


def test_picture_is_a_picture(polyp_run):
    with Image.open(polyp_run[0] / "growth.png") as picture:
        grey = np.asarray(picture.convert("L"), dtype=int)
    assert np.ptp(grey) > 100


def test_report_is_json_without_nan(polyp_run):
    def refuse(name):
        raise AssertionError(f"{name} is no JSON")

    text = (polyp_run[0] / "report.json").read_text(encoding="utf-8")
    assert json.loads(text, parse_constant=refuse) == polyp_run[1]


def test_report_tells_request_and_outcome(polyp_run, tiny_polyp):
    report = polyp_run[1]
    scene = report["request"]["scene"]
    assert scene["organ"] == "uterus"
    assert scene["lesion"]["kind"] == "polyp"
    assert scene["lesion"]["divisions"] == 3
    assert scene["parameters"]["adhesion"] == 0.2
    assert report["request"]["seed"] == 0
    assert report["outcome"]["result"] == "REACHED"
    assert report["outcome"]["divisions"] == 3
    assert report["outcome"]["size_mm"] == tiny_polyp.size_mm
    assert report["outcome"]["metrics"]["tumour_diameter_mm"] > 0
    assert [record["division"] for record in report["history"]] == [1, 2, 3]
    assert all(0 <= record["residual"] <= 1e-3 for record in report["history"])
    assert report["counts"]["tumour"] == 3
    assert report["compilations"] >= 0
    assert sum(report["seconds"].values()) > 0


def test_report_names_all_that_decides_the_result(polyp_run):
    versions = polyp_run[1]["versions"]
    for name in ("python", "jax", "jaxlib", "jax-md", "numpy", "scipy", "trimesh"):
        assert versions[name]


def test_audit_of_the_files_is_in_the_report(polyp_run):
    found = audit_run(polyp_run[0])
    assert found.clean
    assert polyp_run[1]["audit"]["clean"] is True


def test_audit_finds_a_particle_moved_through_the_surface(copy_of_run):
    from jaxgrow.io.export import write_particles

    run = read_run(copy_of_run)
    assert run.vertices is not None
    position = run.position.copy()
    position[0] = [0.0, 0.0, 15.0]  # the middle of the cavity
    write_particles(copy_of_run / "particles.ply", position, run.species, 0.5)
    assert not audit_run(copy_of_run).clean


def test_audit_finds_a_hole(copy_of_run):
    from jaxgrow.io.export import write_mesh

    run = read_run(copy_of_run)
    assert run.vertices is not None
    assert run.faces is not None
    assert run.label is not None
    write_mesh(copy_of_run / "organ.ply", run.vertices, run.faces[1:], run.label)
    assert not audit_run(copy_of_run).clean


def test_free_cluster_has_no_organ_file(free_run):
    folder, report = free_run
    assert {file.name for file in folder.iterdir()} == {
        "particles.ply",
        "growth.png",
        "report.json",
    }
    assert report["request"]["scene"]["organ"] is None
    assert report["surface"] is None
    assert read_run(folder).vertices is None
    assert audit_run(folder).clean


def test_earlier_run_is_replaced(copy_of_run, tiny_cluster):
    write_run(tiny_cluster, copy_of_run)
    assert not (copy_of_run / "organ.ply").exists()
    assert read_run(copy_of_run).vertices is None


def test_empty_folder_is_filled(tiny_cluster, tmp_path):
    write_run(tiny_cluster, tmp_path)
    assert (tmp_path / "report.json").is_file()


def test_foreign_folder_is_refused_and_left_alone(tiny_cluster, tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(RunFolderError, match=r"not empty .*there is thesis\.tex"):
        write_run(tiny_cluster, tmp_path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["thesis.tex"]


def test_folder_with_an_organ_but_no_report_is_refused(tmp_path):
    (tmp_path / "organ.ply").write_text("somebody's")
    with pytest.raises(RunFolderError, match=r"there is organ\.ply"):
        check_destination(tmp_path)


def test_file_is_no_destination(tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(RunFolderError, match="is a file, but a run is written to"):
        check_destination(file)


def test_place_that_cannot_be_written_to_is_no_destination(tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(RunFolderError, match="nothing can be written to"):
        check_destination(file / "run")


def test_checking_a_destination_leaves_nothing(tmp_path):
    check_destination(tmp_path / "a" / "b")
    assert list(tmp_path.iterdir()) == []


def test_unknown_format_is_refused(tiny_cluster, tmp_path):
    with pytest.raises(ValueError, match="format 'xyz' is unknown; use ply, obj"):
        write_run(tiny_cluster, tmp_path / "run", ("xyz",))
    assert list(tmp_path.iterdir()) == []


def test_failure_while_writing_leaves_nothing(tiny_cluster, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError("the disk is full")

    monkeypatch.setattr("jaxgrow.io.run_folder._draw", fail)
    with pytest.raises(OSError, match="the disk is full"):
        write_run(tiny_cluster, tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_failure_while_writing_leaves_an_earlier_run(
    copy_of_run, tiny_cluster, monkeypatch
):
    def fail(*_, **__):
        raise OSError("the disk is full")

    before = {file.name: file.read_bytes() for file in copy_of_run.iterdir()}
    monkeypatch.setattr("jaxgrow.io.run_folder._draw", fail)
    with pytest.raises(OSError, match="the disk is full"):
        write_run(tiny_cluster, copy_of_run)
    assert before == {file.name: file.read_bytes() for file in copy_of_run.iterdir()}


def test_reading_what_is_no_folder_is_refused(tmp_path):
    with pytest.raises(RunFolderError, match="is no folder, so it is no run"):
        read_run(tmp_path / "none")


def test_reading_a_folder_without_report_is_refused(tmp_path):
    with pytest.raises(RunFolderError, match=r"holds no report\.json, so it is no run"):
        read_run(tmp_path)


@pytest.mark.parametrize(
    "name, content, sentence",
    [
        ("report.json", b"{", r"is damaged: report\.json is not valid JSON"),
        ("report.json", b"\xff", r"is damaged: report\.json is not valid JSON"),
        ("report.json", b"{}", "lacks the entry request"),
        ("report.json", b"[]", "lacks the entry request"),
        ("organ.ply", b"ply", r"is damaged: .*organ\.ply"),
        ("particles.ply", b"", r"is damaged: .*particles\.ply"),
        ("organ.ply", None, r"is damaged: organ\.ply: No such file"),
    ],
)
def test_damaged_run_is_refused(copy_of_run, name, content, sentence):
    if content is None:
        (copy_of_run / name).unlink()
    else:
        (copy_of_run / name).write_bytes(content)
    with pytest.raises(RunFolderError, match=sentence):
        read_run(copy_of_run)
