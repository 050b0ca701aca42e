"""Pictures of the studies of shapes: lesions side by side, metrics by resolution."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from PIL import Image, ImageDraw, ImageFont


mpl.use("Agg")
import matplotlib.pyplot as plt


Row = dict[str, Any]
"""Growth with its request, result, metrics and seconds."""

METRICS = {
    "length_mm": "length",
    "width_mm": "width",
    "neck_width_mm": "neck",
    "volume_mm3": "volume",
    "area_mm2": "area",
    "sphericity": "sphericity",
}
"""Metrics that the figure of the resolution shows, with their labels."""


def draw_side_by_side(rows: list[Row], keep: Path, to: Path) -> None:
    """Draw the surface views of runs side by side."""
    side, text = 480, 64
    across = len(rows) if len(rows) < 6 else 4
    down = -(-len(rows) // across)
    whole = Image.new("RGB", (across * side, down * (side + text)), "white")
    write = ImageDraw.Draw(whole)
    font = ImageFont.load_default(19)
    for k, row in enumerate(rows):
        page = Image.open(keep / f"{row['name']}_{row['seed']}" / "growth.png")
        view = page.convert("RGB").crop((0, 0, 900, 900)).resize((side, side))
        x, y = k % across * side, k // across * (side + text)
        whole.paste(view, (x, y))
        shape = row["metrics"]
        numbers = (
            f"{row['name']}: {row['size_mm']:.1f} mm",
            f"height/width {shape['height_to_width']:.2f}, "
            f"neck/width {shape['neck_to_width']:.2f}",
        )
        write.text((x + 12, y + side + 6), "\n".join(numbers), "black", font)
    whole.quantize(256).save(to, optimize=True)


def means_by_size(rows: list[Row], rule: str, metric: str) -> np.ndarray:
    """Return size of the particles, mean and standard error, a row per size."""
    values: dict[float, list[float]] = {}
    for row in rows:
        kind, size = row["name"].split()
        if kind == rule and row["result"] == "REACHED":
            values.setdefault(float(size), []).append(row["metrics"][metric])
    return np.array(
        [
            (size, np.mean(some), np.std(some, ddof=1) / np.sqrt(len(some)))
            for size, some in sorted(values.items())
            if len(some) > 1
        ]
    )


def seconds_by_size(rows: list[Row], rule: str) -> np.ndarray:
    """Return size of the particles and median seconds, a row per size."""
    sizes = means_by_size(rows, rule, "length_mm")[:, 0]
    return np.array(
        [
            (size, np.median([r["seconds"] for r in rows if r["name"] == name]))
            for size in sizes
            for name in [f"{rule} {size:g}"]
        ]
    )


def draw_resolution(rows: list[Row], to: Path) -> None:
    """Draw metrics against the size of the particles, over those of the finest."""
    rules = {"focus": "from a focus", "paper": "by the paper's rule"}
    there = [r for r in rules if len(means_by_size(rows, r, "length_mm")) > 1]
    if not there:
        return
    figure, panels = plt.subplots(
        1, len(there) + 1, figsize=(4.2 * (len(there) + 1), 3.8), squeeze=False
    )
    for panel, rule in zip(panels[0], there, strict=False):
        for shift, (metric, label) in enumerate(METRICS.items()):
            size, mean, error = means_by_size(rows, rule, metric).T
            off = 0.006 * (shift - len(METRICS) / 2)
            panel.errorbar(
                size + off, mean / mean[0], error / mean[0], marker="o", label=label
            )
        panel.axhspan(0.95, 1.05, color="0.9")
        panel.set_title(f"A polyp of 9 mm {rules[rule]}", fontsize=10)
        panel.set_xlabel("size of the particles, mm")
        panel.set_ylabel("mean over that of the finest")
        panel.legend(fontsize=8, ncols=2)
    for rule in there:
        panels[0, -1].plot(
            *seconds_by_size(rows, rule).T, marker="o", label=rules[rule]
        )
    panels[0, -1].set_xlabel("size of the particles, mm")
    panels[0, -1].set_ylabel("seconds, median")
    panels[0, -1].set_yscale("log")
    panels[0, -1].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(to, dpi=110)
    plt.close(figure)
