"""Counting the programs that XLA compiles, or loads from the cache on disk."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import jax


_EVENT = "/jax/core/compile/backend_compile_duration"


@dataclass
class Compilations:
    """A running count of compiled programs."""

    count: int = 0


@contextmanager
def count_compilations() -> Iterator[Compilations]:
    """Count the programs compiled within the block."""
    seen = Compilations()

    def listen(event: str, duration_secs: float, **_: str | int) -> None:
        del duration_secs
        if event == _EVENT:
            seen.count += 1

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield seen
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
