"""Speed against error: every row is a ratio in one run on one machine, with its error.

    python experiments/speed_error.py --quick             # under three minutes
    python experiments/speed_error.py                     # all, in full
    python experiments/speed_error.py --only pair-force-10k memory
    python experiments/speed_error.py --device cuda
    python experiments/speed_error.py --only --curves tolerance skin

Contenders are measured in turns (A B A B), five times at least (in quick mode what
takes long three times), with one thread each; ratios are medians over the repetitions,
with their quartiles. The yardsticks are those of `experiments/baselines.py`. Figures,
hardware and versions go to ``experiments/results/speed_error.json`` (to
``speed_error_cuda.json`` for a GPU); rows that are not measured again stay there if
they are of the same machine and versions. Where other work runs on the machine, look at
the ratios of processor seconds too.

A row is a function of `ROWS` that takes the options and yields one `Row` or more. The
points of work-precision curves are made of the axes in `speed.curves`; without names,
``--curves`` makes all of them.
"""

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from speed import ensemble_rows, force_rows, growth_rows, memory, relaxation_rows
from speed.curves import AXES, work_precision
from speed.measure import circumstances, configure, load, Options, Row


PATIENCE = 15.0
"""Seconds for a contender in quick mode, see `Options`."""

RESULTS = Path(__file__).parent / "results"

ROWS: dict[str, Callable[[Options], Iterator[Row]]] = {
    "pair-force-10k": force_rows.pair_force_10k,
    "pair-force-100k": force_rows.pair_force_100k,
    "contact-force": force_rows.contact_force,
    "relax-10k": relaxation_rows.relax_ball,
    "division": relaxation_rows.division,
    "grow": growth_rows.grow_free,
    "divisions-per-step": ensemble_rows.divisions_per_step,
    "ensemble": ensemble_rows.ensemble,
    "memory": memory.memory,
}


class Report:
    """The file of figures.

    Args:
        path: of it.
        circumstances: hardware and versions; rows of others are dropped.
    """

    def __init__(self, path: Path, circumstances: dict[str, Any]) -> None:
        self._path = path
        measured: dict[str, Any] = {"rows": {}, "curves": {}}
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


def describe(point: dict[str, Any]) -> str:
    """A point of a curve in a line."""
    errors = point["errors"]
    return (
        f"{point['axis']:10} {point['relaxer']:14} tolerance {point['tolerance']:.0e} "
        f"smoothing {point['smoothing']:g} {point['dtype']} skin {point['skin']:g}: "
        f"{point['seconds']['median']:.3g} s, residual {errors['residual']:.1e}, "
        f"position {errors['position_rms']:.1e}, "
        f"energy {errors['energy_relative']:.1e} {point['result']}"
    )


def main() -> None:
    """Measure the rows, print and write each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="under three minutes")
    parser.add_argument("--only", nargs="*", choices=ROWS, metavar="NAME", help="rows")
    parser.add_argument("--curves", nargs="*", choices=AXES, metavar="AXIS")
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
    configure(options)
    suffix = "" if options.device == "cpu" else f"_{options.device}"
    path = RESULTS / f"speed_error{suffix}.json"
    report = Report(path, circumstances(options))
    begin = time.perf_counter()
    for name in ROWS if given.only is None else given.only:
        start, busy = time.perf_counter(), load()
        for row in ROWS[name](options):
            spent = time.perf_counter() - start
            print(row, flush=True)
            more = {"quick": options.quick, "load": busy, "seconds_in_all": spent}
            report.add("rows", row.name, {**row.as_entries(), **more})
    axes = given.curves if given.curves else AXES
    for axis in axes if given.curves is not None else ():
        points = list(work_precision(axis, options))
        for point in points:
            print(describe(point), flush=True)
        report.add("curves", axis, points)
    print(f"{time.perf_counter() - begin:.0f} s; figures in {path}")


if __name__ == "__main__":
    main()
