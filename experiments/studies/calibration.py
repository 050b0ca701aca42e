"""What a fit recovers, what it reaches, and what it costs.

    python calibration.py --out fits          # two hours on two cores
    python calibration.py --out fits --quick  # too few lesions, in minutes
    python calibration.py --out fits --only low high

- ``low``, ``high``: targets are the mean metrics of lesions grown with a known spring
  stiffness; it is sought from starts three times off on either side, with other seeds.
  Single lesions scatter, so it takes many to know a stiffness to 10 %.
- ``both``, ``both-high``: spring stiffness and contact adhesion together, one start
  three times too low and one three times too high, and the other way round.
- ``both-more``, ``both-high-more``: on from where these ended, with more seeds, since
  a lesion tells less of its contact adhesion than of its stiffness.
- ``expert``: a pedunculated polyp of 12 mm, height over width 1.8 ± 0.2, neck over
  width 0.4 ± 0.1: reached, or which of the two is not, and why.
- ``simplex``, ``cma``: ``both`` without derivatives, by SciPy's Nelder-Mead (the fit's
  own fallback) and by CMA-ES (package ``cma``), with as many evaluations.

Every fit keeps its growths under ``--out`` and goes on where it was interrupted. The
figures are merged into ``experiments/results/calibration.json`` and drawn to
``calibration.png`` beside it.
"""

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxgrow as jg
from jaxgrow.calibration.coordinates import Coordinates
from jaxgrow.calibration.evaluations import Growths, LesionGrower, Values
from jaxgrow.calibration.fit import describe_request
from jaxgrow.calibration.loss import Loss
from jaxgrow.calibration.spec import make_task, Task
from jaxgrow.runtime.compile_cache import keep_programs


RESULTS = Path(__file__).parents[1] / "results"
TRUTH = {"spring_stiffness": 0.04, "contact_adhesion": 0.3}
BOUNDS = {"spring_stiffness": (0.005, 0.5), "contact_adhesion": (0.03, 2.0)}
METRICS = (
    "height_mm",
    "volume_mm3",
    "area_mm2",
    "sphericity",
    "tip_curvature_per_mm",
    "neck_curvature_per_mm",
)
SCENE = jg.Scene(
    lesion=jg.Polyp(divisions=20, particle_mm=1.0),
    surroundings=jg.Surroundings(radius=4.0),
)
EXPERT = jg.Scene(
    lesion=jg.Polyp(
        size_mm=12.0, particle_mm=0.8, divisions_per_step=8, site="posterior"
    )
)
"""Particles that a narrow focus holds."""
EXPERT_BOUNDS = {
    "focus_radius": jg.Bounds(low=0.4, high=4.0, start=1.0),
    "bending_stiffness": jg.Bounds(low=0.002, high=0.1, start=0.011),
}
"""Both start from what `focus_mm` = 1 means; the radius is in mm, a twelfth of the
size."""


@dataclass(frozen=True)
class Size:
    """How large the experiment is.

    Attributes:
        planted: number of seeds the targets are the mean of.
        seeds: number of seeds of a fit.
        more_seeds: of another fit, that goes on from where the first one ended.
        evaluations: of a fit, at most.
        expert_seeds: number of seeds of the expert's case.
        expert_evaluations: of that fit, at most.
    """

    planted: int
    seeds: int
    more_seeds: int
    evaluations: int
    expert_seeds: int
    expert_evaluations: int


QUICK = Size(
    planted=8,
    seeds=4,
    more_seeds=8,
    evaluations=5,
    expert_seeds=2,
    expert_evaluations=3,
)
FULL = Size(
    planted=192,
    seeds=16,
    more_seeds=48,
    evaluations=12,
    expert_seeds=3,
    expert_evaluations=12,
)


def planted_targets(size: Size, out: Path) -> dict[str, jg.Target]:
    """Mean metrics with the true parameters, over seeds that no fit uses.

    The uncertainty is that of these means.
    """
    seeds = tuple(range(100, 100 + size.planted))
    task = make_task(
        {
            "targets": dict.fromkeys(METRICS, (0.0, 1.0)),
            "parameters": BOUNDS,
            "fit": {"seeds": seeds},
        },
        source="the plant",
    )
    request = describe_request(SCENE, task)
    growths = Growths(LesionGrower(SCENE, task), request, out / "planted.json")
    values = tuple(TRUTH[name] for name in BOUNDS)
    grown = [growths.measure(seed, values) for seed in seeds]
    metrics = np.array([measured.metrics for measured in grown])
    error = metrics.std(axis=0, ddof=1) / math.sqrt(size.planted)
    return {
        name: jg.Target(value=float(mean), uncertainty=float(deviation))
        for name, mean, deviation in zip(
            METRICS, metrics.mean(axis=0), error, strict=True
        )
    }


