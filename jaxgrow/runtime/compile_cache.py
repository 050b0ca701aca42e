"""Where compiled programs are kept between runs."""

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
    """Folder of compiled programs; None if ``JAXGROW_XLA_CACHE`` is ``off``.

    ``JAX_COMPILATION_CACHE_DIR`` or ``JAXGROW_XLA_CACHE`` choose another folder. By
    default there is one for each version of jaxlib and kind of processor, because
    programs compiled for another one may crash: below the user's home, or among the
    temporary files if there is none that may be written to. It is None, too, where
    nothing may be written.

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
    # who is a number without a name, as in some containers, has no home
    with contextlib.suppress(RuntimeError):
        folder = Path.home() / ".cache/jaxgrow/xla" / kind
        if may_be_written(folder):
            return folder
    folder = private_folder("xla")
    return None if folder is None else folder / kind


@functools.cache
def keep_programs() -> None:
    """Have JAX keep every program that it compiles in the folder of `compile_cache`.

    Call it once, at the top of a script or a notebook: its next run reads the programs
    from there. A first gradient takes half of the time then. The command does it
    anyway. Where JAX was told of another folder (`jax.config`), that is left as it is.
    It sets `jax_compilation_cache_dir` and, as most of the programs compile in less
    than the second from which JAX keeps them, its least time and size.

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
    """Folder among the temporary files that only this user may write to.

    It is the same in every process of the user. What is kept there is executed later,
    so one that belongs to somebody else, or that others may write to, is not used.

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
    """Whether files can be made in it, or in the first above it that exists."""
    absolute = folder.absolute()
    for there in (absolute, *absolute.parents):
        if os.path.lexists(there):
            return there.is_dir() and os.access(there, os.W_OK | os.X_OK)
    return False
