"""Inner loops for processors: compiled by numba, called by XLA programs or the host.

XLA runs a sum over neighbours on a processor as many small programs with arrays between
them; a loop keeps a pair in registers. A whole descent is one loop. Where numba is not
installed (extra ``fast``), on accelerators, in 32 bits and under a derivative the same
is computed by XLA. What the host does with a surface of a few hundred triangles has
loops too: NumPy spends most of its time there on calls and on candidates that are not
near; where loops may not be used it finds the same, in the same order. Tests hold all
of it equal, to rounding. Each loop runs on one thread.
"""

import functools
import hashlib
import os
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np


SWITCH = "JAXGROW_KERNELS"
"""Environment variable that, set to ``off``, leaves everything to XLA and NumPy."""


@functools.cache
def wanted() -> bool:
    """Whether loops may be used here: numba is installed, and nobody objects."""
    if os.environ.get(SWITCH, "") == "off" or find_spec("numba") is None:
        return False
    with suppress(OSError):  # a folder that nobody may write to
        forget_others(Path(__file__).parent)
    return True


def serve(array: np.ndarray) -> bool:
    """Whether loops may be used on an array of the host: they know 64 bits."""
    return wanted() and array.dtype == np.float64


def forget_others(folder: Path) -> bool:
    """Delete the loops that were compiled from other sources.

    Numba keeps compiled loops on disk beside their source, and looks for a newer one in
    the same file only, not in those that it calls.

    Args:
        folder: of the sources.

    Returns:
        Whether there may have been any.
    """
    sources = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        sources.update(path.name.encode() + b"\0" + path.read_bytes())
    cache = folder / "__pycache__"
    stamp = cache / "loops.sha256"
    if stamp.exists() and stamp.read_text() == sources.hexdigest():
        return False
    for loop in (*cache.glob("*.nbi"), *cache.glob("*.nbc")):
        loop.unlink(missing_ok=True)
    cache.mkdir(exist_ok=True)
    stamp.write_text(sources.hexdigest())
    return True


@functools.cache
def loops(name: str) -> Any:
    """The loops that the host calls itself; None where none may be used.

    Args:
        name: of a module of `jaxgrow.kernels`.
    """
    if not wanted():
        return None
    try:
        # not above: numba takes half a second to import
        return import_module(f"jaxgrow.kernels.{name}")
    # numba loops that it can keep in no folder; then the host does without
    except Exception:
        return None