class WithoutDerivatives(LesionGrower):
    """Growths whose derivatives are not asked for."""

    def slopes(self, seed: int, values: Values) -> tuple[()]:
        """None exist."""
        return ()


def bounds_from(starts: dict[str, float]) -> dict[str, jg.Bounds]:
    """The bounds of some parameters, with their starts."""
    return {
        name: jg.Bounds(low=BOUNDS[name][0], high=BOUNDS[name][1], start=start)
        for name, start in starts.items()
    }


def recover(
    name: str,
    starts: dict[str, float],
    seeds: Sequence[int],
    size: Size,
    out: Path,
    *,
    derivatives: bool = True,
) -> dict[str, Any]:
    """Fit planted targets from a start."""
    targets, bounds = planted_targets(size, out), bounds_from(starts)
    effort = {"seeds": tuple(seeds), "evaluations": size.evaluations}
    grower = None
    if not derivatives:
        entries = {"targets": targets, "parameters": bounds, "fit": effort}
        task = make_task(entries, source=name)
        grower = WithoutDerivatives(SCENE, task)
    found = jg.fit(
        SCENE,
        targets,
        bounds,
        folder=out / name,
        progress=lambda tried: print(name, *tried, flush=True),
        grower=grower,
        **effort,
    )
    return summary(found, starts, TRUTH)


def summary(
    found: jg.Fit, starts: dict[str, float], truth: dict[str, float]
) -> dict[str, Any]:
    """The figures of a fit; `truth` is what its targets were made with, if known."""
    row = found.as_dict()
    for name, fitted in row["parameters"].items():
        fitted["start"] = starts[name]
        if name in truth:
            fitted["truth"] = truth[name]
            fitted["error"] = fitted["value"] / truth[name] - 1
    gradient = [t for t in found.history if t.how == "gradient"]
    row["gradient_steps"] = len(gradient)
    row["gradient_steps_accepted"] = sum(t.accepted for t in gradient)
    row["growths"] = len(found.history) * len(found.task.fit.seeds)
    row["growths_with_derivatives"] = sum(bool(g.slopes) for g in found.growths)
    return row


def expert(size: Size, out: Path) -> dict[str, Any]:
    """The pedunculated polyp, by Nelder and Mead.

    A lesion takes minutes, and its derivatives (equilibria to 1e-10) as long again.
    """
    targets = {
        "height_to_width": jg.Target(value=1.8, uncertainty=0.2),
        "neck_to_width": jg.Target(value=0.4, uncertainty=0.1),
    }
    effort = {
        "seeds": tuple(range(size.expert_seeds)),
        "evaluations": size.expert_evaluations,
    }
    entries = {"targets": targets, "parameters": EXPERT_BOUNDS, "fit": effort}
    found = jg.fit(
        EXPERT,
        targets,
        EXPERT_BOUNDS,
        **effort,
        grower=WithoutDerivatives(EXPERT, make_task(entries, source="expert")),
        folder=out / "expert",
        progress=lambda tried: print("expert", *tried, flush=True),
    )
    starts = {name: bounds.start for name, bounds in EXPERT_BOUNDS.items()}
    return summary(found, starts, {})


def cma(starts: dict[str, float], size: Size, out: Path) -> dict[str, Any]:
    """Both parameters by CMA-ES."""
    import cma as package

    targets, bounds = planted_targets(size, out), bounds_from(starts)
    effort = {"seeds": tuple(range(size.seeds))}
    entries = {"targets": targets, "parameters": bounds, "fit": effort}
    task: Task = make_task(entries, source="cma")
    request = describe_request(SCENE, task)
    growths = Growths(LesionGrower(SCENE, task), request, out / "cma.json")
    coordinates = Coordinates.between(task.parameters.values())
    loss = Loss(task, coordinates, growths)
    history = []

    def value(u: Any) -> float:
        found = loss(np.asarray(u))
        history.append({"values": found.values, "loss": found.loss})
        print("cma", found.values, found.loss, flush=True)
        return min(found.loss, 1e300)

    start = coordinates.coordinates(jnp.asarray(list(starts.values())))
    options = {"maxfevals": size.evaluations, "seed": 1, "verbose": -9}
    package.fmin2(value, np.asarray(start), 0.8, options)
    # as `jg.fit` chooses: not the luckiest point, but the best by all lesions
    blank = np.zeros((len(targets), len(starts)))
    best = min(loss.grown, key=lambda point: loss.estimate(point.u, blank).loss)
    return {
        "parameters": {
            name: {
                "value": v,
                "start": starts[name],
                "truth": TRUTH[name],
                "error": v / TRUTH[name] - 1,
            }
            for name, v in zip(starts, best.values, strict=True)
        },
        "loss": loss.estimate(best.u, blank).loss,
        "growths": len(growths.all),
        "growths_with_derivatives": 0,
        "history": history,
    }


