"""What README and guides say is so: examples run, names exist, figures are measured."""

import json
import math
import os
import re
import shlex
import subprocess
import sys
import tomllib
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import jax
import pytest
import typer

from jaxgrow.calibration.spec import make_task
from jaxgrow.cli.main import app
from jaxgrow.runtime.results import Result
from jaxgrow.scene.scene import make_scene


ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "experiments" / "results"
GUIDES = ROOT / "jaxgrow" / "guides"
PAGES = [ROOT / "README.md", *sorted(GUIDES.glob("*.md"))]
LINKED = [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]

pages = pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
links = pytest.mark.parametrize("path", LINKED, ids=lambda path: path.stem)

BLOCK = re.compile(r"(<!-- not run: (.+?) -->\n)?^```(\w*)\n(.*?)^```", re.M | re.S)


def blocks(path: Path, language: str) -> list[str]:
    """The blocks of a page that are in a language, and not marked as not run."""
    found = BLOCK.finditer(path.read_text())
    return [m[4] for m in found if m[3] == language and m[1] is None]


def words(path: Path) -> str:
    """A page's text with every run of blanks as one."""
    return " ".join(path.read_text().split())


def value(file: str, place: str) -> Any:
    """A number of a file of results; `place` is its path of keys and row numbers."""
    found = json.loads((RESULTS / f"{file}.json").read_text())
    for key in place.split("/"):
        found = found[int(key) if isinstance(found, list) else key]
    return found


# --- examples -------------------------------------------------------------------------

WITH_PYTHON = [path for path in PAGES if blocks(path, "python")]


