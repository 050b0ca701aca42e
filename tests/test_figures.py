"""Figures in README and guides are those that were measured."""

import json
import math
import re
import statistics
from typing import Any

import pytest

from .pages import GUIDES, PAGES, RESULTS, ROOT, words


def value(file: str, place: str) -> Any:
    """A number of a file of results; `place` is its path of keys and row numbers."""
    found = json.loads((RESULTS / f"{file}.json").read_text())
    for key in place.split("/"):
        found = found[int(key) if isinstance(found, list) else key]
    return found


def rounded_up(number: float) -> str:
    """With two digits, none of which says too little."""
    place = math.floor(math.log10(number)) - 1
    return f"{math.ceil(number / 10**place) * 10**place:.1e}".replace("e-0", "e-")


def percent(digits: int):
    return lambda number: f"{100 * number:.{digits}f}"


def digits(count: int):
    return lambda number: f"{number:.{count}f}"


def spaced(number: int) -> str:
    return f"{number:,}".replace(",", " ")


ROWS = "rows/{}/ratios/median"
MORE = "full/expert/targets/{}/{}"

OF_GRADIENTS = ("derivatives", "gradient_exactness")

QUOTED = [
    ("README", "install", "install_megabytes", str, "installs in a minute and {} MB"),
    ("first_steps", "install", "first_growth_seconds", str, "growth took {} s"),
    ("first_steps", "install", "second_growth_seconds", str, "and {} s the second"),
    ("first_steps", "install", "python", str, "(Python {}, before bending"),
    ("model", "creases", "0/mean/above_45", percent(1), "of 10 mm {} %"),
    ("model", "creases", "0/standard_error/above_45", percent(1), "(± {}) are bent"),
    ("model", "creases", "2/mean/above_45", percent(2), "without it and {} %"),
    ("model", "creases", "2/standard_error/above_45", percent(2), "(± {}) with it"),
    ("model", "creases", "0/mean/above_90", percent(1), "with it, {} % and"),
    ("model", "creases", "2/mean/above_90", percent(2), "and {} % (two edges"),
    ("model", "creases", "2/mean/divisions", digits(0), "takes {} divisions"),
    ("model", "creases", "0/mean/divisions", digits(0), "instead of {} (means"),
    ("model", "creases", "2/mean/height_mm", digits(1), "its height is {} mm"),
    ("model", "creases", "0/mean/height_mm", digits(1), "instead of {} mm, its width"),
    ("model", "creases", "2/mean/width_mm", digits(1), "its width {} mm"),
    ("model", "creases", "0/mean/width_mm", digits(1), "instead of {} mm, and its"),
    ("model", "creases", "2/mean/neck_width_mm", digits(1), "its neck {} mm instead"),
    ("model", "creases", "0/mean/neck_width_mm", digits(1), "instead of {} mm: it is"),
    (*OF_GRADIENTS, "20/largest_error", rounded_up, "to {} after 20"),
    (*OF_GRADIENTS, "50/largest_error", rounded_up, "{} after 50"),
    (*OF_GRADIENTS, "200/largest_error", rounded_up, "{} after 200"),
    (*OF_GRADIENTS, "20/gradient_over_growth", digits(1), "{} times the growth"),
    (*OF_GRADIENTS, "50/gradient_over_growth", digits(1), "20 divisions, {} times"),
    (*OF_GRADIENTS, "200/gradient_over_growth", digits(1), "50 and {} times after"),
    (
        *OF_GRADIENTS,
        "20/seconds/first gradient of this process",
        digits(0),
        "took {} s",
    ),
    (
        *OF_GRADIENTS,
        "50/seconds/first gradient of this process",
        digits(0),
        "then {} s",
    ),
    (
        *OF_GRADIENTS,
        "200/seconds/first gradient of this process",
        digits(0),
        "and {} s",
    ),
    (*OF_GRADIENTS, "20/mb_per_division", digits(1), "It keeps {} to"),
    (*OF_GRADIENTS, "200/mb_per_division", digits(1), "to {} MB a division"),
    ("calibration", "calibration", "full/simplex/loss", digits(0), "a loss of {}, CMA"),
    ("calibration", "calibration", "full/expert/growths", str, "{} growths with part"),
    (
        "calibration",
        "calibration",
        MORE.format("height_to_width", "achieved"),
        digits(2),
        "`UNREACHED` at {} and",
    ),
    (
        "calibration",
        "calibration",
        MORE.format("neck_to_width", "achieved"),
        digits(2),
        "and {}, 2.4",
    ),
    (
        "speed",
        "speed_error",
        "rows/ensemble-start/seconds/start/median",
        digits(0),
        "takes {} s where",
    ),
    (
        "speed",
        "speed_error",
        "rows/ensemble/seconds/two/median",
        digits(0),
        "later ones take {},",
    ),
    (
        "speed",
        "speed_error",
        "rows/ensemble/seconds/one/median",
        digits(0),
        "one process takes {}",
    ),
    ("speed", "speed_error", ROWS.format("wide-list-10k"), digits(1), "found in, {}."),
    (
        "first_steps",
        "speed_error",
        ROWS.format("divisions-per-step-4"),
        digits(2),
        "equilibrium: {} of the time",
    ),
    (
        "first_steps",
        "speed_error",
        ROWS.format("divisions-per-step-2"),
        digits(2),
        "default; {} with two",
    ),
    (
        "first_steps",
        "speed_error",
        ROWS.format("divisions-per-step-8"),
        digits(2),
        "with two, {} with eight",
    ),
    ("limits", "guarantees_operations", "operations", spaced, "- {} swaps"),
    ("limits", "guarantees_operations", "fairings", str, "on {} spoilt"),
    ("limits", "guarantees_steps", "total/steps", spaced, "- {} accepted steps"),
    ("limits", "guarantees_steps", "total/self-intersections", str, "({} pairs of tri"),
    ("limits", "guarantees_pictures", "cavity/divisions", str, "deep, {} divisions"),
    ("limits", "guarantees_pictures", "os/divisions", str, "(8 mm, {} divisions"),
    (
        "limits",
        "guarantees_cost",
        "median_seconds/off",
        digits(2),
        "took {} s with coll",
    ),
    (
        "limits",
        "guarantees_cost",
        "median_seconds/auto",
        digits(2),
        "off, {} s as they",
    ),
    ("limits", "guarantees_cost", "median_seconds/on", digits(2), "and {} s with the"),
    ("limits", "guarantees_cost", "ratio_to_off/auto", digits(2), "(ratio {}, the"),
    ("limits", "guarantees_cost", "ratio_to_off/on", digits(2), "always on ({});"),
    ("limits", "guarantees_cost", "rows/on/0/height_mm", digits(2), "one: {} mm high"),
    ("limits", "guarantees_cost", "rows/off/0/height_mm", digits(2), "two are {} mm"),
]
"""Page, file of results, place in it, how it is printed, and the phrase around it."""