def run(name: str, size: Size, out: Path) -> dict[str, Any]:
    """One case by its name."""
    stiffness, adhesion = TRUTH.values()
    starts = {
        "low": {"spring_stiffness": stiffness / 3},
        "high": {"spring_stiffness": stiffness * 3},
        "both-high": {
            "spring_stiffness": stiffness * 3,
            "contact_adhesion": adhesion / 3,
        },
    }
    both = {"spring_stiffness": stiffness / 3, "contact_adhesion": adhesion * 3}
    if name == "expert":
        return expert(size, out)
    if name == "cma":
        return cma(both, size, out)
    seeds = range(size.seeds)
    if name.endswith("-more"):
        first = json.loads((out / name.removesuffix("-more") / "fit.json").read_text())
        found = first["outcome"]["parameters"]
        start = {parameter: found[parameter]["value"] for parameter in found}
        more = range(size.seeds, size.seeds + size.more_seeds)
        return recover(name, start, more, size, out)
    derivatives = name != "simplex"
    return recover(
        name, starts.get(name, both), seeds, size, out, derivatives=derivatives
    )


CASES = (
    "low",
    "high",
    "both",
    "both-more",
    "both-high",
    "both-high-more",
    "simplex",
    "cma",
    "expert",
)


def draw(rows: dict[str, dict[str, Any]], path: Path) -> None:
    """Fitted values with their uncertainties, losses, and numbers of growths."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 4))
    ticks = []
    for case, row in rows.items():
        for name, fitted in row.get("parameters", {}).items():
            if "truth" not in fitted:
                continue
            y, truth = len(ticks), fitted["truth"]
            ticks.append(f"{case}: {name}")
            value = fitted["value"] / truth
            if "low" in fitted:
                ends = [fitted["low"] / truth, fitted["high"] / truth]
                left.plot(ends, [y, y], color="C0", lw=2)
                left.plot(fitted["start"] / truth, y, "o", mfc="none", color="0.5")
            left.plot(value, y, "o", color="C0")
        losses = [t["loss"] for t in row.get("history", [])]
        if losses:
            known = [math.inf if loss is None else loss for loss in losses]
            middle.semilogy(np.minimum.accumulate(known), label=case)
    left.axvspan(0.9, 1.1, color="0.9")
    left.set_xscale("log")
    left.set_xticks([1 / 3, 1, 3], ["1/3", "1", "3"])
    left.set_xticks([], minor=True)
    left.set_yticks(range(len(ticks)), ticks)
    left.set_xlabel("fitted / true (hollow: start; band: ± 10 %)")
    middle.set_xlabel("evaluation")
    middle.set_ylabel("least loss")
    above = {"frameon": False, "loc": "lower center", "bbox_to_anchor": (0.5, 1.0)}
    middle.legend(**above, ncol=2)
    cases = [case for case in rows if case != "expert"]
    right.barh(cases, [rows[case]["growths"] for case in cases], label="growths")
    replays = [rows[case]["growths_with_derivatives"] for case in cases]
    right.barh(cases, replays, height=0.3, label="of them with a derivative")
    right.legend(**above)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    """Run the cases, merge their figures, draw them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("fits"))
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="*", choices=CASES)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    keep_programs()
    kind = "quick" if options.quick else "full"
    size = QUICK if options.quick else FULL
    path = RESULTS / "calibration.json"
    rows: dict[str, Any] = {}
    for name in options.only or CASES:
        found = run(name, size, options.out / kind)
        # another process may have written its cases meanwhile
        rows = json.loads(path.read_text()) if path.exists() else {}
        rows.setdefault(kind, {})[name] = found
        path.write_text(json.dumps(rows, indent=1) + "\n")
        print(name, json.dumps({k: v for k, v in found.items() if k != "history"}))
    draw(rows[kind], RESULTS / "calibration.png")


if __name__ == "__main__":
    main()
