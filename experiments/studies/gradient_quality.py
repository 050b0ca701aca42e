"""How exact a gradient through growth is, what it costs, and what it is worth.

    python experiments/studies/gradient_quality.py exactness --divisions 10 50
    python experiments/studies/gradient_quality.py focus --divisions 20 50
    python experiments/studies/gradient_quality.py sweep --points 12 --seeds 4

*exactness* compares the reverse derivative of five metrics, in every parameter, with
central differences of replays along the frozen path, and measures seconds and memory.
*focus* does so for a polyp from a focus of hyperplasia, on a membrane that bends and
has springs, finite elements of all kinds and tension at once, in the radius too.
*sweep* grows anew at every stiffness of a decade, for several seeds, and compares the
slope of what comes out with the gradients on the way, averaged over 1, 2, ... seeds.
Each writes its figures to ``experiments/results/gradient_<part>.json`` and a picture
beside it.
"""

import argparse
import itertools
import json
import sys
import time
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from jaxtyping import Array, Float

import jaxgrow as jg
from jaxgrow.calibration.evaluations import LesionGrower
from jaxgrow.calibration.spec import make_task


mpl.use("Agg")
import matplotlib.pyplot as plt


RESULTS = Path(__file__).parents[1] / "results"

METRICS = ("height_mm", "width_mm", "neck_width_mm", "volume_mm3", "area_mm2")

NAMES = tuple(field.name for field in fields(jg.Parameters))

STEPS = (1e-6, 1e-5, 1e-7, 1e-4)
"""Relative steps of differences: larger ones cross kinks of the energy, smaller ones
show rounding, which is some 1e-9 mm of a broad lesion's width. One is enough if it
agrees to `AGREES`; else the best of them counts, for each metric."""

AGREES = 5e-6

MATTERS = 1e-3
"""Share of a metric's largest slope (per relative change of a parameter) below which
the error of a slope is taken relative to that share, not to the slope itself."""

SWEPT = ("height_mm", "area_mm2", "sphericity", "tip_curvature_per_mm")

DECADE = (0.0126, 0.126)
"""Of spring stiffness, around the default."""

TIGHT = 1e-13
"""Tolerance of the replays that differences are made of."""


def of_a_source(divisions: int) -> jg.Scene:
    """A polyp at the fundus of the built-in uterus, with the general defaults."""
    lesion = jg.Polyp(divisions=divisions, particle_mm=1.0)
    return jg.Scene(lesion=lesion, parameters=jg.Parameters())


def of_a_focus(divisions: int) -> jg.Scene:
    """A polyp from a focus, on a membrane that has every term at once."""
    more = {
        "bending_stiffness": 0.003,
        "surface_tension": 0.005,
        "membrane_modulus": 0.3,
        "kirchhoff_modulus": 0.2,
        "flowing_modulus": 0.02,
    }
    lesion = jg.Polyp(divisions=divisions, particle_mm=1.5, divisions_per_step=1)
    return jg.Scene(lesion=lesion, parameters=more)


SCENES = {"exactness": of_a_source, "focus": of_a_focus}
"""Scenes of the parts that measure how exact gradients are."""


def metrics(
    scene: jg.Scene, parameters: jg.Parameters, smoothing: float, **more: Any
) -> Float[Array, " k"]:
    """The five metrics of a growth."""
    growth = jg.grow(scene, parameters=parameters, **more)
    shape = jg.shape_metrics(growth.state, smoothing=smoothing)
    return jnp.stack([getattr(shape, name) for name in METRICS])


def arrays(parameters: jg.Parameters) -> jg.Parameters:
    """The same as arrays, so that another value compiles nothing."""
    return jax.tree.map(jnp.asarray, parameters)


def timed(call: Any) -> tuple[Any, float]:
    """The outcome and the seconds."""
    start = time.perf_counter()
    out = jax.block_until_ready(call())
    return out, time.perf_counter() - start


