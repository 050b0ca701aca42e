"""The hard cases of `tests/hard/cases`, a package that is not installed."""

import sys
from importlib import import_module
from pathlib import Path


sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "hard"))

_cases = import_module("cases")

CASES, Found, Row, measure = _cases.CASES, _cases.Found, _cases.Row, _cases.measure
coned = import_module("cases.examine").coned
hourglass = import_module("cases.organs").hourglass
