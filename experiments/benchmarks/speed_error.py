"""Speed against error: every row is a ratio in one run on one machine, with its error.

    python speed_error.py --quick             # under three minutes
    python speed_error.py                     # all rows and curves, in full
    python speed_error.py --only pair-force-10k memory
    python speed_error.py --device cuda
    python speed_error.py --curves tolerance skin
    python speed_error.py --figures           # draw what was measured

It needs the extra "speed": pip install -e '.[speed]'.

Contenders are measured in turns (A B A B), five times at least (whole lesions, and in
quick mode what takes long, three times), with one thread each; ratios are medians over
the repetitions, with their quartiles. The yardsticks are those of
`experiments/benchmarks/baselines.py`. Figures, hardware and versions go to
``experiments/results/speed_error.json``, the table of rows to ``speed_error.md`` beside
it, and pictures to ``speed_error_*.png`` (`speed.figures`); for a GPU the names begin
with ``speed_error_cuda``. Rows that are not measured again stay there if they are of
the same machine and versions. What fails is named there with its reason, and the exit
status is 1 then; the rest is measured all the same. Where other work runs on the
machine, look at the ratios of processor seconds too.

A row is a function of `ROWS` that takes the options and yields one `Row` or more; a
curve is one of `CURVES` that yields its points. Without names, ``--only`` makes all
rows and ``--curves`` all curves (in quick mode those of `QUICK_ROWS` and
`QUICK_CURVES`); with one of both options, nothing else is made.
"""

import argparse
import json
import math
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from speed import (
    ensemble_rows,
    figures,
    force_rows,
    growth_rows,
    lesion_rows,
    memory,
    relaxation_rows,
    start_up,
)
from speed.curves import AXES, work_precision
from speed.measure import circumstances, configure, load, Options, Row
from speed.polyp_curves import POLYP_AXES
from speed.table import as_markdown


PATIENCE = 15.0
"""Seconds for a contender in quick mode, see `Options`."""

RESULTS = Path(__file__).parents[1] / "results"

ROWS: dict[str, Callable[[Options], Iterator[Row]]] = {
    "pair-force-10k": force_rows.pair_force_10k,
    "pair-force-100k": force_rows.pair_force_100k,
    "lists-10k": force_rows.lists_10k,
    "contact-force": force_rows.contact_force,
    "relax-10k": relaxation_rows.relax_ball,
    "division": relaxation_rows.division,
    "grow-100": partial(growth_rows.grow_free, 100),
    "grow-300": partial(growth_rows.grow_free, 300),
    "grow-1000": partial(growth_rows.grow_free, 1000),
    "grow-3000": partial(growth_rows.grow_free, 3000),
    "divisions-per-step": ensemble_rows.divisions_per_step,
    "ensemble": ensemble_rows.ensemble,
    "polyp-200": lesion_rows.polyp_200,
    "myoma-300": lesion_rows.myoma_300,
    "organ-1e5": lesion_rows.organ_1e5,
    "fairing": lesion_rows.fairing,
    "memory": memory.memory,
    "start-up": start_up.start_up,
}

CURVES: dict[str, Callable[[Options], Iterator[dict[str, Any]]]] = {
    **{axis: partial(work_precision, axis) for axis in AXES},
    **POLYP_AXES,
}

QUICK_ROWS = [
    "pair-force-10k",
    "pair-force-100k",
    "contact-force",
    "grow-100",
    "polyp-200",
    "memory",
    "start-up",
]
"""Rows of quick mode, if none is named: those that take seconds."""

QUICK_CURVES = ["tolerance"]
"""Curves of quick mode, if none is named."""


class Report:
    """The file of figures.

    Args:
        path: of it.
        circumstances: hardware and versions; rows of others are dropped.
    """

    def __init__(self, path: Path, circumstances: dict[str, Any]) -> None:
        self._path = path
        measured: dict[str, Any] = {"rows": {}, "curves": {}, "failures": {}}
        if path.exists():
            before = json.loads(path.read_text())
            kept = {part: before.pop(part, {}) for part in measured}
            if before == circumstances:
                measured = kept
        self._content = {**circumstances, **measured}

    def add(self, part: str, name: str, figures: Any) -> None:
        """Write a row or a curve at once: an interrupted run keeps what it has."""
        self._content[part][name] = figures
        self._path.parent.mkdir(exist_ok=True)
        self._path.write_text(json.dumps(self._content, indent=1) + "\n")

    def remove(self, part: str, name: str) -> None:
        """Forget a row, a curve or a failure, if it is there."""
        self._content[part].pop(name, None)

    def draw(self) -> None:
        """Write the table and the pictures of all that is there."""
        publish(self._content, self._path)


