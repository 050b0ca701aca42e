"""Pool of worker processes, kept for some minutes for the next call.

A worker takes seconds to start: it imports JAX and loads compiled programs.
"""

import os
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.synchronize import Event
from pathlib import Path
from threading import Lock, Thread, Timer
from typing import Any, cast

import jax

from jaxgrow.runtime.compile_cache import keep_programs


KEPT_SECONDS = 300.0
"""Seconds that idle workers are kept."""

ENDING_SECONDS = 10.0
"""Longest wait for a thread of a pool that ends."""

_SETTINGS = (
    "jax_enable_x64",
    "jax_platforms",
    "jax_default_matmul_precision",
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)
"""Settings of JAX that are passed to a worker."""


@dataclass(frozen=True, eq=False)
class Processes:
    """Worker processes with one thread each.

    Attributes:
        pool: executor of their tasks.
        count: largest number of workers; they start on demand.
        surroundings: settings of JAX and environment that they were started with.
        started: set as soon as one of them works.
    """

    pool: ProcessPoolExecutor
    count: int
    surroundings: tuple[dict[str, Any], dict[str, str]]
    started: Event

    def are_well(self) -> bool:
        """Return whether no worker has exited."""
        return not self.pool._broken and all(
            process.is_alive() for process in (self.pool._processes or {}).values()
        )

    def end(self) -> None:
        """Terminate the workers without waiting for their tasks.

        To be ``pool.terminate_workers()`` once Python 3.14 is the oldest that is
        supported.
        """
        processes = list((self.pool._processes or {}).values())
        manager = cast(Thread | None, self.pool._executor_manager_thread)
        self.pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        for process in processes:
            process.join()
        if manager is not None:
            manager.join(ENDING_SECONDS)

    def why_broken(self) -> str:
        """Return the message for a worker that exited."""
        if self.started.is_set():
            return (
                "a process of grow_many ended without an answer, mostly for want of "
                "memory; ask for fewer processes."
            )
        script = getattr(sys.modules["__main__"], "__file__", None)
        if script is not None and not Path(script).exists():
            return (
                "no process of grow_many could start, because each imports the script "
                f"anew, and {script} is no file; write the script to one."
            )
        return (
            "no process of grow_many could start, because each imports the script "
            'anew; call grow_many under if __name__ == "__main__": there.'
        )


_lock = Lock()
_kept: tuple[Processes, Timer] | None = None


def borrow(count: int) -> Processes:
    """Return a pool of workers, reusing the kept one if it is equivalent."""
    surroundings = _settings(), dict(os.environ)
    found = _take()
    if found is not None:
        as_new = found.count == count and found.surroundings == surroundings
        if as_new and found.are_well():
            return found
        found.pool.shutdown(wait=False)
    context = get_context("spawn")
    started = context.Event()
    pool = ProcessPoolExecutor(count, context, _prepare, (surroundings[0], started))
    return Processes(pool, count, surroundings, started)


def give_back(processes: Processes) -> None:
    """Keep idle workers for a while."""
    global _kept
    end_kept()
    timer = Timer(KEPT_SECONDS, end_kept, (processes,))
    timer.daemon = True
    with _lock:
        _kept = processes, timer
    timer.start()


def end_kept(only: Processes | None = None) -> None:
    """Shut the kept workers down without waiting; optionally only these."""
    found = _take(only)
    if found is not None:
        found.pool.shutdown(wait=False)


def _take(only: Processes | None = None) -> Processes | None:
    global _kept
    with _lock:
        if _kept is None or only not in (None, _kept[0]):
            return None
        (found, timer), _kept = _kept, None
    timer.cancel()
    return found


_LOG_LEVEL = "TF_CPP_MIN_LOG_LEVEL"


@contextmanager
def quiet() -> Iterator[None]:
    """Silence XLA's messages on its cache in workers started in the block.

    Unless the user chose a level, importing JAX has set it to 1, which shows these.
    """
    own = os.environ.get(_LOG_LEVEL)
    if own in (None, "1"):
        os.environ[_LOG_LEVEL] = "3"
    try:
        yield
    finally:
        if own is None:
            os.environ.pop(_LOG_LEVEL, None)
        else:
            os.environ[_LOG_LEVEL] = own


def _settings() -> dict[str, Any]:
    """Return JAX's configuration here, with a cache folder set."""
    keep_programs()
    return {name: getattr(jax.config, name) for name in _SETTINGS}


def _prepare(settings: dict[str, Any], started: Event) -> None:
    """Configure a worker before it computes anything."""
    started.set()
    Thread(target=_end_with_parent, daemon=True).start()
    # ignore Ctrl-C, which reaches all processes, also while they are idle
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["NPROC"] = "1"  # threads of XLA
    for name, value in settings.items():
        jax.config.update(name, value)


def _end_with_parent() -> None:
    """Exit when the parent process has exited for any reason."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
