"""Count of the programs that XLA compiles, and their eviction from memory."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import jax


_EVENT = "/jax/core/compile/backend_compile_duration"


@dataclass
class Compilations:
    """Running count of compiled programs."""

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


_MAPPED = Path("/proc/self/maps")
_MOST_MAPPED = Path("/proc/sys/vm/max_map_count")


_left = 0
"""Regions that this process still mapped when programs were last dropped."""


def forget_compiled(share: float = 0.5) -> bool:
    """Drop compiled programs near the limit of memory mappings.

    A program maps three regions of memory for each of its loops, a relaxation a
    thousand. At the limit (usually 65 530) XLA aborts, or crashes later, when an
    exception is unwound. A dropped program that is needed again is recompiled, or
    loaded from the cache on disk; a differentiation in progress is not affected.
    Regions that stay mapped, by other libraries or programs in use, do not trigger
    another drop.

    Args:
        share: of the limit that must be exceeded, both without what was left last time.

    Returns:
        Whether they were dropped; always False where ``/proc`` is missing.
    """
    global _left
    if not (_MAPPED.exists() and _MOST_MAPPED.exists()):
        return False
    mapped, limit = _mapped(), int(_MOST_MAPPED.read_text())
    _left = min(_left, mapped)
    if mapped - _left <= share * max(limit - _left, 0):
        return False
    jax.clear_caches()
    gc.collect()
    _left = _mapped()
    return True


def _mapped() -> int:
    """Count the memory regions that this process maps."""
    return _MAPPED.read_bytes().count(b"\n")


_OFTEN = 16
"""Iterations between two checks, each of which takes some milliseconds."""


def forget_now_and_then(iterations: int) -> None:
    """Call `forget_compiled` once every few iterations."""
    if iterations % _OFTEN == 0:
        forget_compiled()
