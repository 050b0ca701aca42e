"""A process forked from one that has computed is refused, and does not hang."""

import os
import subprocess
import sys

import pytest

from jaxgrow.equilibrium.relax import relax
from jaxgrow.growth.grow import grow
from jaxgrow.lesions.myoma import Myoma
from jaxgrow.runtime.forks import refuse_forked
from jaxgrow.scene.scene import Scene


def test_child_of_a_process_that_has_computed_is_refused():
    fork = (
        "import os, sys; from jaxgrow.runtime.forks import refuse_forked; "
        "refuse_forked();"
        "child = os.fork()\n"
        "if child: sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))\n"
        "refuse_forked()"
    )
    done = subprocess.run([sys.executable, "-c", fork], capture_output=True, text=True)
    assert done.returncode == 1
    assert 'start it by multiprocessing.get_context("spawn"), or use' in done.stderr


def test_child_of_a_process_that_has_not_computed_is_not():
    fork = (
        "import os, sys; from jaxgrow.runtime.forks import refuse_forked; "
        "child = os.fork()\n"
        "if child: sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))\n"
        "refuse_forked(); refuse_forked()"
    )
    subprocess.run([sys.executable, "-c", fork], check=True)


@pytest.mark.parametrize(
    "compute",
    [
        lambda: grow(Scene(organ=None, lesion=Myoma(divisions=1))),
        lambda: relax(None),
    ],
    ids=["grow", "relax"],
)
def test_growth_and_relaxation_are_refused(compute, monkeypatch):
    refuse_forked()
    here = os.getpid()
    monkeypatch.setattr(os, "getpid", lambda: here + 1)
    with pytest.raises(RuntimeError, match="was forked from one that had grown or"):
        compute()