@pytest.mark.parametrize("path", WITH_PYTHON, ids=lambda path: path.stem)
def test_python_of_a_page_runs_from_top_to_bottom(path, tmp_path):
    script = tmp_path / "page.py"
    script.write_text("\n".join(blocks(path, "python")))
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    if jax.config.jax_compilation_cache_dir:
        environment |= {
            "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir
        }
    done = subprocess.run(
        [sys.executable, str(script)],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


@pages
def test_a_block_that_is_not_run_is_of_python_and_says_why(path):
    reasons = [m for m in BLOCK.finditer(path.read_text()) if m[1] is not None]
    assert all(m[3] == "python" and len(m[2].split()) >= 5 for m in reasons)
    assert path.read_text().count("<!-- not run") == len(reasons)


@pages
def test_toml_of_a_page_is_a_scene_or_targets(path):
    for text in blocks(path, "toml"):
        entries = tomllib.loads(text)
        make = make_task if "targets" in entries else make_scene
        make(entries, source=path.name)


# --- names ----------------------------------------------------------------------------


def commands(path: Path) -> list[list[str]]:
    """Every `jaxgrow …` of a page's shell blocks and inline code, as words."""
    text = path.read_text()
    shell = "\n".join(m[4] for m in BLOCK.finditer(text) if m[3] in ("bash", "sh"))
    inline = re.findall(r"`((?:jaxgrow|experiments/\S+\.py) [^`]*)`", text)
    lines = [part for line in shell.splitlines() for part in line.split(" && ")]
    split = [shlex.split(line, comments=True) for line in [*lines, *inline]]
    return [line for line in split if line]


@pages
def test_commands_of_a_page_have_the_options_that_it_names(path):
    known = typer.main.get_command(app).commands
    for program, *rest in commands(path):
        if Path(program).name != "jaxgrow":
            continue
        rest = [word.strip("[]") for word in rest]
        assert rest[0] in known, rest
        options = {name for p in known[rest[0]].params for name in p.opts}
        assert {word for word in rest if word.startswith("--")} <= options, rest


@pages
def test_scripts_of_a_page_exist_with_the_words_that_they_are_given(path):
    for program, *rest in commands(path):
        if not program.startswith("experiments/"):
            continue
        source = (ROOT / program).read_text()
        if (
            program == "experiments/speed_error.py"
        ):  # rows are named where they are made
            source += "".join(
                p.read_text() for p in (ROOT / "experiments").rglob("*.py")
            )
        given = [word for word in rest if not word.isdigit()]
        assert all(word in source for word in given), (program, given)


@pages
def test_extras_that_a_page_installs_exist(path):
    known = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = re.findall(r"'\S*\[([\w,]+)\]'", path.read_text())
    named = {name for extra in extras for name in extra.split(",")}
    assert named <= set(known["optional-dependencies"])


@pages
def test_files_that_a_page_names_exist(path):
    named = re.findall(
        r"`((?:jaxgrow|tests|experiments|notebooks)/[\w/.]+)`", path.read_text()
    )
    assert [name for name in named if not (ROOT / name).exists()] == []


@links
def test_links_of_a_page_lead_somewhere(path):
    for target in re.findall(r"\]\((?!\w+:)([^)\s]+)\)", path.read_text()):
        place, _, anchor = target.partition("#")
        file = (path.parent / place).resolve() if place else path
        assert file.exists(), target
        if anchor:
            titles = re.findall(r"^#+ (.*)$", file.read_text(), re.M)
            anchors = [re.sub(r"[^\w -]", "", t).lower() for t in titles]
            assert anchor in [a.replace(" ", "-") for a in anchors], target


@pages
def test_outcomes_that_a_page_names_are_results(path):
    other = {"UNREACHED", "JAXGROW_KERNELS"}  # of a fit; an environment variable
    named = set(re.findall(r"`([A-Z]+_?[A-Z]+)`", path.read_text())) - other
    assert named <= set(Result.__members__)


def test_architecture_names_functions_that_are_where_it_says():
    pairs = re.findall(
        r"`(\w+)`\s+(?:in|of)\s+`(jaxgrow/[\w/]+\.py)`",
        (GUIDES / "architecture.md").read_text(),
    )
    assert len(pairs) >= 20
    for name, file in pairs:
        source = (ROOT / file).read_text()
        assert re.search(rf"^(?:def|class) {name}\b", source, re.M), (name, file)


def test_architecture_has_every_folder_of_the_package():
    table = (GUIDES / "architecture.md").read_text()
    folders = {p.parent.name for p in (ROOT / "jaxgrow").glob("*/__init__.py")}
    assert {f for f in folders if f"| `jaxgrow/{f}/` |" not in table} == set()


# --- pages ----------------------------------------------------------------------------


def load_tables():
    """The script that makes the guides' tables, which is not installed."""
    file = ROOT / "experiments" / "guide_tables.py"
    spec = spec_from_file_location("guide_tables", file)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules["guide_tables"] = module
    spec.loader.exec_module(module)
    return module


@pages
def test_tables_of_a_page_are_what_the_models_say(path):
    text = path.read_text()
    assert load_tables().with_tables(text) == text, "python experiments/guide_tables.py"


def test_scenes_and_calibration_have_a_table_of_every_model():
    both = (GUIDES / "scenes.md").read_text() + (GUIDES / "calibration.md").read_text()
    named = set(re.findall(r"<!-- table: [\w.]+\.(\w+) -->", both))
    scene = {"Scene", "Lesion", "Polyp", "Myoma", "Surroundings", "Parameters"}
    assert named == scene | {"Task", "Target", "Bounds", "Effort", "ShapeMetrics"}


def test_readme_has_at_most_150_lines():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


def test_readme_and_the_site_lead_to_every_guide():
    readme, site = (ROOT / "README.md").read_text(), (ROOT / "mkdocs.yml").read_text()
    for path in GUIDES.glob("*.md"):
        assert f"(jaxgrow/guides/{path.name})" in readme
        assert f": {path.name}\n" in site


# --- figures --------------------------------------------------------------------------


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


@pytest.mark.parametrize("name", ["README", "model", "calibration", "speed", "limits"])
def test_pages_with_older_figures_say_that_they_are_from_before_bending(name):
    (path,) = [path for path in PAGES if path.stem == name]
    assert re.search(r"before bending was the default", words(path), re.I)
