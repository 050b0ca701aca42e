"""The command line: exit statuses, sentences, and what it leaves in the folder."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import jax
import numpy as np
import pytest
import trimesh

from jaxgrow.cli.main import combine, main
from jaxgrow.lesions.myoma import Myoma
from jaxgrow.lesions.polyp import Polyp


TINY = "[lesion]\nkind = 'polyp'\ndivisions = 3\n"


@pytest.fixture(autouse=True)
def settings(monkeypatch):
    """Keep the test run's own configuration of JAX and of warnings."""
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.delenv("JAXGROW_XLA_CACHE", raising=False)
    directory = jax.config.values["jax_compilation_cache_dir"]
    monkeypatch.setenv("JAXGROW_XLA_CACHE", directory or "off")
    least = jax.config.values["jax_persistent_cache_min_compile_time_secs"]
    monkeypatch.setattr("warnings.formatwarning", None)
    yield
    jax.config.update("jax_persistent_cache_min_compile_time_secs", least)


@pytest.fixture
def tiny(tmp_path):
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return str(path)


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


@pytest.fixture(scope="module")
def grown(tmp_path_factory):
    """A run that the command line wrote."""
    folder = tmp_path_factory.mktemp("cli")
    scene = folder / "tiny.toml"
    scene.write_text(TINY)
    out = folder / "run"
    assert main(["grow", str(scene), "--out", str(out), "--format", "obj"]) == 0
    return out


