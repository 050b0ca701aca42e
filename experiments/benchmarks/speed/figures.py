"""Figures of the report: work-precision curves, and ratios against their bars.

speed_error_precision.png   error against seconds, one curve a method
speed_error_axes.png        error and seconds along the other axes
speed_error_ratios.png      every row with its quartiles, and its bar
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl


mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter


Point = dict[str, Any]

LEAST = 1e-16
"""Errors below it, and none, are drawn at it."""

STYLES = {
    "jaxgrow auto": "C0o-",
    "jaxgrow lbfgs": "C1s-",
    "jaxgrow newton": "C5P-",
    "jaxgrow fire": "C2^-",
    "numba lbfgs": "C3D--",
    "jax-md fire": "C4v--",
}
"""Colour, mark and line of each method, the same in all figures."""

_OF_PARTICLES = {
    "position_rms": "position, rms (r0)",
    "energy_relative": "energy, relative",
    "residual": "largest force (F(0))",
}

PRECISION = {
    "tolerance": (
        "free ball",
        _OF_PARTICLES,
    ),
    "division": (
        "ball after a division",
        _OF_PARTICLES,
    ),
    "polyp-tolerance": (
        "polyp after a division",
        {
            "position_rms": "position, rms (r0)",
            "energy_relative": "energy, relative",
            "metrics_max": "worst shape metric, relative",
        },
    ),
}
"""Axes whose points are tolerances: what is relaxed, and the errors that are shown."""


def draw(content: dict[str, Any], path: Path) -> list[Path]:
    """Draw what there is.

    Args:
        content: of the file of figures.
        path: of that file; the pictures get its name.

    Returns:
        The pictures that were written.
    """
    drawn = []
    parts: dict[str, Callable[[dict[str, Any]], Any]] = {
        "precision": draw_precision,
        "axes": draw_axes,
        "ratios": draw_ratios,
    }
    for name, make in parts.items():
        figure = make(content)
        if figure is None:
            continue
        drawn.append(path.with_name(f"{path.stem}_{name}.png"))
        figure.savefig(drawn[-1], dpi=110)
        plt.close(figure)
    return drawn


def by(points: list[Point], entry: str) -> dict[Any, list[Point]]:
    """Points by the value of one of their entries."""
    groups: dict[Any, list[Point]] = {}
    for point in points:
        groups.setdefault(point[entry], []).append(point)
    return groups


def error_of(point: Point, name: str) -> float:
    """Size of an error; of a nested one by its path, with a dot."""
    found: Any = point["errors"]
    for part in name.split("."):
        found = found[part]
    return max(abs(found), LEAST)


def plot(axes: Axes, points: list[Point], error: str, label: str, style: str) -> None:
    """A curve: medians, with the quartiles of the seconds.

    Points that did not converge are hollow.
    """
    x = [p["seconds"]["median"] for p in points]
    y = [error_of(p, error) for p in points]
    beside = [
        [m - p["seconds"]["quartiles"][0] for m, p in zip(x, points, strict=True)],
        [p["seconds"]["quartiles"][1] - m for m, p in zip(x, points, strict=True)],
    ]
    beside = [[max(length, 0.0) for length in side] for side in beside]
    (line,) = axes.loglog(x, y, style, ms=4, lw=1.2, label=label)
    axes.errorbar(x, y, xerr=beside, fmt="none", ecolor=line.get_color(), lw=0.8)
    failed = [k for k, p in enumerate(points) if p["result"] not in ("", "CONVERGED")]
    axes.plot(
        [x[k] for k in failed],
        [y[k] for k in failed],
        str(line.get_marker()),
        ms=4,
        mfc="white",
        mec=line.get_color(),
        ls="none",
    )


def label_decades(axes: Axes) -> None:
    """Ticks along x at 1, 2 and 5 of every decade, in plain numbers."""
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(axis="x", labelsize=8)


def finish(figure: Any, grid: Any) -> None:
    """Grid lines, and one legend above all panels."""
    labels: dict[str, Any] = {}
    for axes in grid:
        axes.grid(True, color="0.92", lw=0.6)
        axes.set_axisbelow(True)
        handles, names = axes.get_legend_handles_labels()
        labels |= dict(zip(names, handles, strict=True))
    figure.legend(
        labels.values(),
        labels.keys(),
        loc="outside upper center",
        ncol=max(len(labels), 1),
        frameon=False,
    )


def draw_precision(content: dict[str, Any]) -> Any:
    """Error against seconds for tolerances of 1e-1 to 1e-8, one curve a method."""
    shown = {a: v for a, v in PRECISION.items() if content["curves"].get(a)}
    if not shown:
        return None
    figure, grid = plt.subplots(
        len(shown),
        3,
        figsize=(12, 3.6 * len(shown) + 0.4),
        squeeze=False,
        layout="constrained",
    )
    for row, (axis, (what, errors)) in zip(grid, shown.items(), strict=True):
        points = content["curves"][axis]
        for axes, (error, title) in zip(row, errors.items(), strict=True):
            for method, all_ in by(points, "relaxer").items():
                plot(axes, all_, error, method, STYLES.get(method, "ko-"))
            axes.set(xlabel="seconds", ylabel=title)
            label_decades(axes)
        row[0].set_title(f"{what}, {points[0]['particles']} particles", loc="left")
    finish(figure, grid.flat)
    return figure


PANELS = {
    "smoothing": (
        "smoothing",
        {
            "position_rms": "position, rms (r0)",
            "energy_relative": "energy of the default law, relative",
        },
    ),
    "skin": (
        "skin",
        {
            "position_rms": "position, rms (r0)",
            "residual": "largest force (F(0))",
        },
    ),
    "contact-sharpness": (
        "sharpness",
        {
            "force_against_nearest": "force against nearest triangle, relative",
            "position_rms": "position against sharpest, rms (r0)",
            "metrics.height_mm": "height against sharpest, relative",
        },
    ),
}
"""Axes of a number: its entry in a point, and the errors that are shown."""

ABOVE = {
    "loc": "lower left",
    "bbox_to_anchor": (0, 1.0),
    "frameon": False,
    "fontsize": 8,
    "borderaxespad": 0.2,
}
"""A legend above its panel."""


def draw_axes(content: dict[str, Any]) -> Any:
    """Error and seconds along the other axes."""
    curves = content["curves"]
    shown = [axis for axis in (*PANELS, "dtype") if curves.get(axis)]
    if not shown:
        return None
    across = min(len(shown), 2)
    down = -(-len(shown) // across)
    figure, grid = plt.subplots(
        down,
        across,
        figsize=(5.6 * across, 4.4 * down),
        squeeze=False,
        layout="constrained",
    )
    for axes, axis in zip(grid.flat, shown, strict=False):
        points = curves[axis]
        if axis == "dtype":
            draw_types(axes, points)
        else:
            draw_axis(axes, points, *PANELS[axis])
        method, size = points[0]["relaxer"], points[0]["particles"]
        lines = len(axes.get_legend_handles_labels()[1])
        axes.set_title(
            f"{axis.replace('-', ' ')}: {method}, {size} particles" + "\n" * lines,
            loc="left",
            fontsize=10,
            pad=10,
        )
        axes.grid(True, color="0.92", lw=0.6)
        axes.set_axisbelow(True)
    for axes in grid.flat[len(shown) :]:
        axes.set_visible(False)
    return figure


def draw_axis(
    axes: Axes, points: list[Point], entry: str, errors: dict[str, str]
) -> None:
    """Errors against a number, and on the right the seconds with their quartiles."""
    x = [p[entry] for p in points]
    for number, (error, name) in enumerate(errors.items()):
        y = [error_of(p, error) for p in points]
        axes.loglog(x, y, f"C{number}o-", ms=4, label=name)
    axes.set_xticks(x, [f"{value:g}" for value in x])
    axes.set_xticks([], minor=True)
    axes.set(xlabel=entry, ylabel="error")
    right = axes.twinx()
    low, high = zip(*[p["seconds"]["quartiles"] for p in points], strict=True)
    median = [p["seconds"]["median"] for p in points]
    right.plot(x, median, "--", color="0.5", lw=1)
    right.vlines(x, low, high, color="0.5", lw=3, alpha=0.5)
    right.set_ylim(0, 1.15 * max(high))
    right.set_ylabel("seconds", color="0.4")
    axes.plot([], [], "--", color="0.5", lw=1, label="seconds (right)")
    axes.legend(**ABOVE)


def draw_types(axes: Axes, points: list[Point]) -> None:
    """Error against seconds in 64 and in 32 bits, tolerances beside the points."""
    for number, (dtype, all_) in enumerate(by(points, "dtype").items()):
        plot(axes, all_, "position_rms", f"{dtype}, position, rms (r0)", f"C{number}o-")
        for point in all_:
            axes.annotate(
                f"{point['tolerance']:.0e}".replace("e-0", "e-"),
                (point["seconds"]["median"], error_of(point, "position_rms")),
                xytext=(0, -11 if number else 5),
                textcoords="offset points",
                ha="center",
                fontsize=7,
                color=f"C{number}",
            )
    axes.set_xscale("linear")
    axes.margins(0.12, 0.15)
    axes.set(xlabel="seconds (at each point: tolerance)", ylabel="error")
    axes.legend(**ABOVE)


def draw_ratios(content: dict[str, Any]) -> Any:
    """Every row's median and quartiles over its bar: left of 1 it is reached.

    Where more is better, the bar is drawn over the ratio.
    """
    rows = list(content["rows"].values())[::-1]
    if not rows:
        return None
    figure, axes = plt.subplots(
        figsize=(9, 0.34 * len(rows) + 1.2), layout="constrained"
    )
    colours = {None: "0.6", True: "C2", False: "C3"}
    names = {None: "no bar", True: "reached", False: "not reached"}
    seen: set[bool | None] = set()
    texts = []
    for place, row in enumerate(rows):
        bar = 1.0 if row["bar"] is None else row["bar"]
        least = row["side"] == "least" and row["bar"] is not None
        shares = [
            bar / value if least else value / bar
            for value in (row["ratio"], *row["ratios"]["quartiles"])
        ]
        passed = row["passed"]
        label = None if passed in seen else names[passed]
        seen.add(passed)
        low, high = min(shares), max(shares)
        axes.plot([low, high], [place, place], color=colours[passed], lw=5, alpha=0.4)
        axes.plot(shares[0], place, "o", color=colours[passed], label=label)
        text = f"{row['ratio']:.3g}"
        if row["bar"] is not None:
            text += f"  ({'≥' if least else '≤'} {row['bar']:g})"
        texts.append(text)
    axes.axvline(1.0, color="k", lw=0.8)
    axes.set_xscale("log")
    label_decades(axes)
    axes.set_yticks(range(len(rows)), [row["name"] for row in rows])
    axes.set_ylim(-0.6, len(rows) - 0.4)
    axes.set_xlabel("median [quartiles] over the bar; left of the line it is reached")
    right = axes.secondary_yaxis("right")
    right.set_yticks(range(len(rows)), texts)
    right.tick_params(length=0)
    axes.grid(True, axis="x", color="0.92", lw=0.6)
    figure.legend(loc="outside upper center", ncol=3, frameon=False)
    return figure
