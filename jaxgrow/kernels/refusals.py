"""Reasons why compiled loops are not used, and their remedies."""

from typing import NamedTuple

from jaxgrow.runtime.slow_path import warn_once


class Refusal(NamedTuple):
    """Reason not to use compiled loops.

    Attributes:
        reason: the obstacle.
        remedy: the way to remove it; None if the user disabled the loops.
    """

    reason: str
    remedy: str | None

    def say(self) -> None:
        """Issue a warning, once, unless the user disabled the loops."""
        if self.remedy is not None:
            warn_once(
                f"compiled loops are not used, because {self.reason}; growths take up "
                f"to four times longer. To use them, {self.remedy}."
            )


def said(error: BaseException) -> str:
    """Format the first line of an error, shortened, with its class's name."""
    lines = str(error).strip().splitlines()
    text = f"{type(error).__name__}: {lines[0].strip()}" if lines else repr(error)
    return text if len(text) <= 200 else text[:197] + "..."
