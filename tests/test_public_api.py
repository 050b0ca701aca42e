"""The names that are promised, and what importing them costs."""

import subprocess
import sys

import pytest

import jaxgrow as jg


PROMISED = [
    "A2",
    "Bounds",
    "Fit",
    "FitError",
    "Growth",
    "Myoma",
    "Organ",
    "OrganError",
    "Parameters",
    "Polyp",
    "Result",
    "Scene",
    "SceneError",
    "Surroundings",
    "Target",
    "audit",
    "audit_run",
    "fit",
    "grow",
    "grow_many",
    "linear_response",
    "load_organ",
    "load_scene",
    "make_scene",
    "read_run",
    "relax",
    "render_growth",
    "render_surface",
    "shape_metrics",
    "uterus",
    "write_run",
]


def _python(code):
    """The standard output of a fresh interpreter."""
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("name", sorted({*PROMISED, *jg.__all__}))
def test_public_name_is_what_its_module_defines(name):
    value = getattr(jg, name)
    assert name in jg.__all__
    assert getattr(value, "__name__", name) == name
    # a mapping has no module
    assert getattr(value, "__module__", "jaxgrow.").startswith("jaxgrow.")


def test_dir_lists_all_public_names():
    assert set(dir(jg)) == set(jg.__all__)


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'grwo'"):
        _ = jg.grwo


def test_importing_the_package_imports_nothing_heavy():
    code = (
        "import sys, jaxgrow; "
        "print(*{m.split('.')[0] for m in sys.modules} & "
        "{'jax', 'jax_md', 'numpy', 'scipy', 'trimesh', 'typer', 'equinox'})"
    )
    assert _python(code).strip() == ""


def test_importing_the_package_takes_a_tenth_of_a_second_at_most():
    code = (
        "import time; start = time.process_time(); import jaxgrow; "
        "print(time.process_time() - start)"
    )
    assert min(float(_python(code)) for _ in range(3)) < 0.1


def test_host_modules_work_without_jax():
    code = (
        "import sys; sys.modules['jax'] = None; "
        "import jaxgrow.mesh.fairing, jaxgrow.mesh.audit, jaxgrow.organ, "
        "jaxgrow.render, jaxgrow.io.export, jaxgrow.io.run_folder"
    )
    _python(code)


def test_lists_load_two_modules_of_jax_md_and_leave_the_package_to_others():
    # the whole package takes seconds to import
    code = (
        "import sys, numpy as np, jax; jax.config.update('jax_enable_x64', True); "
        "import jaxgrow.neighbors.verlet_list as nb; "
        "nb.allocate(jax.numpy.zeros((64, 3)) + "
        "3.0 * np.arange(64)[:, None]); "
        "print(*sorted(m for m in sys.modules if m.startswith('jax_md'))); "
        "listing = sys.modules['jax_md.partition']; import jax_md; "
        "print(jax_md.partition is listing, hasattr(jax_md, 'simulate'))"
    )
    loaded, whole = _python(code).splitlines()[-2:]
    modules = ("dataclasses", "partition", "space", "util")
    assert loaded.split() == [f"jax_md.{name}" for name in modules]
    assert whole.split() == ["True", "True"]


def test_lists_use_jax_md_as_it_is_if_it_is_there_already():
    code = (
        "import jax_md, jaxgrow.neighbors.cell_list as c; "
        "print(c._partition() is jax_md.partition)"
    )
    assert _python(code).split()[-1] == "True"


def test_importing_all_but_cells_does_not_import_jax_md():
    code = (
        "import sys, jaxgrow as jg; [getattr(jg, name) for name in jg.__all__]; "
        "print('jax_md' in sys.modules)"
    )
    assert _python(code).strip() == "False"


HEAVY = "jax", "jaxlib", "equinox", "numpy", "scipy", "numba", "trimesh"


@pytest.mark.parametrize("arguments", [["--help"], ["grow", "--help"], ["--version"]])
def test_help_takes_half_a_second_and_imports_nothing_heavy(arguments):
    # Processor time: what is measured on a busy machine is then our own.
    code = (
        "import sys, time; from jaxgrow.cli.main import main; "
        f"main({arguments!r}); print(time.process_time(), *sys.modules)"
    )
    found = [_python(code).splitlines()[-1].split() for _ in range(2)]
    loaded = {name.split(".")[0] for name in found[0][1:]}
    assert loaded & set(HEAVY) == set()
    # 0.3 s here, of which two thirds are typer's and rich's
    assert min(float(seconds) for seconds, *_ in found) < 0.8