def _refused(arguments, capsys):
    """The one line on standard error of a call that is refused."""
    assert main([str(argument) for argument in arguments]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    lines = [line for line in output.err.splitlines() if "preparing" not in line]
    assert len(lines) == 1
    assert lines[0].startswith("jaxgrow: ")
    return lines[0]


def test_grow_writes_a_run(grown):
    names = {file.name for file in grown.iterdir()}
    assert names == {
        "organ.ply",
        "organ.obj",
        "base.obj",
        "particles.ply",
        "growth.png",
        "report.json",
    }
    report = json.loads((grown / "report.json").read_text())
    assert report["outcome"]["success"]
    assert report["audit"]["clean"]


def test_grow_tells_what_it_made(tiny, out, capsys):
    assert main(["grow", tiny, "--out", str(out)]) == 0
    output = capsys.readouterr()
    assert f"{out}: polyp of " in output.out
    assert "fundus of uterus, 3 divisions" in output.out
    assert "3 of 3 divisions" in output.err


def test_rim_and_refinement_are_written_if_asked(tiny, out):
    assert main(["grow", tiny, "--out", str(out), "--rim", "--refine", "1"]) == 0
    assert (out / "refined.ply").is_file()
    surface = json.loads((out / "report.json").read_text())["surface"]
    assert surface["rim"]["worst_triangle"] > 0
    assert surface["refined"]["triangles"] > surface["triangles"]


def test_surface_that_cannot_be_subdivided_is_status_1(tiny, out, capsys, monkeypatch):
    from jaxgrow.io.lesion_surface import LesionSurface, RefinementError

    def fail(*_):
        raise RefinementError("the surface subdivided 1 times has defects")

    monkeypatch.setattr(LesionSurface, "refine", fail)
    assert main(["grow", tiny, "--out", str(out), "--refine", "1"]) == 1
    message = capsys.readouterr().err.splitlines()[-1]
    assert message.startswith(f"jaxgrow: {out} has no refined.ply: the surface")
    assert (out / "organ.ply").is_file()


def test_same_seed_gives_the_same_file(tiny, out, grown):
    assert main(["grow", tiny, "--out", str(out), "--seed", "0"]) == 0
    first, second = (folder / "organ.ply" for folder in (grown, out))
    assert first.read_bytes() == second.read_bytes()


def test_size_not_reached_leaves_a_run_and_status_1(out, capsys):
    arguments = ["grow", "--size-mm", "10", "--max-divisions", "2", "--out", str(out)]
    assert main(arguments) == 1
    message = capsys.readouterr().err.splitlines()[-1]
    assert message.startswith(f"jaxgrow: {out} holds only a polyp of ")
    assert "the allowed number of divisions was used up" in message
    report = json.loads((out / "report.json").read_text())
    assert report["outcome"]["result"] == "DIVISION_LIMIT"
    assert (out / "organ.ply").is_file()


def test_audit_of_a_clean_run_is_0(grown, capsys):
    assert main(["audit", str(grown)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.split()[-2:] == ["clean", "True"] for line in lines)


def test_audit_of_a_broken_run_is_1(grown, tmp_path, capsys):
    from jaxgrow.io.export import read_organ_ply, write_mesh

    folder = tmp_path / "broken"
    folder.mkdir()
    for file in grown.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    vertices, faces, label = read_organ_ply(folder / "organ.ply")
    faces[0] = faces[0][::-1]
    write_mesh(folder / "organ.ply", vertices, faces, label)
    assert main(["audit", str(folder)]) == 1
    assert "misoriented" in capsys.readouterr().out


def test_sites_lists_the_named_sites(capsys):
    assert main(["sites"]) == 0
    assert "fundus" in capsys.readouterr().out


def test_version_is_shown(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("jaxgrow ")


def test_help_is_shown_without_arguments(capsys):
    assert main([]) == 2
    output = capsys.readouterr()
    assert "grow" in output.out + output.err
    assert "jaxgrow: " not in output.err


@pytest.mark.parametrize(
    "arguments, sentence",
    [
        (["grwo"], "No such command 'grwo'. Did you mean 'grow'?"),
        (["grow"], "Missing option '--out'"),
        (["grow", "--out"], "'--out' requires an argument"),
        (["grow", "--out", "x", "--sizemm", "3"], "No such option: --sizemm"),
        (
            ["grow", "--out", "x", "--lesion", "polp"],
            "lesion.kind is 'polp'; known are 'polyp', 'myoma'",
        ),
        (["grow", "--out", "x", "--tissue", "up"], "'up' is not one of 'outside'"),
        (["grow", "--out", "x", "--format", "xyz"], "'xyz' is unknown; use ply"),
        (["grow", "--out", "x", "--size-mm", "big"], "Invalid value for '--size-mm'"),
        (["grow", "--out", "x", "--seed", "-1"], "Invalid value for '--seed'"),
        (["grow", "--out", "x", "--seed", "1.5"], "Invalid value for '--seed'"),
        (["grow", "--out", "x", "--refine", "5"], "Invalid value for '--refine'"),
        (["grow", "--out", "x", "a.toml", "b.toml"], "unexpected extra argument"),
        (["audit"], "Missing argument 'DIR'"),
    ],
)
def test_wrong_usage_is_told_in_one_line(arguments, sentence, capsys):
    message = _refused(arguments, capsys)
    assert sentence in message
    assert "Value error" not in message


@pytest.mark.parametrize(
    "options, sentence",
    [
        (["--tolerance", "0"], "the tolerance is 0, but it must be positive"),
        (["--tolerance", "nan"], "the tolerance is nan, but it must be positive"),
        (["--size-mm", "-3"], "lesion.size_mm is -3.0: input should be greater than 0"),
        (["--size-mm", "0"], "lesion.size_mm is 0.0: input should be greater than 0"),
        (["--size-mm", "nan"], "lesion.size_mm is nan: input should be"),
        (["--size-mm", "300"], "must stay to hold it: ask for a smaller lesion"),
        (["--site", "fundsu"], "did you mean 'fundus'?"),
        (["--site", "1,2"], "neither a name nor three finite coordinates"),
        (["--site", "1,2,x"], "neither a name nor three finite coordinates"),
        (["--site", "-1,2,300"], "off the surface"),
        (["--unit-mm", "0", "--organ", "x.ply"], "unit_mm is 0.0: input should be"),
        (["--organ", "none.ply"], "none.ply does not exist"),
        (["--organ", "none.doc"], "none.doc does not end in .obj"),
        (["none.toml"], "the scene none.toml cannot be read"),
    ],
)
def test_wrong_input_is_told_in_one_line(options, sentence, out, capsys, tmp_path):
    assert sentence in _refused(["grow", *options, "--out", out], capsys)
    assert list(tmp_path.iterdir()) == []


def _cube():
    return trimesh.creation.box((20.0, 20.0, 20.0))


def _open(mesh):
    mesh.update_faces(np.arange(1, len(mesh.faces)))
    return mesh


def _nan(mesh):
    lines = mesh.export(file_obj=None, file_type="off").splitlines()
    lines[2] = "nan 0 0"
    return "\n".join(lines)


@pytest.mark.parametrize(
    "make",
    [
        lambda: "this is no mesh",
        lambda: "",
        lambda: "OFF\n0 0 0\n",
        lambda: _open(_cube()).export(file_type="off"),
        lambda: _nan(_cube()),
        lambda: trimesh.util.concatenate(
            [_cube(), _cube().apply_translation((50, 0, 0))]
        ).export(file_obj=None, file_type="off"),
    ],
    ids=["text", "empty", "no faces", "hole", "nan", "two components"],
)
def test_unusable_organ_is_told_in_one_line(make, tmp_path, out, capsys):
    organ = tmp_path / "organ.off"
    organ.write_text(make())
    arguments = ["grow", "--organ", organ, "--site", "0,0,10", "--size-mm", "2"]
    message = _refused([*arguments, "--out", out], capsys)
    assert "organ.off" in message
    assert not out.exists()


def test_folder_of_something_else_is_refused_before_growing(tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text("precious")
    message = _refused(["grow", "--out", tmp_path], capsys)
    assert "is not empty and holds no earlier run" in message
    assert [entry.name for entry in tmp_path.iterdir()] == ["thesis.tex"]


def test_place_that_cannot_be_written_to_is_refused(tmp_path, capsys):
    file = tmp_path / "file"
    file.write_text("")
    message = _refused(["grow", "--out", file / "run"], capsys)
    assert "nothing can be written to" in message


def test_audit_of_no_run_is_refused(tmp_path, capsys):
    assert "so it is no run" in _refused(["audit", tmp_path / "none"], capsys)


def test_sites_of_an_organ_without_names_is_refused(tmp_path, capsys):
    path = tmp_path / "cube.off"
    mesh = _cube()
    path.write_text(mesh.export(file_type="off"))
    message = _refused(["sites", "--organ", path], capsys)
    assert "has no named sites; give X,Y,Z in mm" in message


def test_option_overrides_the_file(tiny):
    scene = combine(
        Path(tiny), {"organ": None, "lesion": {"size_mm": 4.0, "kind": "myoma"}}
    )
    assert scene.lesion == Myoma(size_mm=4.0)
    assert scene.organ == "uterus"


def test_file_stands_where_there_is_no_option(tiny):
    scene = combine(Path(tiny), {"tissue": "inside", "lesion": {"site": "cervix"}})
    assert scene.lesion == Polyp(divisions=3, site="cervix")
    assert scene.tissue == "inside"


def test_organ_of_the_file_is_overridden_by_its_option(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text("organ = 'a.ply'\nunit_mm = 10")
    assert combine(path, {"lesion": {}}).organ == str(tmp_path / "a.ply")
    scene = combine(path, {"organ": "b.ply", "lesion": {}})
    assert (scene.organ, scene.unit_mm) == ("b.ply", 10.0)


def test_other_kind_of_lesion_drops_what_only_the_former_has(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text("[lesion]\nkind = 'myoma'\ndepth_mm = 3\nsite = 'cervix'")
    scene = combine(path, {"lesion": {"kind": "polyp"}})
    assert scene.lesion == Polyp(site="cervix")


@pytest.mark.parametrize("platform", ["cuda", "abacus"])
def test_device_that_is_not_there_is_told_in_one_line(platform, tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "jaxgrow", "grow", "--out", str(tmp_path / "run")],
        env={**os.environ, "JAX_PLATFORMS": platform},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    *progress, sentence = done.stderr.splitlines()
    assert progress == ["preparing the tissue"]
    assert sentence == (
        f"jaxgrow: JAX_PLATFORMS is {platform!r}, and JAX finds no such device here; "
        "install JAX for it, or set JAX_PLATFORMS=cpu."
    )


def test_ctrl_c_ends_with_130_and_leaves_nothing(tmp_path):
    # A process started in the background may have inherited that SIGINT is ignored.
    code = """
        import signal, sys
        signal.signal(signal.SIGINT, signal.default_int_handler)
        from jaxgrow.cli.main import command
        sys.exit(command())
    """
    command = [sys.executable, "-c", textwrap.dedent(code)]
    command += ["grow", "--out", str(tmp_path / "run")]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stderr is not None
        assert process.stderr.readline().strip() == "preparing the tissue"
        time.sleep(1.5)
        process.send_signal(signal.SIGINT)
        try:
            output, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert output == ""
    assert errors.splitlines()[-1] == "jaxgrow: interrupted."
    assert "Traceback" not in errors
    assert list(tmp_path.iterdir()) == []
