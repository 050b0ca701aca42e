"""Atomic writing of files."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import IO


def write_atomically(
    path: str | os.PathLike[str], write: Callable[[IO[bytes]], object]
) -> None:
    """Write a file atomically: it is complete, or absent.

    ``write`` fills a temporary file in the target's folder (a rename is atomic only
    within one file system), which is flushed to the disk and then takes the target's
    name. If anything goes wrong the temporary file is removed and the target is as it
    was.

    Args:
        path: the file to make or to replace.
        write: called once with the open temporary file.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with partial.open("wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
