"""The type checker of a user sees the public names, and the mistakes made with them."""

import json
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest


ROOT = Path(__file__).parents[1]

RIGHT = """\
from typing import assert_type

import numpy as np

import jaxgrow as jg


class Counted:
    suffix = "counted"

    def write(self, mesh: jg.SurfaceMesh) -> bytes:
        return str(len(mesh.vertices)).encode()


@jg.register_metric
def reach_mm(state: jg.State) -> float:
    return float(state.frame.particle_mm)


@jg.register_organ
def ball() -> jg.Organ:
    return jg.Organ("ball", np.zeros((4, 3)), np.zeros((4, 3), int), "inside")


jg.register_format(Counted())
scene = jg.Scene(organ="uterus", lesion=jg.Polyp(divisions=3, particle_mm=1.5))
growth = jg.grow(scene, seed=0, parameters={"spring_stiffness": 0.08})
assert_type(growth, jg.Growth)
assert_type(growth.result, jg.Result)
assert_type(growth.state, jg.State)
assert_type(jg.relax(growth.state.particles), jg.Relaxation)
assert_type(jg.audit(growth), jg.Audit)
assert_type(reach_mm(growth.state), float)
assert_type(ball(), jg.Organ)
jg.write_run(growth, "run", formats=["counted"])
jg.relax(growth.state.particles, method="lbfgs")
jg.fit(scene, {"height_mm": (9.0, 0.5)}, {"adhesion": jg.Bounds(low=0.1, high=0.3)})
"""

WRONG = [
    "jg.grow(3)",
    'jg.grow(jg.Scene(), sed="a")',
    "jg.uterus().vertexes",
    "jg.grwo",
    "jg.register_organ(lambda: 3)",
    "jg.register_format(jg.Scene())",
]


def complaints(folder, text):
    """Rules and lines of what the checker finds in a user's file."""
    checker = shutil.which("basedpyright", path=str(Path(sys.executable).parent))
    assert checker is not None
    (folder / "user.py").write_text(text)
    settings = {"typeCheckingMode": "standard", "extraPaths": [str(ROOT)]}
    (folder / "pyrightconfig.json").write_text(json.dumps(settings))
    command = [checker, "--pythonpath", sys.executable, "--outputjson", "-p", folder]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    found = json.loads(done.stdout)["generalDiagnostics"]
    return [(each["range"]["start"]["line"], each["message"]) for each in found]


@pytest.mark.skipif(
    find_spec("basedpyright") is None, reason="the type checker is in the extra check"
)
def test_checker_of_a_user_finds_mistakes_and_nothing_else(tmp_path):
    found = complaints(tmp_path, RIGHT + "\n".join(WRONG) + "\n")
    first = len(RIGHT.splitlines())
    assert [message for line, message in found if line < first] == []
    assert {line - first for line, _ in found} == set(range(len(WRONG)))
