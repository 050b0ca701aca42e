"""Wall-clock seconds by phase of a growth."""

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager


class Clock:
    """Timer of phases: seconds in all, and since the last record.

    Attributes:
        total: seconds of every phase since the start.
        recent: since the last `lap`.
    """

    def __init__(self) -> None:
        self._start = time.perf_counter()
        self.total: defaultdict[str, float] = defaultdict(float)
        self.recent: defaultdict[str, float] = defaultdict(float)

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the duration of the block to a phase."""
        start = time.perf_counter()
        yield
        spent = time.perf_counter() - start
        self.total[name] += spent
        self.recent[name] += spent

    def lap(self) -> dict[str, float]:
        """Return the seconds by phase since the last lap, and restart it."""
        recent = dict(self.recent)
        self.recent.clear()
        return recent

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self._start