def publish(content: dict[str, Any], path: Path) -> None:
    """Write the table and the pictures.

    Args:
        content: of the file of figures.
        path: of that file; the others get its name.
    """
    path.with_suffix(".md").write_text(as_markdown(content) + "\n")
    for picture in figures.draw(content, path):
        print(f"drawn: {picture}")


def describe(point: dict[str, Any]) -> str:
    """A point of a curve in a line."""
    errors = point["errors"]
    return (
        f"{point['axis']:17} {point['relaxer']:14} tolerance {point['tolerance']:.0e} "
        f"smoothing {point['smoothing']:g} {point['dtype']} skin {point['skin']:g} "
        f"sharpness {point['sharpness']:g}: "
        f"{point['seconds']['median']:.3g} s, residual {errors['residual']:.1e}, "
        f"position {errors['position_rms']:.1e}, "
        f"energy {errors['energy_relative']:.1e} {point['result']}"
    )


def chosen(given: argparse.Namespace) -> tuple[list[str], list[str]]:
    """Names of the rows and of the curves to measure."""
    rows = QUICK_ROWS if given.quick else list(ROWS)
    curves = QUICK_CURVES if given.quick else list(CURVES)
    if given.only is None and given.curves is None:
        return rows, curves
    return (
        [] if given.only is None else given.only or rows,
        [] if given.curves is None else given.curves or curves,
    )


def measure_row(name: str, options: Options, report: Report) -> None:
    """Measure rows of a name; print and write each."""
    start, busy = time.perf_counter(), load()
    for row in ROWS[name](options):
        spent = time.perf_counter() - start
        print(row, flush=True)
        more = {"quick": options.quick, "load": busy, "seconds_in_all": spent}
        report.add("rows", row.name, {**row.as_entries(), **more})


def measure_curve(axis: str, options: Options, report: Report) -> None:
    """Measure a curve, print its points and write them."""
    start = time.perf_counter()
    points = list(CURVES[axis](options))
    for point in points:
        print(describe(point), flush=True)
    print(f"{axis}: {time.perf_counter() - start:.0f} s in all", flush=True)
    report.add("curves", axis, points)


def main() -> None:
    """Measure rows and curves, print and write each; then the table and pictures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="under three minutes")
    parser.add_argument(
        "--only", nargs="*", choices=ROWS, metavar="NAME", help=", ".join(ROWS)
    )
    parser.add_argument(
        "--curves", nargs="*", choices=CURVES, metavar="AXIS", help=", ".join(CURVES)
    )
    parser.add_argument("--figures", action="store_true", help="measure nothing, draw")
    parser.add_argument("--device", default="cpu", help="platform of jax: cpu, cuda")
    parser.add_argument("--threads", type=int, default=1, help="of XLA; 0 for all")
    parser.add_argument("--repetitions", type=int, default=5)
    given = parser.parse_args()
    options = Options(
        quick=given.quick,
        repetitions=given.repetitions,
        device=given.device,
        threads=given.threads,
        patience=PATIENCE if given.quick else math.inf,
    )
    suffix = "" if options.device == "cpu" else f"_{options.device}"
    path = RESULTS / f"speed_error{suffix}.json"
    if given.figures:
        publish(json.loads(path.read_text()), path)
        return
    configure(options)
    report = Report(path, circumstances(options))
    begin = time.perf_counter()
    rows, curves = chosen(given)
    measure = {
        **{name: partial(measure_row, name, options, report) for name in rows},
        **{axis: partial(measure_curve, axis, options, report) for axis in curves},
    }
    failed = []
    for name, call in measure.items():
        report.remove("failures", name)
        try:
            call()
        # what one of them runs into, such as too little memory, is not the others'
        except Exception as error:
            failed.append(name)
            why = (str(error).strip().splitlines() or [type(error).__name__])[0]
            report.add("failures", name, f"{type(error).__name__}: {why}")
            traceback.print_exc()
    report.draw()
    print(f"{time.perf_counter() - begin:.0f} s; figures in {path}")
    if failed:
        sys.exit(f"not measured: {', '.join(failed)}")


if __name__ == "__main__":
    main()
