"""Loops that are kept on disk are of these sources."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from jaxgrow.kernels import loop_cache
from jaxgrow.kernels.loop_cache import forget_others


def test_loops_of_other_sources_are_deleted(tmp_path):
    (tmp_path / "one.py").write_text("a = 1")
    (tmp_path / "two.py").write_text("b = 1")
    loops = tmp_path / "__pycache__"
    loops.mkdir()
    kept = [loops / name for name in ("one.f-1.nbi", "one.f-1.1.nbc", "other.pyc")]

    def keep():
        for path in kept:
            path.write_text("compiled")

    keep()
    assert forget_others(tmp_path, loops)  # nobody knows what they are of
    assert [path.exists() for path in kept] == [False, False, True]
    keep()
    assert not forget_others(tmp_path, loops)
    assert all(path.exists() for path in kept)
    (tmp_path / "two.py").write_text("b = 2")
    assert forget_others(tmp_path, loops)
    assert [path.exists() for path in kept] == [False, False, True]
    keep()
    (tmp_path / "two.py").rename(tmp_path / "three.py")
    assert forget_others(tmp_path, loops)
    assert not kept[0].exists()


def test_folder_without_loops_is_fresh(tmp_path):
    loops = tmp_path / "user" / "loops"
    assert forget_others(tmp_path, loops)
    assert not forget_others(tmp_path, loops)


def test_old_loops_are_deleted_where_numba_keeps_them(tmp_path):
    """As in an installation that nobody may write to."""
    look = (
        "from jaxgrow import kernels; from jaxgrow.kernels import loop_cache;"
        "folder = loop_cache.kept_in();"
        "folder.mkdir(parents=True, exist_ok=True);"
        "old = folder / 'old.f-1.py311.nbi'; old.touch();"
        "print(folder, kernels.wanted(), old.exists())"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    said = subprocess.run(
        [sys.executable, "-c", look], env=environment, capture_output=True, text=True
    )
    folder, *rest = said.stdout.split()
    assert Path(folder).is_relative_to(tmp_path), said.stderr
    assert rest == ["True", "False"]


NO_FOLDER = {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator"}
"""Environment of somebody who may write neither beside the sources nor at home."""


def test_without_a_folder_loops_are_kept_among_the_temporary_files(tmp_path):
    look = (
        "import os; from jaxgrow import kernels;"
        "from jaxgrow.kernels import loop_cache;"
        "print(kernels.wanted(), kernels.wanted(), loop_cache.kept_in(),"
        "os.environ['NUMBA_CACHE_DIR'])"
    )
    environment = {**os.environ, **NO_FOLDER, "TMPDIR": str(tmp_path)}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", look], env=environment, capture_output=True, text=True
    )
    *used, folder, told = done.stdout.split()
    assert used == ["True", "True"], done.stderr
    assert (
        Path(folder).parent == Path(told) == tmp_path / f"jaxgrow-{os.geteuid()}/loops"
    )
    assert done.stderr.count("SlowPathWarning") == 1
    assert f"are kept in {told}, because no other folder may be writ" in done.stderr


def test_without_any_folder_there_are_no_loops(monkeypatch):
    def nowhere():
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(loop_cache, "kept_in", nowhere)
    monkeypatch.setattr(loop_cache, "private_folder", lambda _name: None)
    found = loop_cache.prepare()
    assert found is not None
    assert found.reason == "there is no folder to keep them in that may be written to"
    assert found.remedy == "set NUMBA_CACHE_DIR to one"


def test_folder_of_a_user_without_a_home_is_not_made_here(monkeypatch, tmp_path):
    for name in ("HOME", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    monkeypatch.setattr(loop_cache, "may_be_written", lambda _folder: False)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RuntimeError, match="no home"):
        loop_cache.kept_in()
    assert not list(tmp_path.iterdir())


@pytest.fixture
def kept(tmp_path):
    """An index and the code of a loop, as numba writes them."""
    index, code = tmp_path / "one.f-1.py311.nbi", tmp_path / "one.f-1.py311.1.nbc"
    stamped = pickle.dumps(("stamp", {("int64",): code.name}))
    index.write_bytes(pickle.dumps("0.61", protocol=-1) + stamped)
    code.write_bytes(pickle.dumps([np.dtype(float), Path("a"), b"code" * 40_000]))
    return index, code


def test_whole_files_are_left(kept):
    assert not loop_cache.delete_damaged(kept[0].parent)
    assert all(path.exists() for path in kept)


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_file_cut_short_is_deleted(kept, which, share):
    content = kept[which].read_bytes()
    kept[which].write_bytes(content[: int(share * len(content))])
    assert loop_cache.delete_damaged(kept[0].parent) == [kept[which]]
    assert kept[1 - which].exists()
    assert not kept[which].exists()


def test_file_of_zeros_is_deleted(kept):
    """As some file systems leave what was written last before a power cut."""
    kept[1].write_bytes(bytes(kept[1].stat().st_size))
    assert loop_cache.delete_damaged(kept[0].parent) == [kept[1]]


def test_files_are_followed_without_doing_what_they_say(tmp_path):
    class Trap:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "trapped"),))

    (tmp_path / "one.f-1.py311.1.nbc").write_bytes(pickle.dumps(Trap()))
    assert not loop_cache.delete_damaged(tmp_path)
    assert not (tmp_path / "trapped").exists()


def test_loops_cut_short_are_compiled_anew(tmp_path):
    use = (
        "from jaxgrow.kernels import loops; print(loops('distances')._share(1.5, 2.0))"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}

    def run():
        done = subprocess.run(
            [sys.executable, "-c", use], env=environment, capture_output=True, text=True
        )
        return done.stdout, done.stderr

    first = run()
    assert first == ("0.75\n", "")
    files = list(tmp_path.rglob("*.nb[ic]"))
    assert len(files) == 2
    for path, share in zip(files, [0.0, 0.5], strict=True):
        path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    assert run() == first
