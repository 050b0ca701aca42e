"""Ensemble of growths, each in a worker process."""

import itertools
import operator
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from threading import Thread
from typing import Any

import jax

from jaxgrow.energy.parameters import Parameters
from jaxgrow.ensemble.worker_pool import borrow, ENDING_SECONDS, give_back, quiet
from jaxgrow.equilibrium.transformations import is_differentiated
from jaxgrow.growth.events import numbers
from jaxgrow.growth.grow import grow
from jaxgrow.growth.result import Growth
from jaxgrow.scene.scene import Scene


def grow_many(
    scene: Scene,
    *,
    seeds: Iterable[int],
    parameters: Parameters | Sequence[Parameters] | None = None,
    processes: int | None = None,
    finished: Callable[[Growth], None] | None = None,
    **options: Any,
) -> tuple[Growth, ...]:
    """Grow a lesion for each seed, several at the same time.

    A growth is a chain of small programs that uses one core, so members run in several
    processes, this one among them; in one batched program every member would rebuild
    its lists whenever one has to. A member is bit for bit what `grow` returns for its
    seed in a process with one thread. Worker processes take some seconds to start and a
    gigabyte each, and share compiled programs through the cache on disk: the one that
    JAX is configured with, or else that of the command. Each takes a member as soon as
    it is idle. They wait five minutes for the next call, which then reuses them.

    Workers import the script that started them, as always with Python's
    `multiprocessing`. So it must be a file, with the code that must not be repeated
    under a guard; notebooks need none::

        if __name__ == "__main__":
            lesions = jg.grow_many(scene, seeds=range(8))

    On an accelerator, which they would have to share, members are grown one after the
    other in this process. An exception of a member or of `finished` ends all members.

    Args:
        scene: the lesion and its surroundings.
        seeds: one for each member.
        parameters: of all members, or one for each; the scene's if None.
        processes: number of processes, this one included; one for each core if None.
        finished: called in this process with every finished member, in any order; for
            a worker's, after the next division of this process's member.
        **options: of `grow`: tolerance, max_divisions, max_seconds.

    Returns:
        The growths, in the order of the seeds.

    Raises:
        TypeError: a seed or the number of processes is not an integer, or an option is
            unknown.
        ValueError: there is not one set of parameters for each seed, the number of
            processes is not positive, a derivative is taken (take it of `grow`), or
            `grow` raises it.
        OrganError: the organ or the site cannot be used.
        RuntimeError: a process was killed, mostly for lack of memory, or none could
            start because the script has no guard, or is not a file.
    """
    seeds = [_whole(seed, "a seed") for seed in seeds]
    if is_differentiated(scene.parameters):
        raise ValueError(_NO_DERIVATIVE)
    each = _one_for_each(seeds, parameters)
    unknown = set(options) - {"tolerance", "max_divisions", "max_seconds"}
    if unknown:
        raise TypeError(
            f"grow_many got {sorted(unknown)}; of grow's options it takes tolerance, "
            "max_divisions and max_seconds."
        )
    if processes is None:
        processes = _cores() if jax.default_backend() == "cpu" else 1
    processes = _whole(processes, "processes")
    if processes < 1:
        raise ValueError(f"processes is {processes}; it must be at least 1.")
    members = list(zip(seeds, each, strict=True))
    if min(processes, len(members)) <= 1:
        return tuple(_told(_grow(scene, *m, options), finished) for m in members)
    others = borrow(min(processes, len(members)) - 1)
    shared = _Shared(members, finished)
    threads = [
        Thread(
            target=shared.hand_out,
            args=(shared.waiting.popleft(), others.pool, scene, options),
            daemon=True,
        )
        for _ in range(others.count)
    ]
    try:
        with quiet():
            for thread in threads:
                thread.start()
            # this process grows members too, and checks on the workers after every
            # division
            shared.take(scene, {**options, "progress": lambda _: shared.look()})
            for thread in threads:
                while thread.is_alive():
                    thread.join(0.1)
                    shared.look()
        shared.look()
    except BaseException as error:
        shared.waiting.clear()
        others.end()
        # a thread that still ran as Python exits could leave a semaphore of the pool
        for thread in threads:
            if thread.ident is not None:
                thread.join(ENDING_SECONDS)
        if isinstance(error, BrokenProcessPool):
            raise RuntimeError(others.why_broken()) from error
        raise
    give_back(others)
    return tuple(shared.grown[number] for number in range(len(members)))


class _Shared:
    """Queue of members that several processes take from as each is idle.

    Args:
        members: seeds and parameters.
        finished: called by this process's main thread.
    """

    def __init__(
        self,
        members: list[tuple[int, Parameters | None]],
        finished: Callable[[Growth], None] | None,
    ) -> None:
        self.waiting = deque(enumerate(members))
        self.grown: dict[int, Growth] = {}
        self._finished = finished
        self._told: set[int] = set()
        self._error: BaseException | None = None

    def hand_out(
        self,
        first: tuple[int, tuple[int, Parameters | None]],
        pool: ProcessPoolExecutor,
        scene: Scene,
        options: dict[str, Any],
    ) -> None:
        """Let a worker grow this member and others, one by one, in a thread."""
        try:
            for number, member in itertools.chain([first], self._rest()):
                future = pool.submit(_grow, scene, *member, options)
                self.grown[number] = future.result()
        # any exception is raised by the main thread
        except BaseException as error:
            self._error = self._error or error

    def take(self, scene: Scene, options: dict[str, Any]) -> None:
        """Grow members in this process."""
        for number, member in self._rest():
            self.grown[number] = _grow(scene, *member, options)
            self.look()

    def look(self) -> None:
        """Report finished members; raise the exception of a worker."""
        if self._error is not None:
            raise self._error
        for number in sorted(self.grown.keys() - self._told):
            self._told.add(number)
            _told(self.grown[number], self._finished)

    def _rest(self) -> Iterator[tuple[int, tuple[int, Parameters | None]]]:
        """Yield the members that no process has taken yet."""
        while True:
            try:
                yield self.waiting.popleft()
            except IndexError:
                return


_NO_DERIVATIVE = (
    "a derivative does not go through grow_many; take that of grow, seed by seed."
)


def _whole(number: Any, what: str) -> int:
    """Convert a Python or NumPy integer; raise for other numbers."""
    try:
        return operator.index(number)
    except TypeError as error:
        raise TypeError(f"{what} is {number!r}; give a whole number.") from error


def _one_for_each(
    seeds: list[int], parameters: Parameters | Sequence[Parameters] | None
) -> list[Parameters | None]:
    """Return the parameters of every member as numbers.

    Tracers cannot be sent to other processes.
    """
    if parameters is None:
        return [None] * len(seeds)
    given = parameters
    if isinstance(given, Parameters):
        given = [given] * len(seeds)
    if len(given) != len(seeds):
        raise ValueError(
            f"there are {len(given)} parameters for {len(seeds)} seeds; give one for "
            "all, or one for each."
        )
    if any(is_differentiated(one) for one in given):
        raise ValueError(_NO_DERIVATIVE)
    return [numbers(one) for one in given]


def _grow(
    scene: Scene, seed: int, parameters: Parameters | None, options: dict[str, Any]
) -> Growth:
    return grow(scene, seed=seed, parameters=parameters, **options)


def _told(growth: Growth, finished: Callable[[Growth], None] | None) -> Growth:
    if finished is not None:
        finished(growth)
    return growth


def _cores() -> int:
    """Count the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
