"""Measuring in turns, rows with their bars, and what they were measured on."""

import math
import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import numba

from jaxgrow.io.report import versions
from jaxgrow.runtime.compile_cache import keep_programs


FEWEST = 3
"""Repetitions of what takes longer than is waited for."""

PATIENCE = 200.0
"""Seconds after which what takes minutes is not measured again."""

SHORTEST = 0.05
"""Seconds that a measurement lasts at least; what is faster is repeated within it."""


@dataclass(frozen=True)
class Options:
    """How a row is measured.

    Attributes:
        quick: small scenes, for all rows within three minutes.
        repetitions: of every measurement, at least five.
        patience: seconds after which a contender is not measured again.
        fewest: repetitions of it in any case.
        device: platform of jaxgrow's computations.
        threads: that XLA may use; 0 for all.
    """

    quick: bool = False
    repetitions: int = 5
    device: str = "cpu"
    threads: int = 1
    patience: float = math.inf
    fewest: int = FEWEST

    def limited(self, fewest: int = FEWEST) -> "Options":
        """The same for contenders that may take minutes."""
        return replace(self, patience=min(self.patience, PATIENCE), fewest=fewest)


def configure(options: Options) -> None:
    """Set JAX up before its first use: device, threads, 64 bits, programs on disk."""
    if options.threads:
        os.environ["NPROC"] = str(options.threads)
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_platforms", options.device)
    keep_programs()


class Measured(NamedTuple):
    """What every contender took, by its name, one figure a repetition.

    Attributes:
        seconds: on the clock.
        cpu_seconds: of this process, all threads: what the seconds would be if nothing
            else ran, but for caches.
        outcomes: what the calls returned.
    """

    seconds: dict[str, list[float]]
    cpu_seconds: dict[str, list[float]]
    outcomes: dict[str, list[Any]]

    def compare(self, over: str, under: str) -> dict[str, Any]:
        """Fields of a row: ratios of two contenders, and all seconds."""

        def ratios(times: dict[str, list[float]]) -> list[float]:
            return [a / b for a, b in zip(times[over], times[under], strict=False)]

        return {
            "ratios": ratios(self.seconds),
            "cpu_ratios": ratios(self.cpu_seconds),
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
        }


def measure_in_turns(
    contenders: Mapping[str, Callable[[int], Any]],
    options: Options,
    shortest: float = SHORTEST,
) -> Measured:
    """Seconds of each contender in every repetition: A B A B, so that noise hits all.

    Args:
        contenders: what to measure, given the number of the repetition. Each is called
            once before, so nothing that is measured is compiled.
        options: how often.
        shortest: seconds below which a contender is called several times in a row, and
            the mean is taken.
    """
    calls = {}
    for name, call in contenders.items():
        jax.block_until_ready(call(0))
        start = time.perf_counter()
        if shortest > 0:
            jax.block_until_ready(call(0))
        spent = time.perf_counter() - start
        calls[name] = 1 if spent >= shortest else int(shortest / spent) + 1
    seconds, cpu_seconds, outcomes = ({n: [] for n in contenders} for _ in range(3))
    measured = Measured(seconds, cpu_seconds, outcomes)
    for repetition in range(options.repetitions):
        for name, call in contenders.items():
            enough = repetition >= options.fewest
            if enough and sum(seconds[name]) > options.patience:
                continue
            outcome = None
            start, cpu = time.perf_counter(), time.process_time()
            for _ in range(calls[name]):
                outcome = jax.block_until_ready(call(repetition))
            cpu, spent = time.process_time() - cpu, time.perf_counter() - start
            seconds[name].append(spent / calls[name])
            cpu_seconds[name].append(cpu / calls[name])
            outcomes[name].append(outcome)
    return measured


def spread(values: list[float]) -> dict[str, Any]:
    """Median, quartiles, extremes and all of them."""
    low, _, high = statistics.quantiles(values, n=4) if len(values) > 1 else values * 3
    return {
        "median": statistics.median(values),
        "quartiles": [low, high],
        "extremes": [min(values), max(values)],
        "all": values,
    }


@dataclass(frozen=True)
class Row:
    """One line of the report.

    Attributes:
        name: of it, unique.
        what: is measured against what.
        ratios: in every repetition; their median counts.
        cpu_ratios: the same of processor seconds; both agree on a machine without
            other work.
        bar: which the median is held against; None if there is none.
        side: whether it must be at most or at least that.
        seconds: of every contender, in every repetition.
        cpu_seconds: the same, of the processor.
        errors: of every contender.
        details: counts and sizes.
    """

    name: str
    what: str
    ratios: list[float]
    bar: float | None = None
    side: Literal["most", "least"] = "most"
    cpu_ratios: list[float] = field(default_factory=list)
    seconds: dict[str, list[float]] = field(default_factory=dict)
    cpu_seconds: dict[str, list[float]] = field(default_factory=dict)
    errors: dict[str, Any] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)

    @property
    def ratio(self) -> float:
        """Median of the ratios."""
        return statistics.median(self.ratios)

    @property
    def passed(self) -> bool | None:
        """Whether the bar is reached; None if there is none."""
        if self.bar is None:
            return None
        if self.side == "most":
            return self.ratio <= self.bar
        return self.ratio >= self.bar

    def as_entries(self) -> dict[str, Any]:
        """What is written to the file."""
        times = {"seconds": self.seconds, "cpu_seconds": self.cpu_seconds}
        ratios = {"ratios": self.ratios, "cpu_ratios": self.cpu_ratios}
        return {
            **asdict(self),
            "ratio": self.ratio,
            "passed": self.passed,
            **{kind: spread(all_) for kind, all_ in ratios.items() if all_},
            **{
                kind: {name: spread(all_) for name, all_ in of.items()}
                for kind, of in times.items()
            },
        }

    def __str__(self) -> str:
        low, high = spread(self.ratios)["quartiles"]
        bar, verdict = "no bar", ""
        if self.bar is not None:
            bar = f"bar {'<=' if self.side == 'most' else '>='} {self.bar:g}"
            verdict = "PASS" if self.passed else "FAIL"
        times = ", ".join(
            f"{name} {statistics.median(all_):.3g} s"
            for name, all_ in self.seconds.items()
        )
        ratio = f"{self.ratio:6.3g} [{low:.3g}, {high:.3g}]"
        if self.cpu_ratios:
            ratio += f" cpu {statistics.median(self.cpu_ratios):.3g}"
        few = f" ({len(self.ratios)} repetitions)" if len(self.ratios) < 5 else ""
        return f"{self.name:24} {ratio:32} {bar:12} {verdict:5} {times}{few}"


def processor() -> str:
    """Name of the processor, where the system tells it."""
    listing = Path("/proc/cpuinfo")
    if listing.exists():
        for line in listing.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor()


def circumstances(options: Options) -> dict[str, Any]:
    """Hardware and versions."""
    return {
        "processor": processor(),
        "processors": os.cpu_count(),
        "platform": f"{platform.system()} {platform.machine()}",
        "device": jax.devices()[0].device_kind,
        "backend": jax.default_backend(),
        "threads_of_xla": options.threads or "all",
        "versions": {**versions(), "numba": numba.__version__},
    }


def load() -> float | None:
    """Processes that want to run, averaged over a minute; how noisy figures are."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None