@pytest.mark.parametrize("page, file, place, printed, phrase", QUOTED)
def test_a_figure_is_the_one_that_was_measured(page, file, place, printed, phrase):
    if file == "gradient_exactness":  # its rows are named by their divisions
        wanted, _, rest = place.partition("/")
        rows = json.loads((RESULTS / f"{file}.json").read_text())["rows"]
        index = [row["divisions"] for row in rows].index(int(wanted))
        place = f"rows/{index}/{rest}"
    (path,) = [path for path in PAGES if path.stem == page]
    assert phrase.format(printed(value(file, place))) in words(path)


def mean_of(values):
    error = statistics.stdev(values) / math.sqrt(len(values))
    return f"{statistics.mean(values):.2f} ± {error:.2f}"


def test_gradients_of_a_polyp_from_a_focus_are_told_as_they_are():
    text = words(GUIDES / "derivatives.md")
    errors = value("gradient_focus", "rows/0/errors")
    raised = ("height_mm", "volume_mm3", "area_mm2")
    worst = max(own[metric] for own in errors.values() for metric in raised)
    assert f"agree to {rounded_up(worst)} after 50" in text
    across = [max(e["width_mm"], e["neck_width_mm"]) for e in errors.values()]
    good = sum(error < 5e-6 for error in across)
    assert f"to 5e-6 for {good} parameters; for the other {len(across) - good}" in text
    assert f"off by up to {rounded_up(max(across))} of the slope" in text
    assert f"for all {len(across)} parameters" in text


