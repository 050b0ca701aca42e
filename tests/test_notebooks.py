"""Notebooks run in a fresh kernel, and are committed executed and paired."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import jupytext
import nbformat
import pytest
from ipykernel.kernelspec import write_kernel_spec


FOLDER = Path(__file__).parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
MEGABYTE = 1_000_000

notebooks = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def run(path: Path, scratch: Path) -> nbformat.NotebookNode:
    """A notebook after a run by this interpreter, with all its files in `scratch`.

    In a process of its own: what a client of a kernel leaves open is no warning here.
    """
    write_kernel_spec(scratch / "kernels" / "python3")
    copy = Path(shutil.copy(path, scratch / "run.ipynb"))
    environment = os.environ | {
        "IPYTHONDIR": str(scratch / "ipython"),
        "JUPYTER_PATH": str(scratch),
        "JUPYTER_RUNTIME_DIR": str(scratch / "runtime"),
        "TMPDIR": str(scratch),
    }
    environment.pop("MPLBACKEND", None)
    if jax.config.jax_compilation_cache_dir:
        environment |= {
            "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir,
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
            "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        }
    client = "from nbclient.cli import main; main()"
    command = [sys.executable, "-c", client, "--inplace", "--timeout=600", str(copy)]
    done = subprocess.run(
        command, env=environment, cwd=scratch, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return nbformat.read(copy, as_version=4)


def outputs(notebook: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    return [output for cell in code(notebook) for output in cell.outputs]


def code(notebook: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def pictures(notebook: nbformat.NotebookNode) -> int:
    return sum("image/png" in output.get("data", {}) for output in outputs(notebook))


def is_complaint(output: nbformat.NotebookNode) -> bool:
    return output.output_type == "error" or output.get("name") == "stderr"


def test_there_are_notebooks():
    assert NOTEBOOKS


@notebooks
def test_a_notebook_runs_in_a_fresh_kernel_without_a_complaint(path, tmp_path):
    committed = pictures(nbformat.read(path, as_version=4))
    notebook = run(path, tmp_path)
    assert [output for output in outputs(notebook) if is_complaint(output)] == []
    assert pictures(notebook) == committed


@notebooks
def test_a_notebook_is_committed_executed_from_top_to_bottom(path):
    notebook = nbformat.read(path, as_version=4)
    cells = code(notebook)
    assert [cell.execution_count for cell in cells] == [*range(1, len(cells) + 1)]
    assert [output for output in outputs(notebook) if is_complaint(output)] == []
    assert pictures(notebook) > 0


@notebooks
def test_a_notebook_has_the_cells_of_its_script(path):
    notebook = nbformat.read(path, as_version=4)
    script = jupytext.read(path.with_suffix(".py"))
    cells = [(cell.cell_type, cell.source) for cell in notebook.cells]
    assert cells == [(cell.cell_type, cell.source) for cell in script.cells]


@notebooks
def test_a_notebook_is_a_small_file(path):
    assert path.stat().st_size < 1.5 * MEGABYTE


def test_every_script_has_its_notebook():
    scripts = {path.stem for path in FOLDER.glob("*.py")}
    assert scripts == {path.stem for path in NOTEBOOKS}


def test_a_failing_cell_fails_the_run(tmp_path):
    path = tmp_path / "failing.ipynb"
    cell = nbformat.v4.new_code_cell("1 / 0")
    nbformat.write(nbformat.v4.new_notebook(cells=[cell]), path)
    with pytest.raises(AssertionError, match="ZeroDivisionError"):
        run(path, tmp_path)


def test_a_notebook_is_run_by_the_interpreter_of_the_tests(tmp_path):
    path = tmp_path / "which.ipynb"
    cell = nbformat.v4.new_code_cell("import sys; print(sys.executable)")
    nbformat.write(nbformat.v4.new_notebook(cells=[cell]), path)
    (output,) = outputs(run(path, tmp_path))
    assert output.text.strip() == sys.executable
