"""What the guide for contributors says runs as it stands there."""

import re
from pathlib import Path


GUIDE = Path(__file__).parents[1] / "CONTRIBUTING.md"


def test_recipes_run_as_they_are_written(registries):
    blocks = re.findall(r"^```python\n(.*?)^```", GUIDE.read_text(), re.M | re.S)
    assert len(blocks) == 8
    exec(compile("\n".join(blocks), str(GUIDE), "exec"), {"__name__": "guide"})


def test_files_that_the_recipe_names_are_there():
    text = GUIDE.read_text()
    named = set(re.findall(r"`((?:jaxgrow|tests)/[\w/]+\.py)`", text))
    assert len(named) >= 6
    root = GUIDE.parent
    new = {"jaxgrow/energy/film.py"}  # which the reader writes
    assert {n for n in named if not (root / n).exists()} == new
