"""What the guide for contributors says runs as it stands there."""

import re
from pathlib import Path


GUIDE = Path(__file__).parents[1] / "CONTRIBUTING.md"


def test_recipe_for_an_energy_term_runs_as_it_is_written():
    blocks = re.findall(r"^```python\n(.*?)^```", GUIDE.read_text(), re.M | re.S)
    assert len(blocks) == 4
    exec(compile("\n".join(blocks), str(GUIDE), "exec"), {"__name__": "guide"})


def test_files_that_the_recipe_names_are_there():
    text = GUIDE.read_text()
    named = set(re.findall(r"`((?:jaxgrow|tests)/[\w/]+\.py)`", text))
    assert len(named) >= 6
    root = GUIDE.parent
    new = {"jaxgrow/energy/tension.py"}  # which the reader writes
    assert {n for n in named if not (root / n).exists()} == new