def exactness(options: argparse.Namespace) -> dict[str, Any]:
    """Errors, norms, seconds and memory at each number of divisions.

    Rows of numbers that are not asked for are kept as they are.
    """
    others = [
        row
        for row in read(options.part).get("rows", [])
        if row["divisions"] not in options.divisions
    ]
    for divisions in options.divisions:
        scene = SCENES[options.part](divisions)
        start = arrays(scene.parameters)
        for _ in range(2):  # the second time nothing is compiled
            growth, growing = timed(lambda s=scene: jg.grow(s, tolerance=1e-10))
        _, usual = timed(lambda s=scene: jg.grow(s).state)
        events = growth.events

        def along(
            p: jg.Parameters, s: Any = scene, e: Any = events, **more: Any
        ) -> Any:
            return metrics(s, p, 0.0, events=e, **more)

        def reverse(call: Any = along, at: Any = start) -> tuple[Any, Any]:
            return jax.vjp(call, at)

        first = timed(lambda r=reverse: r()[1](jnp.ones(len(METRICS))))[1]
        _, plain = timed(lambda a=along, p=start: a(p))
        (_, pull), replaying = timed(reverse)
        slopes, pulling = timed(lambda p=pull: [p(row)[0] for row in np.eye(5)])
        kept = sum(leaf.nbytes for leaf in jax.tree.leaves(pull))
        table = np.array([[float(getattr(s, n)) for n in NAMES] for s in slopes])
        row: dict[str, Any] = {
            "divisions": divisions,
            "seconds": {
                "growth": usual,
                "growth to 1e-10": growing,
                "replay": plain,
                "first gradient of this process": first,
                "replay that keeps what a derivative needs": replaying,
                "one reverse pass": pulling / len(METRICS),
            },
            "reverse_over_growth": pulling / len(METRICS) / usual,
            "reverse_over_replay": pulling / len(METRICS) / plain,
            "gradient_over_growth": (replaying + pulling / 5) / usual,
            "gradient_over_growth_to_1e-10": (replaying + pulling / 5) / growing,
            "mb_per_division": kept / 1e6 / divisions,
            "slopes": {
                name: dict(zip(METRICS, column, strict=True))
                for name, column in zip(NAMES, table.T.tolist(), strict=True)
            },
            "errors": {},
        }
        scale = np.array([float(getattr(start, n)) for n in NAMES])
        row["gradient_norm_per_relative_change"] = dict(
            zip(METRICS, np.linalg.norm(table * scale, axis=1).tolist(), strict=True)
        )
        for number, name in enumerate(NAMES):
            if options.only and name not in options.only:
                continue
            value = scale[number]

            def at(
                h: float,
                n: str = name,
                v: float = value,
                a: Any = along,
                p: Any = start,
            ) -> Any:
                moved = replace(p, **{n: jnp.asarray(v * (1 + h))})
                return np.asarray(a(moved, tolerance=TIGHT))

            # a slope that hardly matters is measured against one that does
            least = MATTERS * np.abs(table * scale).max(axis=1) / value
            relative = np.full(len(METRICS), np.inf)
            for step in STEPS:
                slope = (at(step) - at(-step)) / (2 * step * value)
                error = np.abs(slope - table[:, number])
                error /= np.maximum(np.abs(slope), np.maximum(least, 1e-300))
                relative = np.minimum(relative, error)
                if relative.max() <= AGREES:
                    break
            row["errors"][name] = dict(zip(METRICS, relative.tolist(), strict=True))
            print(divisions, name, relative, file=sys.stderr, flush=True)
            errors = [e for each in row["errors"].values() for e in each.values()]
            row["largest_error"] = max(errors)
            row["median_error"] = float(np.median(errors))
            rows = sorted([*others, row], key=lambda r: r["divisions"])
            write(options.part, {"rows": rows})
        others.append(row)
    rows = sorted(others, key=lambda r: r["divisions"])
    write(options.part, {"rows": rows})
    draw_exactness(rows, options.part)
    return {"rows": rows}


