"""Row: what passes before the first division, in a process of its own."""

import time
from collections.abc import Iterator
from typing import Any

import jax

from .apart import apart
from .measure import Options, Row


BAR = 2.0
"""Seconds."""


def started(options: Options) -> dict[str, Any]:
    """Figures of another process, which shares the programs on disk with this one."""
    environment = {
        "JAX_ENABLE_X64": "1",
        "JAX_PLATFORMS": options.device,
        "JAX_COMPILATION_CACHE_DIR": str(jax.config.jax_compilation_cache_dir),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    return apart("first_division", time.time(), environment=environment)


def start_up(options: Options) -> Iterator[Row]:
    """Seconds before the first division; the first process of all fills the cache."""
    started(options)
    found = [started(options) for _ in range(options.repetitions)]
    yield Row(
        "start-up",
        "seconds before the first division of a polyp, in a fresh process, programs on "
        "disk",
        [one["seconds"] for one in found],
        bar=BAR,
        seconds={
            part: [one[part] for one in found] for part in ("imports", "planting")
        },
        details={
            "programs_loaded": found[-1]["loaded"],
            "programs_compiled": max(one["compiled"] for one in found),
        },
    )
