"""Which path the descents of a growth ran on: compiled loops, or programs of XLA."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass
class Descents:
    """A running count of descents by L-BFGS, which there are loops for.

    Attributes:
        by_loop: that ran as one compiled loop.
        by_program: that XLA ran, several times slower.
        reason: why the last of these was not run by the loop; None if none.
        terms: how each term of the energy was evaluated, by "loop" or by "XLA".
    """

    by_loop: int = 0
    by_program: int = 0
    reason: str | None = None
    terms: dict[str, str] = field(default_factory=dict)

    def entry(self) -> dict[str, Any]:
        """What a report says of it: whether loops ran, how often, and why not."""
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
