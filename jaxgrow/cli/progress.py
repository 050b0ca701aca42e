"""Progress display: a live bar on a terminal, sparse lines elsewhere."""

from __future__ import annotations

import math
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress as Bar, SpinnerColumn, TextColumn


if TYPE_CHECKING:
    from jaxgrow.growth.progress import Progress


PREPARING = "preparing the tissue"
"""Text before the first division."""

LINE_EVERY = 0.1
"""Share of the growth after which a further line is written without a terminal."""

LINE_SECONDS = 30.0
"""Seconds without a line after which one is written in any case."""


class ProgressDisplay:
    """Display of divisions, size and target size, residual and time left.

    A context manager, and the callable that `jaxgrow.grow` takes as `progress`.

    Args:
        console: to write to; a terminal gets a bar, anything else lines.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar: Bar | None = None
        self._way = _Way()
        self._written = (0.0, 0.0)
        if console.is_terminal:
            self._bar = Bar(
                SpinnerColumn(),
                BarColumn(bar_width=None),
                TextColumn("{task.description}"),
                console=console,
                transient=True,
            )
            self._task = self._bar.add_task(PREPARING, total=None)
        else:
            console.print(PREPARING, highlight=False)

    def __enter__(self) -> ProgressDisplay:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, progress: Progress) -> None:
        """Show the progress of a growth."""
        share = self._way.add(progress)
        text = describe(progress, self._way.seconds_left())
        if self._bar is not None:
            self._bar.update(self._task, total=1.0, completed=share, description=text)
            return
        last_share, last_seconds = self._written
        due = progress.seconds - last_seconds > LINE_SECONDS
        if due or share - last_share > LINE_EVERY or share >= 1.0:
            self._written = (share, progress.seconds)
            self._console.print(text, highlight=False, soft_wrap=True)


def describe(progress: Progress, seconds_left: float | None) -> str:
    """Format the progress of a growth as one line."""
    if progress.target_mm is None:
        divisions = f"{progress.divisions} of {progress.target_divisions} divisions"
        size = f"{progress.size_mm:.1f} mm"
    else:
        divisions = f"{progress.divisions} divisions"
        size = f"{progress.size_mm:.1f} of {progress.target_mm:g} mm"
    parts = [
        divisions,
        size,
        f"{progress.share:.0%}",
        f"residual {progress.residual:.0e}",
    ]
    if seconds_left is not None:
        parts.append(f"{clock(seconds_left)} left")
    return ", ".join(parts)


def clock(seconds: float) -> str:
    """Format seconds as m:ss or h:mm:ss."""
    minutes, rest = divmod(math.ceil(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


class _Way:
    """Completed share of a growth, and an estimate of the time left.

    The elapsed time is modelled as a power of the completed share. The exponent is
    fitted to two points, half of the present share and the present one, and clipped to
    1 to 4: a finger's length grows with the number of divisions (1), a ball's diameter
    with its cube root (3), and each division costs more than the one before.
    """

    def __init__(self) -> None:
        self._trail: list[tuple[float, float]] = []

    def add(self, progress: Progress) -> float:
        share = min(max(progress.share, 0.0), 1.0)
        self._trail.append((share, progress.seconds))
        return share

    def seconds_left(self) -> float | None:
        """Estimate the time left; None as long as there are too few points."""
        share, seconds = self._trail[-1]
        if share <= 0.05 or len(self._trail) < 5:
            return None
        start = self._trail[0][1]
        half, then = min(self._trail, key=lambda point: abs(point[0] - share / 2))
        exponent = 2.0
        if 0 < half < share and start < then < seconds:
            exponent = math.log((seconds - start) / (then - start))
            exponent /= math.log(share / half)
        exponent = min(max(exponent, 1.0), 4.0)
        return (seconds - start) * (share**-exponent - 1.0)
