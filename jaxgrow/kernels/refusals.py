"""Why compiled loops are not used, and what to do about it."""

from typing import NamedTuple

from jaxgrow.runtime.slow_path import warn_once


class Refusal(NamedTuple):
    """A reason not to use compiled loops.

    Attributes:
        reason: what is in the way.
        remedy: what to do; None if nobody wants them.
    """

    reason: str
    remedy: str | None

    def say(self) -> None:
        """Warn of it once, unless it is what the user asked for."""
        if self.remedy is not None:
            warn_once(
                f"compiled loops are not used, because {self.reason}; growths take up "
                f"to four times longer. To use them, {self.remedy}."
            )


def said(error: BaseException) -> str:
    """First line of what an error says, shortened, with the name of its class."""
    lines = str(error).strip().splitlines()
    text = f"{type(error).__name__}: {lines[0].strip()}" if lines else repr(error)
    return text if len(text) <= 200 else text[:197] + "..."
