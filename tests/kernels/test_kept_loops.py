"""Loops that are kept on disk are of these sources."""

import os
import subprocess
import sys
from pathlib import Path

from jaxgrow import kernels
from jaxgrow.kernels import forget_others


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
        "from jaxgrow import kernels; folder = kernels.kept_in();"
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


def test_without_a_folder_for_loops_there_are_none(monkeypatch):
    def nowhere():
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(kernels, "kept_in", nowhere)
    assert not kernels.wanted.__wrapped__()
