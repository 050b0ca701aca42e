"""Row: peak memory at 100 000 particles, in a process of its own.

    python -m speed.memory jaxgrow 100000

relaxes a jittered dense ball for a few steps, lists included, and prints the peak after
the imports and at the end, in GB.
"""

import argparse
import json
import resource
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .apart import apart
from .measure import configure, Options, Row


STEPS = 30
"""Enough for the lists to be made anew, where memory peaks."""

GB = 1e9


def peak() -> float:
    """Largest resident memory of this process so far, in GB.

    By the memory map where the system shows it: the other counter is inherited.
    """
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / GB
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / GB


def _jaxgrow(position: Any) -> None:
    import jaxgrow as jg

    from .scenes import particles_of

    jg.relax(particles_of(position), tolerance=1e-9, method="lbfgs", max_steps=STEPS)


def _numba(position: Any) -> None:
    from .lbfgs import relax_lbfgs

    relax_lbfgs(position, tolerance=1e-9, max_steps=STEPS)


def _jax_md(position: Any) -> None:
    from .fire import relax_jax_md

    relax_jax_md(position, tolerance=1e-9, max_steps=STEPS)


CONTENDERS = {"jaxgrow": _jaxgrow, "numba": _numba, "jax-md": _jax_md}


def memory(options: Options) -> Iterator[Row]:
    """Peak of the whole process at 100 000 particles, in GB."""
    count = 100_000
    names = ["jaxgrow"] if options.quick else list(CONTENDERS)
    repetitions = 1 if options.quick else 3
    device = "--device", options.device, "--threads", options.threads
    peaks = {
        name: [apart("memory", name, count, *device) for _ in range(repetitions)]
        for name in names
    }
    yield Row(
        "memory-100k",
        "peak memory of the process at 100k particles, in GB",
        [found["end"] for found in peaks["jaxgrow"]],
        bar=1.0,
        details={"particles": count, "peaks_in_gb": peaks},
    )


def main() -> None:
    """Relax in this process, print its peaks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=CONTENDERS)
    parser.add_argument("count", type=int)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    configure(Options(device=given.device, threads=given.threads))
    from .scenes import dense_ball

    position = dense_ball(given.count, np.random.default_rng(0))
    before = peak()
    CONTENDERS[given.name](position)
    print(json.dumps({"imports": before, "end": peak()}))


if __name__ == "__main__":
    main()
