"""Processes that compute beside this one, kept for a while for whoever asks next.

One needs seconds to start: it imports JAX and loads compiled programs.
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
from typing import Any

import jax

from jaxgrow.runtime.compile_cache import keep_programs


KEPT_SECONDS = 300.0
"""How long processes wait for work before they end."""

_SETTINGS = (
    "jax_enable_x64",
    "jax_platforms",
    "jax_default_matmul_precision",
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)
"""What a process is told of how JAX is configured here."""


@dataclass(frozen=True, eq=False)
class Processes:
    """Processes with one thread each.

    Attributes:
        pool: takes their work.
        count: how many they are at most; they start as work comes.
        surroundings: settings of JAX and environment that they were started with.
        started: set as soon as one of them works.
    """

    pool: ProcessPoolExecutor
    count: int
    surroundings: tuple[dict[str, Any], dict[str, str]]
    started: Event

    def are_well(self) -> bool:
        """Whether none was ended from outside."""
        return not self.pool._broken and all(
            process.is_alive() for process in (self.pool._processes or {}).values()
        )

    def end(self) -> None:
        """End them without waiting for their work.

        To be ``pool.terminate_workers()`` once Python 3.14 is the oldest that is
        supported.
        """
        processes = list((self.pool._processes or {}).values())
        self.pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        for process in processes:
            process.join()

    def why_broken(self) -> str:
        """The sentence for one that is gone."""
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
    """So many processes, those that are kept if they are as new ones would be."""
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
    """Keep processes that have no work for a while."""
    global _kept
    end_kept()
    timer = Timer(KEPT_SECONDS, end_kept, (processes,))
    timer.daemon = True
    with _lock:
        _kept = processes, timer
    timer.start()


def end_kept(only: Processes | None = None) -> None:
    """End the processes that are kept without waiting for it; perhaps only these."""
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
    """Processes that start in the block leave out what XLA says of its cache.

    Where nobody has chosen a level, importing JAX has set it to 1, which shows that.
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
    """How JAX is configured here, with a folder of compiled programs."""
    keep_programs()
    return {name: getattr(jax.config, name) for name in _SETTINGS}


def _prepare(settings: dict[str, Any], started: Event) -> None:
    """Set a process up, before it computes anything."""
    started.set()
    Thread(target=_end_with_parent, daemon=True).start()
    # from the keyboard it reaches all processes, and may mean anything while they wait
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["NPROC"] = "1"  # threads of XLA
    for name, value in settings.items():
        jax.config.update(name, value)


def _end_with_parent() -> None:
    """End this process when the one that started it is gone, however it ended."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
