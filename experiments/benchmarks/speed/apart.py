"""Measuring in a process of its own, which prints what it found as JSON."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def apart(
    module: str, *arguments: Any, environment: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """The last line that a module of this package prints.

    Args:
        module: name of it.
        *arguments: of its command line.
        environment: variables that it gets as well.

    Raises:
        RuntimeError: it failed; with what it said.
    """
    path = os.pathsep.join(filter(None, sys.path))
    done = subprocess.run(
        [sys.executable, "-m", f"speed.{module}", *map(str, arguments)],
        cwd=Path(__file__).parents[1],
        env={**os.environ, "PYTHONPATH": path, **(environment or {})},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"{module} {arguments} failed: {done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])