def test_default_polyps_are_told_as_they_grew():
    text = words(GUIDES / "model.md")
    rows = json.loads((RESULTS / "shapes_default.json").read_text())
    assert len(rows) == 20
    assert all(row["result"] == "REACHED" and row["clean"] for row in rows)
    worst = 100 * max(abs(row["error"]) for row in rows)
    assert f"all were reached, {worst:.1f} % off at most" in text
    height, ratio, neck = (
        mean_of([row["metrics"][metric] for row in rows])
        for metric in ("height_to_width", "neck_to_width", "neck_width_mm")
    )
    assert f"height over width of {height}, a neck over width of {ratio}" in text
    assert f"a neck of {neck} mm" in text
    bent = 100 * statistics.mean(row["above_45"] for row in rows)
    assert f"{bent:.2f} % are bent by more than 45°, and one edge of one" in text
    assert sum(row["above_90"] > 0 for row in rows) == 1
    seconds = statistics.mean(row["seconds"] for row in rows)
    assert f"A growth took {seconds:.0f} s" in text


def test_rows_of_necks_are_those_of_the_study():
    text = (GUIDES / "model.md").read_text()
    rows = json.loads((RESULTS / "shapes_neck.json").read_text())
    for name in dict.fromkeys(row["name"] for row in rows):
        own = [row for row in rows if row["name"] == name]
        assert all(row["clean"] and row["above_90"] == 0 for row in own)
        told = [
            mean_of([row["metrics"][metric] for row in own])
            for metric in ("neck_width_mm", "neck_to_width", "height_to_width")
        ]
        bent = 100 * statistics.mean(row["above_45"] for row in own)
        line = f"| {name} | {told[0]} mm | {told[1]} | {told[2]} | {bent:.2f} % |"
        assert line in text, line


def test_rows_of_heights_are_those_of_the_study():
    text = (GUIDES / "model.md").read_text()
    rows = json.loads((RESULTS / "shapes_height.json").read_text())

    for name in dict.fromkeys(row["name"] for row in rows):
        own = [row for row in rows if row["name"] == name]
        assert all(row["clean"] and row["above_45"] == 0 for row in own)
        shapes = [row["metrics"] for row in own]
        size = mean_of([row["size_mm"] for row in own])
        height, width, ratio = (
            mean_of([shape[metric] for shape in shapes])
            for metric in ("height_mm", "width_mm", "height_to_width")
        )
        count = statistics.mean(row["divisions"] for row in own)
        line = f"| {name} of the size | {size} mm | {height} mm | {width} mm | {ratio} "
        line += f"| {count:.0f} |"
        assert line in text, line


