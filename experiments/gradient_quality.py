"""How exact a gradient through growth is, what it costs, and what it is worth.

    python experiments/gradient_quality.py exactness --divisions 10 50
    python experiments/gradient_quality.py sweep --points 25 --seeds 4

*exactness* compares the reverse derivative of five metrics, in every parameter, with
central differences of replays along the frozen path, and measures seconds and memory.
*sweep* grows anew at every stiffness of a decade, for several seeds, and compares the
slope of what comes out with the gradient on the way. Each writes its figures to
``experiments/results/gradient_<part>.json`` and a picture beside it.
"""

import argparse
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


mpl.use("Agg")
import matplotlib.pyplot as plt


RESULTS = Path(__file__).parent / "results"

METRICS = ("height_mm", "width_mm", "neck_width_mm", "volume_mm3", "area_mm2")

NAMES = tuple(field.name for field in fields(jg.Parameters))

STEP, TIGHT = 1e-5, 1e-13
"""Relative step of a difference, and tolerance of the replays it is made of."""


def scene_of(divisions: int) -> jg.Scene:
    """A polyp at the fundus of the built-in uterus."""
    return jg.Scene(lesion=jg.Polyp(divisions=divisions, particle_mm=1.0))


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
    """Errors, norms, seconds and memory at each number of divisions."""
    rows = []
    start = arrays(jg.Parameters())
    for divisions in options.divisions:
        scene = scene_of(divisions)
        for _ in range(2):  # the second time nothing is compiled
            growing = timed(lambda s=scene: jg.grow(s, tolerance=1e-10).state)[1]
        _, usual = timed(lambda s=scene: jg.grow(s).state)
        events = jg.grow(scene, tolerance=1e-10).events

        def along(
            p: jg.Parameters, s: Any = scene, e: Any = events, **more: Any
        ) -> Any:
            return metrics(s, p, 0.0, events=e, **more)

        def reverse(call: Any = along) -> tuple[Any, Any]:
            return jax.vjp(call, start)

        reverse()[1](jnp.ones(len(METRICS)))
        (_, pull), replaying = timed(reverse)
        slopes, pulling = timed(lambda p=pull: [p(row)[0] for row in np.eye(5)])
        kept = sum(leaf.nbytes for leaf in jax.tree.leaves(pull))
        table = np.array([[float(getattr(s, n)) for n in NAMES] for s in slopes])
        row: dict[str, Any] = {
            "divisions": divisions,
            "seconds": {
                "growth": usual,
                "growth to 1e-10": growing,
                "replay that keeps what a derivative needs": replaying,
                "one reverse pass": pulling / len(METRICS),
            },
            "reverse_over_growth": pulling / len(METRICS) / usual,
            "replay_and_reverse_over_growth": (replaying + pulling / 5) / usual,
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
            ends = [
                np.asarray(
                    along(
                        replace(start, **{name: jnp.asarray(value * (1 + s * STEP))}),
                        tolerance=TIGHT,
                    )
                )
                for s in (1, -1)
            ]
            slope = (ends[0] - ends[1]) / (2 * STEP * value)
            # a slope is measured against the largest one of that metric, per change
            least = 1e-9 * np.abs(table * scale).max(axis=1) / value
            error = np.abs(slope - table[:, number])
            relative = error / np.maximum(np.abs(slope), np.maximum(least, 1e-300))
            row["errors"][name] = dict(zip(METRICS, relative.tolist(), strict=True))
            print(divisions, name, relative, file=sys.stderr, flush=True)
        errors = [e for row_ in row["errors"].values() for e in row_.values()]
        row["largest_error"] = max(errors, default=None)
        row["median_error"] = float(np.median(errors)) if errors else None
        rows.append(row)
        write("exactness", {"rows": rows})
        draw_exactness(rows)
    return {"rows": rows}


def draw_exactness(rows: list[dict[str, Any]]) -> None:
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
    figure.savefig(RESULTS / "gradient_exactness.png", dpi=110)
    plt.close(figure)


def sweep(options: argparse.Namespace) -> dict[str, Any]:
    """Grow anew at each stiffness; compare slopes of the outcome with gradients."""
    scene = scene_of(options.size)
    values = np.geomspace(0.0126, 0.126, options.points)
    heights = np.full((options.seeds, options.points), np.nan)
    slopes = heights.copy()
    for seed in range(options.seeds):
        for place, value in enumerate(values):

            def height(k: Any, s: int = seed) -> Any:
                parameters = replace(arrays(jg.Parameters()), spring_stiffness=k)
                found = metrics(scene, parameters, options.smoothing, seed=s)
                return found[METRICS.index(options.metric)]

            at = jax.value_and_grad(height)(jnp.asarray(value))
            heights[seed, place], slopes[seed, place] = map(float, at)
            print(seed, value, *map(float, at), file=sys.stderr, flush=True)
        figures = compare(
            options.metric, values, heights[: seed + 1], slopes[: seed + 1]
        )
        write("sweep", figures)
        draw_sweep(figures)
    return figures


def compare(
    metric: str,
    values: Float[np.ndarray, " p"],
    found: Float[np.ndarray, "s p"],
    slopes: Float[np.ndarray, "s p"],
) -> dict[str, Any]:
    """Per ln k: the trend of the metric over the decade, and the gradients."""
    x = np.log(values)
    trend = np.polynomial.Polynomial.fit(x, found.mean(axis=0), 3)
    along = slopes * values  # per ln k
    wrong = np.sign(along) != np.sign(trend.deriv()(x))
    mean = along.mean(axis=0)
    return {
        "metric": metric,
        "values": values.tolist(),
        "found": found.tolist(),
        "slope_per_ln_k": along.tolist(),
        "trend": trend(x).tolist(),
        "trend_slope_per_ln_k": trend.deriv()(x).tolist(),
        "spread_over_seeds": float(found.std(axis=0).mean()),
        "roughness": float(np.abs(found - trend(x)).mean()),
        "wrong_way_one_seed": float(wrong.mean()),
        "wrong_way_mean_of_seeds": float(
            (np.sign(mean) != np.sign(trend.deriv()(x))).mean()
        ),
        "correlation_of_mean_with_trend": float(
            np.corrcoef(mean, trend.deriv()(x))[0, 1]
        ),
    }


def draw_sweep(figures: dict[str, Any]) -> None:
    """The metric and its gradients over the decade."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
    x = figures["values"]
    for row, slope in zip(figures["found"], figures["slope_per_ln_k"], strict=True):
        left.semilogx(x, row, ".-", lw=0.7, alpha=0.6)
        right.semilogx(x, slope, ".", alpha=0.4)
    left.semilogx(x, figures["trend"], "k", label="trend of the mean")
    mean = np.mean(figures["slope_per_ln_k"], axis=0)
    right.semilogx(x, mean, "C3-", label="mean of the frozen-path gradients")
    right.semilogx(x, figures["trend_slope_per_ln_k"], "k", label="slope of the trend")
    left.set(xlabel="spring stiffness", ylabel=figures["metric"])
    right.set(xlabel="spring stiffness", ylabel=f"∂ {figures['metric']} / ∂ ln k")
    left.legend(fontsize=8)
    right.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(RESULTS / "gradient_sweep.png", dpi=110)
    plt.close(figure)


def write(part: str, figures: dict[str, Any]) -> None:
    """Keep the figures of a part."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"gradient_{part}.json"
    path.write_text(json.dumps(figures, indent=1) + "\n")


def main() -> None:
    """Run one part."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=["exactness", "sweep"])
    parser.add_argument("--divisions", type=int, nargs="*", default=[10, 50, 200])
    parser.add_argument("--only", nargs="*", default=[], help="parameters")
    parser.add_argument("--size", type=int, default=60, help="divisions of the sweep")
    parser.add_argument("--points", type=int, default=40)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--metric", choices=METRICS, default="height_mm")
    parser.add_argument("--smoothing", type=float, default=0.05)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    figures = {"exactness": exactness, "sweep": sweep}[options.part](options)
    print(
        json.dumps({k: v for k, v in figures.items() if k != "rows"}, indent=1)[:2000]
    )


if __name__ == "__main__":
    main()
