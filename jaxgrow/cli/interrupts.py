"""Reliable handling of Ctrl-C, also during garbage collection."""

import contextlib
import gc
import signal
import threading
from collections.abc import Iterator
from types import FrameType


AGAIN = 0.02
"""Seconds until an interrupt is raised again."""


@contextlib.contextmanager
def heard_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt for every SIGINT within the block.

    Python ignores exceptions in callbacks of its garbage collector. JAX has such a
    callback (jax/_src/lib/__init__.py, ``_xla_gc_callback``), and signals are often
    handled just there, so about every third Ctrl-C would be lost. To be removed when
    JAX has no Python function among ``gc.callbacks``.

    Nothing is changed outside of the main thread, or if SIGINT has another handler than
    Python's default.
    """
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):
        yield
        return
    signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, or do so after `AGAIN` if it would be ignored."""
    deaf = {getattr(callback, "__code__", None) for callback in gc.callbacks}
    while frame is not None:
        if frame.f_code in deaf:
            later = threading.Timer(AGAIN, signal.raise_signal, [number])
            later.daemon = True
            later.start()
            return
        frame = frame.f_back
    raise KeyboardInterrupt
