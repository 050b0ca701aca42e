"""Compiled programs are kept where they may be, and nowhere where others may write."""

import os
import stat
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import pytest

from jaxgrow.runtime import slow_path
from jaxgrow.runtime.compile_cache import (
    compile_cache,
    may_be_written,
    private_folder,
)
from jaxgrow.runtime.slow_path import SlowPathWarning


@pytest.fixture(autouse=True)
def temporary(monkeypatch, tmp_path):
    """Nobody chose a folder; temporary files are in one of the test's."""
    monkeypatch.delenv("JAXGROW_XLA_CACHE", raising=False)
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    slow_path.warn_once.cache_clear()
    return tmp_path


def test_compile_cache_can_be_switched_off(monkeypatch):
    monkeypatch.setenv("JAXGROW_XLA_CACHE", "off")
    assert compile_cache() is None


def test_compile_cache_respects_jax_own_variable(monkeypatch, tmp_path):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    assert compile_cache() == tmp_path


def test_compile_cache_is_one_for_each_jaxlib():
    folder = compile_cache()
    assert folder is not None
    assert folder.parent == Path.home() / ".cache/jaxgrow/xla"
    assert version("jaxlib") in folder.name


@pytest.fixture
def no_home(monkeypatch):
    def unknown():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", unknown)


def test_without_a_home_programs_are_kept_among_the_temporary_files(no_home, temporary):
    folder = compile_cache()
    assert folder is not None
    assert folder.parent == temporary / f"jaxgrow-{os.geteuid()}/xla"
    assert version("jaxlib") in folder.name


def test_home_that_cannot_be_written_to_is_as_none(monkeypatch, temporary):
    (temporary / "file").touch()  # nothing can be below it, whoever runs the tests
    monkeypatch.setattr(Path, "home", lambda: temporary / "file")
    folder = compile_cache()
    assert folder is not None
    assert folder.is_relative_to(temporary / f"jaxgrow-{os.geteuid()}")


def test_where_nothing_may_be_written_nothing_is_kept(no_home, monkeypatch, temporary):
    (temporary / "file").touch()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary / "file"))
    assert compile_cache() is None


def test_chosen_folder_that_cannot_be_written_to_is_told(monkeypatch, temporary):
    (temporary / "file").touch()
    monkeypatch.setenv("JAXGROW_XLA_CACHE", str(temporary / "file/xla"))
    with pytest.warns(
        SlowPathWarning, match="file/xla, which cannot be written to, so"
    ):
        assert compile_cache() is None


def test_folder_may_be_written_before_it_exists(temporary):
    assert may_be_written(temporary / "a/b")
    assert not (temporary / "a").exists()


def test_private_folder_is_the_users_alone(temporary):
    folder = private_folder("loops")
    assert folder is not None
    assert stat.S_IMODE(folder.parent.stat().st_mode) == 0o700
    assert private_folder("loops") == folder


def test_folder_that_others_may_write_to_is_not_used(temporary):
    made = temporary / f"jaxgrow-{os.geteuid()}"
    made.mkdir()
    made.chmod(0o777)
    assert private_folder("loops") is None


def test_folder_of_somebody_else_is_not_used(monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    assert private_folder("loops") is None


def test_link_to_a_folder_is_not_used(temporary):
    (temporary / "elsewhere").mkdir(mode=0o700)
    (temporary / f"jaxgrow-{os.geteuid()}").symlink_to(temporary / "elsewhere")
    assert private_folder("loops") is None


USE = """
import jax
jax.config.update("jax_enable_x64", True)
jax.numpy.ones(3)  # compiles, and so asks for the folder, before jaxgrow does
{choice}
import jaxgrow as jg
jg.keep_programs()
jg.relax(jg.make_particles([[0.0, 0, 0], [0.9, 0, 0]]))
print(jax.config.jax_compilation_cache_dir)
"""


def folder_after_a_relaxation(choice="", **variables):
    environment = {**os.environ, **{name: str(v) for name, v in variables.items()}}
    done = subprocess.run(
        [sys.executable, "-c", USE.format(choice=choice)],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.stderr == ""
    return done.stdout.strip()


def test_programs_of_a_script_are_kept_for_the_next(tmp_path):
    folder = tmp_path / "programs"
    assert folder_after_a_relaxation(JAXGROW_XLA_CACHE=folder) == str(folder)
    kept = {path.name for path in folder.iterdir()}
    assert any("descend" in name for name in kept)
    folder_after_a_relaxation(JAXGROW_XLA_CACHE=folder)
    assert kept == {path.name for path in folder.iterdir()}


def test_folder_that_a_script_chose_is_left(tmp_path):
    choice = f'jax.config.update("jax_compilation_cache_dir", "{tmp_path}/own")'
    folder = tmp_path / "programs"
    found = folder_after_a_relaxation(choice, JAXGROW_XLA_CACHE=folder)
    assert found == f"{tmp_path}/own"
    assert not folder.exists()


def test_script_may_keep_nothing():
    assert folder_after_a_relaxation(JAXGROW_XLA_CACHE="off") == "None"
