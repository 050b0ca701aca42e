"""What README and guides say is so: examples run, and what they name exists."""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import jax
import pytest
import typer

from jaxgrow.calibration.spec import make_task
from jaxgrow.cli.main import app
from jaxgrow.runtime.results import Result
from jaxgrow.scene.scene import make_scene

from .pages import GUIDES, LINKED, PAGES, ROOT


pages = pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
links = pytest.mark.parametrize("path", LINKED, ids=lambda path: path.stem)

BLOCK = re.compile(r"(<!-- not run: (.+?) -->\n)?^```(\w*)\n(.*?)^```", re.M | re.S)


def blocks(path: Path, language: str) -> list[str]:
    """The blocks of a page that are in a language, and not marked as not run."""
    found = BLOCK.finditer(path.read_text())
    return [m[4] for m in found if m[3] == language and m[1] is None]


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
            program == "experiments/benchmarks/speed_error.py"
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
    file = ROOT / "experiments" / "pages" / "guide_tables.py"
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
    assert load_tables().with_tables(text) == text, (
        "python experiments/pages/guide_tables.py"
    )


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