def test_rows_of_the_resolution_are_those_of_the_study():
    text = (GUIDES / "model.md").read_text()
    rows = json.loads((RESULTS / "shapes_resolution.json").read_text())
    sizes = [
        [row for row in rows if row["name"] == f"focus {size:g}"]
        for size in (0.9, 0.75, 0.6)
    ]
    assert all(len(own) == 8 and all(r["clean"] for r in own) for own in sizes)
    for metric, label in RESOLVED.items():
        means = [mean_of([row["metrics"][metric] for row in own]) for own in sizes]
        line = f"| {label} | {' | '.join(means)} |"
        assert line in text, line
    for field, told, of in (
        ("particles", "particles", statistics.mean),
        ("seconds", "seconds, median", statistics.median),
    ):
        cells = [f"{of(row[field] for row in own):.0f}" for own in sizes]
        line = f"| {told} | {' | '.join(cells)} |"
        assert line in text, line
    by_rule = [
        [row["metrics"]["width_mm"] for row in rows if row["name"] == f"paper {size:g}"]
        for size in (0.9, 0.75, 0.6)
    ]
    assert [len(own) for own in by_rule] == [5, 5, 4]
    first, second, third = map(mean_of, by_rule)
    told = f"their widths are {first}, {second} and {third} mm"
    assert told in words(GUIDES / "model.md")


RESOLVED = {
    "length_mm": "length, mm",
    "width_mm": "width, mm",
    "neck_width_mm": "neck, mm",
    "volume_mm3": "volume, mm³",
    "sphericity": "sphericity",
    "contact_angle_deg": "contact angle, degrees",
}


def test_rows_of_membranes_are_those_of_the_study():
    text = (GUIDES / "model.md").read_text()
    rows = json.loads((RESULTS / "shapes_membranes.json").read_text())
    for name in dict.fromkeys(row["name"] for row in rows):
        own = [row for row in rows if row["name"] == name]
        assert all(row["clean"] and row["above_90"] == 0 for row in own)
        height, neck, ratio, round_ = (
            mean_of([row["metrics"][metric] for row in own])
            for metric in (
                *("height_to_width", "neck_width_mm", "neck_to_width"),
                "sphericity",
            )
        )
        bent = 100 * statistics.mean(row["above_45"] for row in own)
        seconds = statistics.mean(row["seconds"] for row in own)
        line = f"| {name} | {height} | {neck} mm | {ratio} | {round_} "
        line += f"| {bent:.2f} % | {seconds:.0f} |"
        assert line in text, line


def test_mass_that_fills_the_cavity_is_told_as_it_grew():
    (row,) = json.loads((RESULTS / "shapes_cavity.json").read_text())
    assert row["clean"]
    assert row["result"] == "REACHED"
    told = f"{row['size_mm']:.1f} mm, {row['divisions']} divisions, audit clean"
    assert told in words(GUIDES / "limits.md")


def test_drawn_requests_are_told_as_they_ended():
    text = words(GUIDES / "limits.md")
    rows = json.loads((RESULTS / "shapes_requests.json").read_text())
    grown = [row for row in rows if row["result"] == "REACHED"]
    refused = [row for row in rows if row["result"] == "REFUSED"]
    assert len(grown) + len(refused) == len(rows) == 100
    assert all(row["clean"] for row in grown)
    worst = 100 * max(abs(row["error"]) for row in grown)
    assert f"{len(grown)} were reached, {worst:.1f} % off at most" in text
    assert all(row["lesion"]["kind"] == "myoma" for row in refused)
    assert all(row["lesion"]["site"] == "isthmus" for row in refused)
    least = min(row["lesion"]["size_mm"] for row in refused)
    assert f"The other {len(refused)}, myomas of {least:g} mm and more" in text
    of = {kind: [r for r in grown if r["lesion"]["kind"] == kind] for kind in KINDS}
    took = {k: statistics.median(row["seconds"] for row in of[k]) for k in KINDS}
    assert (
        f"median of {len(of['polyp'])} polyps is {took['polyp']:.0f} s, "
        f"that of {len(of['myoma'])} myomas {took['myoma']:.0f} s"
    ) in text
    bent = sum(row["above_90"] > 0 for row in grown)
    assert f"Of {bent} an edge is bent by more than 90°" in text


KINDS = ("polyp", "myoma")


