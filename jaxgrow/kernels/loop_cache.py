"""Where numba keeps compiled loops, and which of those found there are no good."""

import hashlib
import os
import pickle
from importlib import import_module
from pathlib import Path
from typing import Any, no_type_check

from jaxgrow.kernels.refusals import Refusal, said
from jaxgrow.runtime.compile_cache import may_be_written, private_folder
from jaxgrow.runtime.slow_path import warn_once


FOLDER = "NUMBA_CACHE_DIR"
"""Environment variable that names the folder where numba keeps loops."""


def prepare() -> Refusal | None:
    """Make sure that numba can compile loops, keep them, and read those that it kept.

    Loops that were compiled from other sources, and files that were cut short, are
    deleted. Where the user's folders cannot be written to, one among the temporary
    files is used; the environment then tells child processes so.

    Returns:
        Why loops cannot be used; None if they can.

    Warns:
        SlowPathWarning: they are kept among the temporary files.
    """
    try:
        numba: Any = import_module("numba")  # takes half a second
    # a numba that does not fit the NumPy or the LLVM found here has many ways to say so
    except Exception as error:
        return Refusal(
            f"numba cannot be imported ({said(error)})",
            "install a version of numba that fits the versions found here",
        )
    if numba.config.DISABLE_JIT:
        return Refusal("NUMBA_DISABLE_JIT is set", "unset it")
    if _in_order():
        return None
    folder = private_folder("loops")
    if folder is not None:
        # numba reads the variable when it is imported
        os.environ[FOLDER] = numba.config.CACHE_DIR = str(folder)
        if _in_order():
            warn_once(
                f"compiled loops are kept in {folder}, because no other folder may be "
                "written to; whenever temporary files are deleted, the next growth "
                f"takes minutes longer. Set {FOLDER} to a folder that lasts."
            )
            return None
    return Refusal(
        "there is no folder to keep them in that may be written to",
        f"set {FOLDER} to one",
    )


def _in_order() -> bool:
    """Whether there is a folder, with nothing in it that numba must not read."""
    try:
        folder = kept_in()
        forget_others(Path(__file__).parent, folder)
        delete_damaged(folder)
    # the first is what numba raises where it can keep loops in no folder
    except (RuntimeError, OSError):
        return False
    return True


def kept_in() -> Path:
    """Find where numba keeps loops: beside their source, or else as the user's.

    Raises:
        RuntimeError: there is no folder that it may write to.
    """
    beside = may_be_written(Path(__file__).parent / "__pycache__")
    known = os.environ.get(FOLDER) or os.environ.get("XDG_CACHE_HOME")
    # of a user without a home numba would make one, by the name of "~", right here
    if not (beside or known or Path(os.path.expanduser("~")).is_absolute()):
        raise RuntimeError("there is no home, and no folder is named.")
    loop: Any = import_module("numba").njit(cache=True)(_from_here)
    return Path(loop.stats.cache_path)


@no_type_check
def _from_here() -> None:
    """Nothing, but of the same folder as all loops, which is all that numba asks."""


def forget_others(sources: Path, folder: Path) -> bool:
    """Delete the loops that were compiled from other sources.

    Numba looks for a newer source in the file of a loop only, not in those that it
    calls, and files of an upgraded package may well have the same date and size.

    Args:
        sources: folder of them.
        folder: where the loops are kept.

    Returns:
        Whether there may have been any.
    """
    content = hashlib.sha256()
    for path in sorted(sources.glob("*.py")):
        content.update(path.name.encode() + b"\0" + path.read_bytes())
    stamp = folder / "loops.sha256"
    if stamp.exists() and stamp.read_text() == content.hexdigest():
        return False
    for loop in _files(folder):
        loop.unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    stamp.write_text(content.hexdigest())
    return True


def delete_damaged(folder: Path) -> list[Path]:
    """Delete files of loops that end too early, as after a power cut or on a full disk.

    Numba would raise what its reader raises, in this run and in every other. Files are
    only followed to their end, and nothing in them is imported or called; 12 MB in 260
    files take 0.05 s.

    Args:
        folder: where the loops are kept.

    Returns:
        What was deleted; numba compiles it again.
    """
    damaged = [path for path in _files(folder) if not _is_whole(path)]
    for path in damaged:
        path.unlink(missing_ok=True)
    return damaged


def _files(folder: Path) -> list[Path]:
    """The index of each loop, and its code."""
    return [*folder.glob("*.nbi"), *folder.glob("*.nbc")]


class _Anything:
    """A stand-in for every class and function that a file names."""

    def __new__(cls, *_arguments: Any, **_options: Any) -> "_Anything":
        return super().__new__(cls)

    def __call__(self, *_arguments: Any, **_options: Any) -> "_Anything":
        return self

    def __setstate__(self, _state: Any) -> None:
        pass

    def __setitem__(self, _key: Any, _value: Any) -> None:
        pass

    def append(self, _entry: Any) -> None:
        pass

    def extend(self, _entries: Any) -> None:
        pass


class _Follower(pickle.Unpickler):
    """A reader of pickles that imports nothing and calls nothing."""

    def find_class(self, _module: str, _name: str, /) -> type[_Anything]:
        return _Anything


def _is_whole(path: Path) -> bool:
    """Whether a file holds one pickle after the other to its very end.

    Raises:
        OSError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            while file.tell() < size:
                _Follower(file).load()
            return size > 0
    except FileNotFoundError:
        return True  # another process deleted it, which is as good
    except OSError:
        raise
    # pickle raises whatever the operations of a damaged file come upon
    except Exception:
        return False
