"""Report of a growth: request, outcome, and the versions that decide it."""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import math
import os
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8


if TYPE_CHECKING:
    from jaxgrow.growth.result import Growth
    from jaxgrow.organ.organ import Organ
    from jaxgrow.scene.scene import Scene


FORMAT = 1
"""Version of the report's format, raised when an entry changes its meaning or place."""

GROWING = (
    "jaxgrow",
    "jax",
    "jaxlib",
    "jax-md",
    "equinox",
    "numpy",
    "scipy",
    "trimesh",  # reads organs
    "numba",  # compiles the loops of jaxgrow.kernels; "loops" tells whether they ran
)
"""Distributions whose version may change a growth."""

FITTING = (*GROWING, "optax")
"""Distributions whose version may change a fit: its growths and its steps."""

DECISIVE = (*GROWING, "pillow", "embreex")
"""Distributions whose version may change a growth or its picture."""


def make_report(
    growth: Growth, label: UInt8[np.ndarray, " m"] | None
) -> dict[str, Any]:
    """Build the content of ``report.json``, except the audit.

    Lengths are in mm, forces in F(0), times in seconds. Numbers that are not finite
    are None.

    Args:
        growth: the growth.
        label: of every vertex of the grown organ (0 healthy, 1 lesion); None for a
            free cluster.
    """
    import jax

    from jaxgrow.mesh.audit import audit_surface
    from jaxgrow.metrics import measure

    _, species = growth.particles()
    outcome: dict[str, Any] = {
        "result": growth.result.name,
        "sentence": growth.result.sentence,
        "success": growth.result.success,
        "divisions": growth.events.divisions,
        "size_mm": growth.size_mm,
        "mended": growth.mended,
        "metrics": measure(growth.state),
    }
    counts = {
        "particles": len(species),
        "tissue": int((species == 0).sum()),
        "tumour": int((species == 1).sum()),
    }
    if label is not None and growth.organ is not None:
        before = audit_surface(growth.organ.vertices, growth.organ.faces)
        counts["vertices_healthy"] = int((label == 0).sum())
        counts["vertices_lesion"] = int((label == 1).sum())
        counts["euler_number_before"] = before.euler_number
    report = {
        "format": FORMAT,
        "request": {
            "scene": describe_scene(growth.scene, growth.organ),
            "seed": growth.seed,
            "tolerance": growth.tolerance,
        },
        "outcome": outcome,
        "counts": counts,
        "history": [record.as_dict() for record in growth.history],
        "seconds": growth.seconds,
        "compilations": growth.compilations,
        "loops": growth.descents.entry(),
        "versions": versions(),
        "machine": {
            "platform": platform.platform(),
            "processors": os.cpu_count(),
            "device": jax.devices()[0].device_kind,
            "backend": jax.default_backend(),
        },
    }
    return plain(report)


def describe_scene(scene: Scene, organ: Organ | None) -> dict[str, Any]:
    """Describe a scene as nested entries, with its defaults filled in.

    Args:
        scene: the scene.
        organ: its organ, built or read, which has the side of the tissue.
    """
    given = scene.organ
    if given is not None and not isinstance(given, str | Path):
        given = given.name
    return {
        "organ": given,
        "unit_mm": scene.unit_mm,
        "tissue": scene.tissue if organ is None else organ.tissue,
        "lesion": {
            **scene.lesion.model_dump(),
            "target_mm": scene.lesion.target_mm,
            "particle_mm": scene.r0_mm,
        },
        "parameters": named(scene.parameters),
        "surroundings": scene.surroundings.model_dump(),
    }


def versions(names: Sequence[str] = DECISIVE) -> dict[str, str | None]:
    """Return the versions of Python and of all distributions that matter.

    A distribution that is not installed has None.
    """
    found: dict[str, str | None] = {"python": platform.python_version()}
    for name in names:
        found[name] = None
        with contextlib.suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def named(tree: Any) -> dict[str, Any]:
    """Return the fields of a dataclass or named tuple as a mapping."""
    if isinstance(tree, Mapping):
        return dict(tree)
    if dataclasses.is_dataclass(tree):
        names = [field.name for field in dataclasses.fields(tree)]
    else:
        names = list(tree._fields)
    return {name: getattr(tree, name) for name in names}


def plain(value: Any) -> Any:
    """Convert a value to JSON's types; non-finite numbers become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, enum.Enum):
        return value.name
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return plain(np.asarray(value).tolist())
