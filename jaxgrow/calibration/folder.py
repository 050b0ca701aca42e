"""Folder of a fit: growths and outcome, the fitted scene, and a plot.

===============  ====================================================================
``fit.json``     request, every growth made so far, and at the end the outcome
``fitted.toml``  the scene with the fitted parameters
``fit.png``      loss by evaluation, and targets against what is achieved
===============  ====================================================================

A folder with an outcome in its ``fit.json`` is complete: it is written last.
"""

import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxgrow.calibration.evaluations import Growths
from jaxgrow.calibration.outcome import Fit
from jaxgrow.calibration.plot import draw_fit
from jaxgrow.calibration.spec import FitError
from jaxgrow.io.report import named
from jaxgrow.organ import Organ, ORGANS
from jaxgrow.runtime.atomic_file import write_atomically
from jaxgrow.scene.scene import Scene


FILE = "fit.json"
SCENE = "fitted.toml"
PICTURE = "fit.png"


def check_folder(folder: Path, scene: Scene) -> None:
    """Raise if a fit could not be written to a folder.

    It may be new (it is created with its first file), empty, or hold a fit, which is
    then continued.

    Raises:
        FitError: it is a file, holds something else, or cannot be written to; or the
            scene's organ has no file that the fitted scene could name.
    """
    if isinstance(scene.organ, Organ):
        raise FitError(
            f"the organ {scene.organ.name!r} is in memory, and the scene that is "
            "written must name a file; save it, give its path, or leave out the folder."
        )
    if folder.exists() and not folder.is_dir():
        raise FitError(
            f"{folder} is a file, but a fit is written to a folder; give the name of "
            "a new one."
        )
    existing = folder.resolve()
    try:
        while not existing.exists():
            existing = existing.parent
        with tempfile.TemporaryDirectory(prefix=".jaxgrow-", dir=existing):
            pass
        names = sorted(e.name for e in folder.iterdir()) if folder.exists() else []
    except OSError as error:
        raise FitError(
            f"nothing can be written to {folder}: {error.strerror}; choose another "
            "folder."
        ) from error
    foreign = [n for n in names if n not in (FILE, SCENE, PICTURE) and n[0] != "."]
    if foreign:
        raise FitError(
            f"{folder} holds something else than a fit (there is {foreign[0]}); give "
            "a new folder."
        )


def write_folder(fit: Fit, growths: Growths, folder: Path) -> None:
    """Write the results of a fit; the outcome comes last."""
    text = scene_toml(fit.scene, folder)
    write_atomically(folder / SCENE, lambda file: file.write(text.encode()))
    draw_fit(fit, folder / PICTURE)
    growths.write(fit.as_dict())


def scene_toml(scene: Scene, folder: Path) -> str:
    """Format a scene as TOML for `jaxgrow.load_scene`, relative to a folder."""
    organ = scene.organ
    if organ is not None and organ not in ORGANS:
        organ = os.path.relpath(str(organ), folder)
    entries: dict[str, Any] = {} if organ is None else {"organ": organ}
    entries |= {"unit_mm": scene.unit_mm, "tissue": scene.tissue}
    numbers = {n: float(value) for n, value in named(scene.parameters).items()}
    tables = {
        "lesion": scene.lesion.model_dump(mode="json", exclude_none=True),
        "parameters": numbers,
        "surroundings": scene.surroundings.model_dump(mode="json", exclude_none=True),
    }
    lines = _lines(entries)
    for name, table in tables.items():
        lines += ["", f"[{name}]", *_lines(table)]
    return "\n".join(lines) + "\n"


def _lines(entries: Mapping[str, Any]) -> list[str]:
    # strings, numbers and lists of numbers look the same in JSON and in TOML
    return [
        f"{key} = {json.dumps(value, ensure_ascii=False)}"
        for key, value in entries.items()
    ]
