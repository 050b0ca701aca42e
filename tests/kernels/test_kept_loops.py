"""Loops that are kept on disk are of these sources."""

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
    assert forget_others(tmp_path)  # nobody knows what they are of
    assert [path.exists() for path in kept] == [False, False, True]
    keep()
    assert not forget_others(tmp_path)
    assert all(path.exists() for path in kept)
    (tmp_path / "two.py").write_text("b = 2")
    assert forget_others(tmp_path)
    assert [path.exists() for path in kept] == [False, False, True]
    keep()
    (tmp_path / "two.py").rename(tmp_path / "three.py")
    assert forget_others(tmp_path)
    assert not kept[0].exists()


def test_folder_without_loops_is_fresh(tmp_path):
    assert forget_others(tmp_path)
    assert not forget_others(tmp_path)