def test_rows_of_requests_are_those_of_the_plate():
    text = (GUIDES / "scenes.md").read_text()
    rows = json.loads((RESULTS / "shapes_plate.json").read_text())
    assert len(rows) == 12
    for row in rows:
        assert row["clean"]
        assert row["above_90"] == 0
        assert not row.get("parameters")
        entries = ", ".join(
            f'{name} = "{value}"' if isinstance(value, str) else f"{name} = {value:g}"
            for name, value in row["lesion"].items()
        )
        shape = row["metrics"]
        cells = (
            *(row["name"], f"`{entries}`", f"{row['size_mm']:.1f} mm"),
            f"{shape['height_to_width']:.2f}",
            f"{shape['neck_to_width']:.2f}",
            *(str(row["divisions"]), f"{row['seconds']:.0f}"),
        )
        assert f"| {' | '.join(cells)} |" in text, cells


def test_rows_of_the_readme_are_those_of_the_growths():
    text = (ROOT / "README.md").read_text()
    for row in json.loads((RESULTS / "growths.json").read_text()):
        cells = (
            row["name"],
            f"{row['asked_mm']:g} mm",
            f"{row['size_mm']:.1f} mm",
            f"{row['metrics']['height_mm']:.1f} mm",
            str(row["divisions"]),
            f"{row['seconds']:.0f}",
            f"{row['largest_residual']:.1e}",
            f"{row['quality_min']:.2f}",
            "defects" if row["defects"] else "clean",
        )
        assert f"| {' | '.join(cells)} |" in text


FITS = ["low", "high", "both", "both-more", "both-high", "both-high-more", "simplex"]


def as_told(error: float) -> str:
    """With one digit after the point, or none from 10 on."""
    return f"{error:.1f}" if error < 10 else f"{error:.0f}"


def test_fits_of_planted_parameters_are_told_with_what_they_missed():
    lines = (GUIDES / "calibration.md").read_text().splitlines()
    rows = [line for line in lines if re.match(r"\| (stiffness|both|on from)", line)]
    for name, line in zip(FITS, rows, strict=False):
        fit = value("calibration", f"full/{name}")
        assert fit["outcome"] == "UNREACHED"
        assert f"| {fit['growths']} |" in line
        reached = [target["reached"] for target in fit["targets"].values()]
        assert f"{sum(reached)} of {len(reached)}" in line
        if name != "simplex":
            for found in fit["parameters"].values():
                assert f"{as_told(100 * found['error'])} % (" in line
    assert "**All fits of planted parameters ended `UNREACHED`**" in words(
        GUIDES / "calibration.md"
    )


SPEED = [
    "relax-10k-over-jax-md",
    "relax-10k-over-numba",
    "pair-force-10k",
    "pair-force-100k",
    "contact-force",
    "contact-force-in-a-loop",
    "grow-100-over-numba",
    "grow-300-over-numba",
    "grow-1000-over-numba",
    "grow-3000-over-numba",
    "grow-1000-over-jax-md",
    "division-100k-over-10k",
    "division-100k-local",
    "polyp-200",
    "myoma-300",
    "organ-100000",
    "ensemble",
    "ensemble-start",
    "fairing",
    "start-up",
    "memory-100k",
]


def test_rows_of_speed_are_those_that_were_measured():
    text = (GUIDES / "speed.md").read_text()
    lines = text.split("|---|---|---|---|\n")[1].splitlines()
    for name, line in zip(SPEED, lines, strict=False):
        row = value("speed_error", f"rows/{name}")
        ratios = row["ratios"]
        shown = f"{ratios['median']:.3g}"
        if name != "grow-1000-over-jax-md":  # a single repetition
            low, high = ratios["quartiles"]
            shown += f" [{low:.3g}, {high:.3g}]"
        assert f"| {shown} |" in line, name
        assert ("reached" in line) == bool(row["passed"]), name


@pytest.mark.parametrize("name", ["model", "calibration", "speed", "limits"])
def test_pages_with_older_figures_say_that_they_are_from_before_bending(name):
    (path,) = [path for path in PAGES if path.stem == name]
    assert re.search(r"before bending was the default", words(path), re.I)
