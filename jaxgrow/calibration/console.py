"""Progress and results of a fit on the terminal."""

import math
import sys

from rich.console import Console
from rich.table import Table

from jaxgrow.calibration.evaluations import Evaluation
from jaxgrow.calibration.outcome import Fit
from jaxgrow.calibration.search import End, Tried


def say_tried(tried: Tried) -> None:
    """Print one line for an evaluation on standard error."""
    values = ", ".join(f"{value:.4g}" for value in tried.values)
    what = f"loss {tried.loss:.4g}" if tried.failure is None else tried.failure
    kept = ", accepted" if tried.accepted and tried.number else ""
    line = f"evaluation {tried.number} ({tried.how}): {values}: {what}{kept}"
    print(line, file=sys.stderr, flush=True)  # noqa: T201  (the command's progress)


def say_grown(measured: Evaluation) -> None:
    """Print one line for a growth on standard error."""
    line = f"  seed {measured.seed}: {measured.result}"
    print(line, file=sys.stderr, flush=True)  # noqa: T201  (the command's own output)


def show(fit: Fit) -> None:
    """Print the parameters, the targets and the reasons for missed ones.

    "achieved" is the mean at the fitted parameters as estimated from the lesions of all
    evaluations, "grown" the mean of the few that were grown with them.
    """
    console = Console(highlight=False)
    table = Table("parameter", "fitted", "one deviation", "of targets", "of seeds")
    for name, fitted in fit.parameters.items():
        doubt = "" if fitted.determined else " (not determined by the targets)"
        known = math.isfinite(fitted.from_seeds)
        table.add_row(
            name + doubt,
            f"{fitted.value:.4g}",
            f"{fitted.low:.4g} to {fitted.high:.4g}" if known else "unknown",
            f"± {fitted.from_targets:.2g}",
            f"± {fitted.from_seeds:.2g}" if known else "unknown: one seed",
        )
    console.print(table)
    table = Table("target", "asked for", "achieved", "grown", "one lesion", "reached")
    for name, target in fit.targets.items():
        table.add_row(
            name,
            f"{target.target:.4g} ± {target.uncertainty:.2g}",
            f"{target.achieved:.4g}",
            f"{target.grown:.4g}",
            f"± {target.spread:.2g}" if math.isfinite(target.spread) else "",
            "yes" if target.reached else f"off by {abs(target.residual):.1f} ±",
        )
    console.print(table)
    for target in fit.targets.values():
        if target.reason is not None:
            console.print(target.reason, soft_wrap=True)
    if fit.end is End.EXHAUSTED:
        console.print("The search did not come to its end; deviations are too small.")
    console.print(
        f"loss {fit.loss:.4g} after {len(fit.history)} evaluations, "
        f"{len(fit.growths)} growths ({len(fit.failures)} evaluations failed). "
        f"{fit.end.value}",
        soft_wrap=True,
    )
