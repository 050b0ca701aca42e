"""Where compiled programs are kept between runs."""

import contextlib
import hashlib
import os
import platform
from pathlib import Path


def compile_cache() -> Path | None:
    """Folder of compiled programs; None if ``JAXGROW_XLA_CACHE`` is ``off``.

    ``JAX_COMPILATION_CACHE_DIR`` or ``JAXGROW_XLA_CACHE`` choose another folder. By
    default there is one for each version of jaxlib and kind of processor, because
    programs compiled for another one may crash.
    """
    from importlib.metadata import version

    choice = os.environ.get("JAXGROW_XLA_CACHE")
    if choice == "off":
        return None
    choice = os.environ.get("JAX_COMPILATION_CACHE_DIR") or choice
    if choice:
        return Path(choice)
    processor = platform.machine() + platform.processor()
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor += next((line for line in lines if line.startswith("flags")), "")
    kind = hashlib.sha256(processor.encode()).hexdigest()[:8]
    return Path.home() / ".cache/jaxgrow/xla" / f"jaxlib-{version('jaxlib')}-{kind}"
