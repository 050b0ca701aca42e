"""Inner loops for processors: compiled by numba, called by XLA programs or the host.

XLA runs a sum over neighbours on a processor as many small programs with arrays between
them; a loop keeps a pair in registers. A whole descent is one loop. On accelerators, in
32 bits and under a derivative the same is computed by XLA. What the host does with a
surface of a few hundred triangles is loops always: NumPy would spend most of its time
there on calls and on candidates that are not near. Tests hold all of it equal to XLA
or to all pairs, to rounding. Each loop runs on one thread.
"""

import functools
import hashlib
import os
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any


SWITCH = "JAXGROW_KERNELS"
"""Environment variable that, set to ``off``, leaves the device's programs to XLA."""


@functools.cache
def wanted() -> bool:
    """Whether loops may be used here: numba is installed, and nobody objects."""
    if os.environ.get(SWITCH, "") == "off" or find_spec("numba") is None:
        return False
    try:
        folder = kept_in()
    # what numba raises where it can keep loops in no folder
    except RuntimeError:
        return False
    forget_others(Path(__file__).parent, folder)
    return True


def kept_in() -> Path:
    """Where numba keeps compiled loops: beside their source, or else as the user's.

    Raises:
        RuntimeError: there is no folder that it may write to.
    """
    # not above: numba takes half a second to import
    return Path(import_module("jaxgrow.kernels.distances").to_triangle.stats.cache_path)


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
    for loop in (*folder.glob("*.nbi"), *folder.glob("*.nbc")):
        loop.unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    stamp.write_text(content.hexdigest())
    return True


def loops(name: str) -> Any:
    """Import loops that the host calls: not before, as numba takes half a second.

    They know 64 bits, of which all that the host does is.

    Args:
        name: of a module of `jaxgrow.kernels`.
    """
    return import_module(f"jaxgrow.kernels.{name}")
