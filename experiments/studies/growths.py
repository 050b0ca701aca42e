"""The runs of the README's table, by the command that a user types.

    python experiments/studies/growths.py --out runs --organs organs --processes 2

grows a polyp and a myoma at three sizes each in the built-in uterus, and a polyp on
every organ that `experiments/studies/organs.py` exported to the folder ``organs``. It
writes every run's folder under ``--out``, the figures to
``experiments/results/growths.json``, and prints the table. With ``--only`` the figures
of the other runs stay as they are.
"""

import argparse
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path


RESULTS = Path(__file__).parents[1] / "results" / "growths.json"

UTERUS = {
    f"{kind}-{size}": ["--lesion", kind, "--size-mm", str(size), "--site", site]
    for kind, site, sizes in [("polyp", "fundus", (5, 10, 15)),
                              ("myoma", "posterior", (5, 8, 12))]
    for size in sizes
}  # fmt: skip

ELSEWHERE = {
    "frog-large-intestine": ["--site", "163.0,235.4,124.6", "--size-mm", "8"],
    "human-brain-left": [
        *["--site", "-35.0,-55.2,-20.6", "--size-mm", "12", "--tissue", "inside"],
    ],
}


def commands(organs: Path | None) -> dict[str, list[str]]:
    """Arguments of `jaxgrow grow` for every run, by its name."""
    runs = dict(UTERUS)
    if organs is not None:
        for name, arguments in ELSEWHERE.items():
            runs[name] = ["--organ", str(organs / f"{name}.ply"), *arguments]
    return runs


def run(name: str, arguments: list[str], out: Path, threads: int) -> dict[str, object]:
    """Grow once, audit the folder, and take the figures of its report."""
    folder = out / name
    environment = dict(os.environ)
    if threads:
        environment["NPROC"] = str(threads)
    command = [sys.executable, "-m", "jaxgrow"]
    done = subprocess.run(
        [*command, "grow", *arguments, "--out", str(folder)],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    audit = subprocess.run(
        [*command, "audit", str(folder)], capture_output=True, text=True, check=False
    )
    print(f"{name}: status {done.returncode}, {done.stdout or done.stderr}".strip())
    report = json.loads((folder / "report.json").read_text())
    residuals = [record["residual"] for record in report["history"]]
    steps = sorted(record["steps"] for record in report["history"])
    surface = report["audit"]["surface"]
    return {
        "name": name,
        "arguments": arguments,
        "status": done.returncode,
        "audit_status": audit.returncode,
        "defects": report["audit"]["defects"],
        "result": report["outcome"]["result"],
        "asked_mm": report["request"]["scene"]["lesion"]["target_mm"],
        "size_mm": report["outcome"]["size_mm"],
        "metrics": report["outcome"]["metrics"],
        "divisions": report["outcome"]["divisions"],
        "seconds": sum(report["seconds"].values()),
        "seconds_by_phase": report["seconds"],
        "largest_residual": max(residuals),
        "median_steps": steps[len(steps) // 2],
        "particles": report["counts"]["particles"],
        "quality_min": surface["quality_min"],
        "compilations": report["compilations"],
        "versions": report["versions"],
        "machine": report["machine"],
    }


def table(rows: list[dict[str, object]]) -> str:
    """The figures as a table in Markdown."""
    lines = [
        "| run | asked | reached | height | divisions | seconds | residual | "
        "worst 2 r_in/r_circ | audit |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        clean = "clean" if row["audit_status"] == 0 else str(row["defects"])
        lines.append(
            f"| {row['name']} | {row['asked_mm']:g} mm | {row['size_mm']:.1f} mm | "
            f"{row['metrics']['height_mm']:.1f} mm | {row['divisions']} | "
            f"{row['seconds']:.0f} | {row['largest_residual']:.1e} | "
            f"{row['quality_min']:.2f} | {clean} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run all, write the figures, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs"))
    parser.add_argument("--organs", type=Path)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--only", nargs="*", help="names of the runs")
    options = parser.parse_args()
    wanted = commands(options.organs)
    if options.only:
        wanted = {name: wanted[name] for name in options.only}
    threads = 1 if options.processes > 1 else 0
    with ThreadPoolExecutor(options.processes) as pool:
        jobs = [
            pool.submit(run, name, arguments, options.out, threads)
            for name, arguments in wanted.items()
        ]
        rows = [job.result() for job in jobs]
    known = json.loads(RESULTS.read_text()) if RESULTS.exists() else []
    found = {row["name"]: row for row in [*known, *rows]}
    rows = [found[name] for name in {**UTERUS, **ELSEWHERE} if name in found]
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(rows, indent=1) + "\n")
    print(table(rows))


if __name__ == "__main__":
    main()
