"""Count of descents by path: compiled loop, or program of XLA."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass
class Descents:
    """Running count of L-BFGS descents by the path they ran on.

    Attributes:
        by_loop: number that ran as one compiled loop.
        by_program: number that XLA ran, several times slower.
        reason: why the last of these was not run by the loop; None if none.
        terms: how each term of the energy was evaluated, by "loop" or by "XLA".
    """

    by_loop: int = 0
    by_program: int = 0
    reason: str | None = None
    terms: dict[str, str] = field(default_factory=dict)

    def entry(self) -> dict[str, Any]:
        """Return the entry of a report: whether loops ran, how often, why not."""
        return {"ran": self.by_loop > 0 and self.by_program == 0, **asdict(self)}


_counting: ContextVar[Descents | None] = ContextVar("_counting", default=None)


@contextmanager
def count_descents() -> Iterator[Descents]:
    """Count the descents within the block."""
    seen = Descents()
    token = _counting.set(seen)
    try:
        yield seen
    finally:
        _counting.reset(token)


def note_descent(why_not: str | None, terms: dict[str, str]) -> None:
    """Count a descent that is about to run.

    Args:
        why_not: why it is not run by the loop; None if it is.
        terms: how each term of the energy is evaluated.
    """
    seen = _counting.get()
    if seen is None:
        return
    seen.terms |= terms
    if why_not is None:
        seen.by_loop += 1
    else:
        seen.by_program += 1
        seen.reason = why_not
