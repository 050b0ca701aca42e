"""The table of hard cases: each converges, or is refused by name.

    python experiments/studies/hard_cases.py --processes 2

runs every case of `tests/hard/cases` in a process of its own, which may not take
longer than ``--seconds``, and writes ``experiments/results/hard_cases.json`` and the
table ``hard_cases.md`` beside it. ``--only NAME ...`` runs some again and keeps the
other rows of the table. The exit status is 0 if every outcome is the expected one.
"""

import argparse
import json
import os
import subprocess
import sys
from concurrent.futures import as_completed, ThreadPoolExecutor
from pathlib import Path
from typing import Any


os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # XLA:CPU cache loader noise

RESULTS = Path(__file__).parents[1] / "results" / "hard_cases.json"

MARK = "hard case: "
"""What the line with a row begins with, among whatever else a process prints."""


def run_here(name: str) -> dict[str, Any]:
    """One case in this process."""
    import jax
    from cases_of_tests import CASES, measure

    jax.config.update("jax_enable_x64", True)
    return measure(CASES[name]).as_dict()


def run_apart(name: str, seconds: float, threads: int) -> dict[str, Any]:
    """One case in a process of its own; a crash and a hang are outcomes too."""
    environment = dict(os.environ)
    if threads:
        environment["NPROC"] = str(threads)
    command = [sys.executable, __file__, "--here", name]
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            env=environment,
            check=False,
            timeout=seconds,
        )
    except subprocess.TimeoutExpired:
        return failure(name, "HANG", f"more than {seconds:g} s", seconds)
    for line in done.stdout.splitlines():
        if line.startswith(MARK):
            return json.loads(line.removeprefix(MARK))
    last = done.stderr.strip().splitlines()[-1:] or [f"status {done.returncode}"]
    return failure(name, "CRASH", last[0], 0.0)


def failure(name: str, outcome: str, why: str, seconds: float) -> dict[str, Any]:
    """The row of a case that did not come to an end."""
    from cases_of_tests import CASES, Found, Row

    case = CASES[name]
    wrong = f"{outcome.lower()}: {why}"
    found = Found(outcome)
    row = Row(name, case.about, case.expected, found, "", seconds, wrong)
    return row.as_dict()


def table(rows: list[dict[str, Any]]) -> str:
    """The rows in Markdown."""
    lines = [
        "| case | expected | outcome | steps | residual | penetrations | "
        "intersections | worst 2 r_in/r_circ | seconds |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        found = row["found"]
        outcome = found["outcome"]
        if row["sentence"]:
            outcome += f": {row['sentence']}"
        if row["wrong"]:
            outcome += f" (**{row['wrong']}**)"
        cells = [
            f"{row['name']}: {row['about']}",
            " or ".join(row["expected"]),
            outcome,
            str(found["steps"]),
            number(found["residual"], ".1e"),
            str(found["penetrations"]),
            str(found["intersections"]),
            number(found["quality"], ".2g"),
            number(row["seconds"], ".1f"),
        ]
        lines.append("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |")
    return "\n".join(lines)


def number(value: float | None, form: str) -> str:
    """A number, or a dash where there is none."""
    return "–" if value is None else format(value, form)


def main() -> int:
    """Run the cases, write the table, say what is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", metavar="NAME", help="run only these")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=1800.0, help="at most, a case")
    parser.add_argument("--fast", action="store_true", help="leave out the slow cases")
    parser.add_argument(
        "--together",
        action="store_true",
        help="in one process: faster, as programs are compiled once; no --seconds",
    )
    parser.add_argument("--here", metavar="NAME", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.here:
        print(MARK + json.dumps(run_here(options.here)))
        return 0

    from cases_of_tests import CASES

    names = options.only or [
        c.name for c in CASES.values() if not (options.fast and c.slow)
    ]
    if unknown := set(names) - set(CASES):
        parser.error(f"unknown: {', '.join(sorted(unknown))}")
    rows = {}
    if RESULTS.exists() and options.only:
        rows = {row["name"]: row for row in json.loads(RESULTS.read_text())}
    threads = 1 if options.processes > 1 else 0
    with ThreadPoolExecutor(1 if options.together else options.processes) as pool:
        if options.together:
            jobs = [pool.submit(run_here, n) for n in names]
        else:
            jobs = [pool.submit(run_apart, n, options.seconds, threads) for n in names]
        for count, job in enumerate(as_completed(jobs), 1):
            row = job.result()
            rows[row["name"]] = row
            print(
                f"{count}/{len(jobs)} {row['name']}: {row['found']['outcome']}, "
                f"{row['seconds']:.1f} s {row['wrong']}",
                file=sys.stderr,
            )
    ordered = [rows[name] for name in CASES if name in rows]
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(ordered, indent=1) + "\n")
    RESULTS.with_suffix(".md").write_text(table(ordered) + "\n")
    print(table(ordered))
    return int(any(row["wrong"] for row in ordered))


if __name__ == "__main__":
    sys.exit(main())
