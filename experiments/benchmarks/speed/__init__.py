"""Yardsticks, rows and curves of the report on speed against error.

The yardsticks (`pairs`, `contact`, `lbfgs`, `fire`) are what others would run: plain
numba loops on one thread, and jax-md as it comes. The rows and curves measure jaxgrow
against them; `experiments/benchmarks/baselines.py` checks the yardsticks,
`experiments/benchmarks/speed_error.py` measures, and draws what it measured
(`figures`, `table`).
"""

import os
import sys
from importlib.util import find_spec


os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # XLA:CPU cache loader noise

if find_spec("matplotlib") is None:
    sys.exit(
        "matplotlib cannot be imported: install the extra of these experiments with "
        "pip install -e '.[speed]'"
    )
