"""Persistent cache of compiled programs."""

import contextlib
import functools
import hashlib
import os
import platform
import stat
import tempfile
from pathlib import Path

from jaxgrow.runtime.slow_path import warn_once


_OF_JAX = "JAX_COMPILATION_CACHE_DIR"


def compile_cache() -> Path | None:
    """Return the cache folder, or None if ``JAXGROW_XLA_CACHE=off``.

    ``JAX_COMPILATION_CACHE_DIR`` or ``JAXGROW_XLA_CACHE`` choose another folder. By
    default there is one for each version of jaxlib and kind of processor, because
    programs compiled for another one may crash: below the user's home, or among the
    temporary files if the home cannot be written to. The result is None, too, if
    neither can be written to.

    Warns:
        SlowPathWarning: ``JAXGROW_XLA_CACHE`` chooses a folder that cannot be
            written to.
    """
    from importlib.metadata import version

    choice = os.environ.get("JAXGROW_XLA_CACHE")
    if choice == "off":
        return None
    if of_jax := os.environ.get(_OF_JAX):
        return Path(of_jax)  # JAX reads it too, and says what is wrong with it
    if choice:
        if may_be_written(Path(choice)):
            return Path(choice)
        warn_once(
            f"JAXGROW_XLA_CACHE is {choice}, which cannot be written to, so compiled "
            "programs are not kept and every run is some seconds longer; name another "
            "folder, or none."
        )
        return None
    processor = platform.machine() + platform.processor()
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor += next((line for line in lines if line.startswith("flags")), "")
    kind = hashlib.sha256(processor.encode()).hexdigest()[:8]
    kind = f"jaxlib-{version('jaxlib')}-{kind}"
    # a user id without a name, as in some containers, has no home
    with contextlib.suppress(RuntimeError):
        folder = Path.home() / ".cache/jaxgrow/xla" / kind
        if may_be_written(folder):
            return folder
    folder = private_folder("xla")
    return None if folder is None else folder / kind


@functools.cache
def keep_programs() -> None:
    """Make JAX keep all compiled programs in `compile_cache`'s folder.

    Call it once, at the top of a script or a notebook: its next run reads the programs
    from there, which halves the time of a first gradient. The command ``jaxgrow`` calls
    it itself. A folder already set by `jax.config` is kept. It sets
    `jax_compilation_cache_dir` and, as most of the programs compile in less than the
    second from which JAX keeps them, its least time and size.

    Warns:
        SlowPathWarning: as `compile_cache`.
    """
    import jax
    from jax.experimental.compilation_cache import compilation_cache

    folder = compile_cache()
    chosen = jax.config.values["jax_compilation_cache_dir"]
    if folder is None or chosen not in (None, os.environ.get(_OF_JAX)):
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    compilation_cache.reset_cache()  # JAX asks for the folder when it compiles first


def private_folder(name: str) -> Path | None:
    """Return a temporary folder that only this user may write to.

    It is the same in every process of the user. Its content is executed later, so a
    folder that belongs to another user, or that others may write to, is refused.

    Args:
        name: of the folder, within that of jaxgrow.

    Returns:
        The folder, made if absent; None where there can be none.
    """
    user = getattr(os, "geteuid", int)()  # elsewhere these files are each user's own
    try:
        folder = Path(tempfile.gettempdir()) / f"jaxgrow-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        others = stat.S_IWGRP | stat.S_IWOTH if hasattr(os, "geteuid") else 0
        mine = stat.S_ISDIR(found.st_mode) and found.st_uid == user
        if not mine or found.st_mode & others:
            return None
        (folder / name).mkdir(exist_ok=True)
    except OSError:
        return None
    return folder / name


def may_be_written(folder: Path) -> bool:
    """Return whether files can be created in a folder.

    If it does not exist, its first existing parent decides.
    """
    absolute = folder.absolute()
    for there in (absolute, *absolute.parents):
        if os.path.lexists(there):
            return there.is_dir() and os.access(there, os.W_OK | os.X_OK)
    return False
