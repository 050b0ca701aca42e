"""Printed loops are compiled once, and read from disk by every process after."""

import os
import subprocess
import sys


USE = """
import jax
jax.config.update("jax_enable_x64", True)
import jaxgrow as jg
from jaxgrow.equilibrium.loops import pair_module
jg.relax(jg.make_particles([[0.0, 0, 0], [0.9, 0, 0]]))
print(pair_module().root.cache_hits)
"""


def test_second_process_compiles_no_loop(tmp_path):
    environment = {**os.environ, "JAXGROW_LOOPS_CACHE": str(tmp_path)}

    def hits():
        done = subprocess.run(
            [sys.executable, "-c", USE], env=environment, capture_output=True, text=True
        )
        return done.stdout, done.stderr

    assert hits() == ("0\n", "")
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")}
    assert kept
    assert hits() == ("1\n", "")
    assert kept == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")}
