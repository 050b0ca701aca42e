"""Cache folder of numba's compiled loops, and removal of unusable files."""

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
"""Environment variable with the folder of numba's cache."""


def prepare() -> Refusal | None:
    """Prepare numba and its cache: compiling, storing and reading of loops.

    Loops that were compiled from other sources, and truncated files, are deleted. If
    the user's folders cannot be written to, a temporary folder is used; the environment
    passes it to child processes.

    Returns:
        The reason why loops cannot be used; None if they can.

    Warns:
        SlowPathWarning: they are stored in a temporary folder.
    """
    try:
        numba: Any = import_module("numba")  # takes half a second
    # a numba that does not fit the NumPy or the LLVM found here raises many errors
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
        # numba has read the variable at its import
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
    """Return whether there is a cache folder, cleared of unusable files."""
    try:
        folder = kept_in()
        forget_others(Path(__file__).parent, folder)
        delete_damaged(folder)
    # numba raises the first if it has no folder for its cache
    except (RuntimeError, OSError):
        return False
    return True


def kept_in() -> Path:
    """Find the folder of numba's cache: beside the sources, or the user's.

    Raises:
        RuntimeError: no folder is writable.
    """
    beside = may_be_written(Path(__file__).parent / "__pycache__")
    known = os.environ.get(FOLDER) or os.environ.get("XDG_CACHE_HOME")
    # for a user without a home numba would make a folder "~" in the current one
    if not (beside or known or Path(os.path.expanduser("~")).is_absolute()):
        raise RuntimeError("there is no home, and no folder is named.")
    loop: Any = import_module("numba").njit(cache=True)(_from_here)
    return Path(loop.stats.cache_path)


@no_type_check
def _from_here() -> None:
    """Return nothing; numba finds the cache folder by this function's source."""


def forget_others(sources: Path, folder: Path) -> bool:
    """Remove the loops that were compiled from other sources.

    Numba checks the source file of a loop only, not those of the functions that it
    calls, and files of an upgraded package can have the same date and size.

    Args:
        sources: folder of the sources.
        folder: of the cache.

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
    """Remove truncated files of loops, as after a power cut or on a full disk.

    Numba would raise its reader's error, in this run and in every other. Files are only
    parsed to their end, and nothing in them is imported or called; 12 MB in 260 files
    take 0.05 s.

    Args:
        folder: of the cache.

    Returns:
        The files that were deleted; numba compiles them again.
    """
    damaged = [path for path in _files(folder) if not _is_whole(path)]
    for path in damaged:
        path.unlink(missing_ok=True)
    return damaged


def _files(folder: Path) -> list[Path]:
    """List the index files and the code files of all loops."""
    return [*folder.glob("*.nbi"), *folder.glob("*.nbc")]


class _Anything:
    """Placeholder for every class and function that a file names."""

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
    """Reader of pickles that imports nothing and calls nothing."""

    def find_class(self, _module: str, _name: str, /) -> type[_Anything]:
        return _Anything


def _is_whole(path: Path) -> bool:
    """Return whether a file is a complete sequence of pickles.

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
        return True  # another process deleted it, so that it does no harm
    except OSError:
        raise
    # pickle raises any error of the operations in a damaged file
    except Exception:
        return False