def draw_exactness(rows: list[dict[str, Any]], part: str) -> None:
    """Error and norm of the gradient against the number of divisions."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
    count = [row["divisions"] for row in rows]
    for name in METRICS:
        worst = [
            max((e[name] for e in r["errors"].values()), default=np.nan) for r in rows
        ]
        left.semilogy(count, np.maximum(worst, 1e-16), "o-", label=name)
        norm = [r["gradient_norm_per_relative_change"][name] for r in rows]
        right.plot(count, norm, "o-", label=name)
    left.set(xlabel="divisions", ylabel="largest relative error over all parameters")
    right.set(xlabel="divisions", ylabel="|∂metric/∂ ln p|, mm, mm², mm³")
    left.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(RESULTS / f"gradient_{part}.png", dpi=110)
    plt.close(figure)


def sweep(options: argparse.Namespace) -> dict[str, Any]:
    """Grow anew at each stiffness; compare slopes of the outcome with gradients."""
    entries = {
        "targets": dict.fromkeys(SWEPT, (0.0, 1.0)),
        "parameters": {"spring_stiffness": (DECADE[0] / 2, 2 * DECADE[1])},
    }
    scene = jg.Scene(
        lesion=jg.Polyp(divisions=options.size, particle_mm=1.0),
        surroundings=jg.Surroundings(radius=4.0),
    )
    grower = LesionGrower(scene, make_task(entries, source="sweep"))
    values = np.geomspace(*DECADE, options.points)
    found = np.full((options.seeds, options.points, len(SWEPT)), np.nan)
    slopes = found.copy()
    for seed in range(options.seeds):
        for place, value in enumerate(values.tolist()):
            measured = grower.measure(seed, (value,))
            along = grower.slopes(seed, (value,))
            if measured.success and along:
                found[seed, place] = measured.metrics
                slopes[seed, place] = np.array(along)[:, 0] * value
            print(seed, value, *found[seed, place], file=sys.stderr, flush=True)
        figures: dict[str, Any] = {
            "divisions": options.size,
            "seeds": seed + 1,
            "values": values.tolist(),
            "metrics": {
                name: compare(values, found[: seed + 1, :, k], slopes[: seed + 1, :, k])
                for k, name in enumerate(SWEPT)
            },
        }
        write("sweep", figures)
        draw_sweep(figures)
    return figures


def compare(
    values: Float[np.ndarray, " p"],
    found: Float[np.ndarray, "s p"],
    slopes: Float[np.ndarray, "s p"],
) -> dict[str, Any]:
    """Per ln k: the trend of the metric over the decade, and the gradients."""
    x = np.tile(np.log(values), len(found)).reshape(found.shape)
    known = np.isfinite(found) & np.isfinite(slopes)
    trend = np.polynomial.Polynomial.fit(x[known], found[known], 3)
    wanted = trend.deriv()(x[0])
    jumps = np.abs(np.diff(found, axis=1))
    wrong = {}
    for number in range(1, len(found) + 1):
        groups = itertools.combinations(range(len(found)), number)
        means = np.array([slopes[list(group)].mean(axis=0) for group in groups])
        sure = np.isfinite(means)
        wrong[number] = float((means * wanted < 0)[sure].mean())
    return {
        "found": found.tolist(),
        "slope_per_ln_k": slopes.tolist(),
        "trend": trend(x[0]).tolist(),
        "trend_slope_per_ln_k": wanted.tolist(),
        "scatter_around_trend": float(np.std((found - trend(x))[known], ddof=4)),
        "median_jump_between_neighbours": float(np.nanmedian(jumps)),
        "wrong_way_by_seeds_averaged": wrong,
        "mean_slope_over_trend_slope": float(
            np.nanmean(slopes) / (trend(x[0, -1]) - trend(x[0, 0])) * np.ptp(x[0])
        ),
    }


def draw_sweep(figures: dict[str, Any]) -> None:
    """The metrics and their gradients over the decade."""
    x = figures["values"]
    figure, axes = plt.subplots(2, len(SWEPT), figsize=(4 * len(SWEPT), 6.5))
    for (top, bottom), (name, row) in zip(
        axes.T, figures["metrics"].items(), strict=True
    ):
        for found, slope in zip(row["found"], row["slope_per_ln_k"], strict=True):
            top.semilogx(x, found, ".-", lw=0.5, alpha=0.6)
            bottom.semilogx(x, slope, ".", alpha=0.6)
        top.semilogx(x, row["trend"], "k", label="trend")
        mean = np.mean(row["slope_per_ln_k"], axis=0)
        bottom.semilogx(x, mean, "C3-", label="frozen path, mean of seeds")
        bottom.semilogx(x, row["trend_slope_per_ln_k"], "k", label="slope of the trend")
        bottom.axhline(0, color="0.8", lw=0.8)
        for panel in (top, bottom):
            panel.set_xticks([0.02, 0.05, 0.1], ["0.02", "0.05", "0.1"])
            panel.set_xticks([], minor=True)
        top.set(title=name)
        bottom.set(xlabel="spring stiffness", ylabel="per ln k")
    axes[0, 0].legend(fontsize=8)
    axes[1, 0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(RESULTS / "gradient_sweep.png", dpi=90)
    plt.close(figure)


def read(part: str) -> dict[str, Any]:
    """The figures of a part that were kept last."""
    path = RESULTS / f"gradient_{part}.json"
    return json.loads(path.read_text()) if path.exists() else {}


def write(part: str, figures: dict[str, Any]) -> None:
    """Keep the figures of a part."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"gradient_{part}.json"
    path.write_text(json.dumps(figures, indent=1) + "\n")


def main() -> None:
    """Run one part."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=[*SCENES, "sweep"])
    parser.add_argument("--divisions", type=int, nargs="*", default=[10, 50, 200])
    parser.add_argument("--only", nargs="*", default=[], help="parameters")
    parser.add_argument("--size", type=int, default=20, help="divisions of the sweep")
    parser.add_argument("--points", type=int, default=12)
    parser.add_argument("--seeds", type=int, default=4)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jg.keep_programs()
    figures = (sweep if options.part == "sweep" else exactness)(options)
    print(
        json.dumps({k: v for k, v in figures.items() if k != "rows"}, indent=1)[:2000]
    )


if __name__ == "__main__":
    main()
