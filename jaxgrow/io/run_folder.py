"""Run folder: organ, particles, picture and report, complete or absent."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Integer, UInt8

from jaxgrow.io.export import (
    read_attributes,
    read_organ_ply,
    read_particles,
    write_atomically,
    write_mesh,
    write_particles,
)
from jaxgrow.io.formats.registry import check_formats, FORMATS
from jaxgrow.io.polyline import write_polyline
from jaxgrow.mesh.loop_subdivision import LEVELS


if TYPE_CHECKING:
    from jaxgrow.growth.result import Growth
    from jaxgrow.io.audit import Audit
    from jaxgrow.io.lesion_surface import LesionSurface


REPORT = "report.json"
PICTURE = "growth.png"
PARTICLES = "particles.ply"
ORGAN = "organ.ply"
RING = "base.obj"

_PARTIAL = ".jaxgrow-"


def _files() -> set[str]:
    """Return the names that files of a run may have."""
    meshes = (f"{name}.{suffix}" for name in ("organ", "refined") for suffix in FORMATS)
    return {REPORT, PICTURE, PARTICLES, RING, *meshes}


class RunFolderError(ValueError):
    """Error of a folder that cannot be written or read, for the user."""


@dataclass(frozen=True, eq=False)
class Run:
    """Content of a run folder.

    Attributes:
        vertices: of the whole organ in mm; None for a free cluster.
        faces: its triangles; None for a free cluster.
        label: of every vertex, 0 healthy, 1 lesion; None for a free cluster.
        position: of the particles, in mm.
        species: of the particles, 0 tissue, 1 tumour.
        report: the content of `jaxgrow.io.report.make_report`.
        attributes: further values of every vertex by name: ``lesion``, the smooth
            label, and ``region``; empty for a free cluster.
    """

    vertices: Float[np.ndarray, "m 3"] | None
    faces: Integer[np.ndarray, "f 3"] | None
    label: UInt8[np.ndarray, " m"] | None
    position: Float[np.ndarray, "n 3"]
    species: UInt8[np.ndarray, " n"]
    report: dict[str, Any]
    attributes: dict[str, np.ndarray] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Describe result, organ and particles in one line."""
        vertices = 0 if self.vertices is None else len(self.vertices)
        result = self.report.get("outcome", {}).get("result", "unknown")
        return f"Run({result}, {vertices} vertices, {len(self.position)} particles)"


def check_destination(directory: str | Path) -> None:
    """Raise, before a growth, if a run could not be written to a folder.

    A folder may be new, empty, or hold an earlier run, which will be replaced.

    Raises:
        RunFolderError: it is a file, holds something else, or cannot be written to.
    """
    directory = Path(directory).resolve()
    try:
        _check_content(directory)
        existing = directory
        while not existing.exists():
            existing = existing.parent
        with tempfile.TemporaryDirectory(prefix=_PARTIAL, dir=existing):
            pass
    except OSError as error:
        raise RunFolderError(
            f"nothing can be written to {directory}: {error.strerror}; "
            "choose another folder."
        ) from error


def _check_content(directory: Path) -> None:
    if not directory.exists():
        return
    if not directory.is_dir():
        raise RunFolderError(
            f"{directory} is a file, but a run is written to a folder; "
            "give the name of a new one."
        )
    names = [entry.name for entry in directory.iterdir()]
    known = _files()
    foreign = [n for n in names if n not in known and not n.startswith(_PARTIAL)]
    if foreign or (REPORT not in names and any(n in known for n in names)):
        example = sorted(foreign or names)[0]
        raise RunFolderError(
            f"{directory} is not empty and holds no earlier run alone "
            f"(there is {example}); give a new folder, or empty this one."
        )


def write_run(
    growth: Growth,
    directory: str | Path,
    formats: Sequence[str] = ("ply",),
    *,
    rim: bool = False,
    refine: int = 0,
) -> dict[str, Any]:
    """Write a growth's run folder atomically; it is complete or unchanged.

    Everything is written to a temporary folder first. A new folder then appears by
    one renaming. In a folder that exists, an earlier run's report is removed first and
    the new one comes last, so that a folder with a report is a complete run.

    ==================  =============================================================
    ``organ.ply``       the whole organ with the lesion, with smooth and integer label
                        and regions; none for a free cluster; also in other formats,
                        as ``organ.obj``
    ``refined.ply``     the same subdivided at the lesion, if asked; also ``.obj`` …
    ``base.obj``        the ring round the lesion's base, a closed polyline
    ``particles.ply``   positions, species and radii of all particles
    ``growth.png``      the surface view and the inner view
    ``report.json``     request, outcome, counts, residuals, seconds, versions, audit
    ==================  =============================================================

    Args:
        growth: the growth, successful or not.
        directory: the folder; see `check_destination`.
        formats: of the organ's surface, besides PLY: "obj", "stl", "glb", or one
            that was registered (`jaxgrow.register_format`).
        rim: remesh the organ's surface along the base's ring, so that the lesion is
            bounded by a smooth line of edges.
        refine: levels of Loop subdivision of the lesion, for ``refined.ply``; 0: none.
            A surface that would have defects is not written; the report tells why.

    Returns:
        The report.

    Raises:
        RunFolderError: the folder holds something else, or cannot be written to.
        ValueError: a format is unknown, or there are too many levels.
    """
    check_formats(formats)
    if not 0 <= refine <= LEVELS:
        raise ValueError(f"refine is {refine}; ask for 0 (none) to {LEVELS} levels.")
    directory = Path(directory).resolve()
    check_destination(directory)
    exists = directory.exists()
    if not exists:
        directory.parent.mkdir(parents=True, exist_ok=True)
    place = directory if exists else directory.parent
    with tempfile.TemporaryDirectory(prefix=_PARTIAL, dir=place) as temporary:
        partial = Path(temporary) / "run"
        partial.mkdir()
        report = _fill(growth, partial, formats, rim=rim, refine=refine)
        if exists:
            _replace(directory, partial)
        else:
            partial.rename(directory)
    return report


def _fill(
    growth: Growth,
    directory: Path,
    formats: Sequence[str],
    *,
    rim: bool,
    refine: int,
) -> dict[str, Any]:
    """Write all files of a run into an empty folder."""
    from jaxgrow.io.lesion_surface import lesion_surface
    from jaxgrow.io.report import make_report, plain

    surface = None if growth.organ is None else lesion_surface(growth, rim=rim)
    position, species = growth.particles()
    radius = growth.scene.r0_mm / 2
    write_particles(directory / PARTICLES, position, species, radius)
    _draw(growth, directory / PICTURE, surface)
    report = make_report(growth, None if surface is None else surface.label)
    report["surface"] = None
    if surface is not None:
        _write_surface(surface, directory, "organ", formats)
        if len(surface.ring) >= 3:
            write_polyline(directory / RING, surface.ring)
        report["surface"] = plain(surface.as_dict())
        if refine:
            refined = _write_refined(surface, directory, formats, refine)
            report["surface"]["refined"] = plain(refined)
    _write_report(directory, report)
    report["audit"] = audit_run(directory).as_dict()
    _write_report(directory, report)
    return report


def _write_surface(
    surface: LesionSurface, directory: Path, name: str, formats: Sequence[str]
) -> None:
    for kind in dict.fromkeys(("ply", *formats)):
        write_mesh(
            directory / f"{name}.{kind}",
            surface.vertices,
            surface.faces,
            surface.label,
            surface.attributes,
        )


def _write_refined(
    surface: LesionSurface, directory: Path, formats: Sequence[str], levels: int
) -> dict[str, Any]:
    """Write the subdivided surface, or tell why there is none."""
    from jaxgrow.io.lesion_surface import RefinementError

    try:
        refined = surface.refine(levels)
    except RefinementError as error:
        return {"refused": str(error)}
    _write_surface(refined, directory, "refined", formats)
    return {"refused": None, **refined.as_dict()}


def _write_report(directory: Path, report: dict[str, Any]) -> None:
    from jaxgrow.io.report import plain

    text = json.dumps(plain(report), indent=1, allow_nan=False) + "\n"
    write_atomically(directory / REPORT, lambda file: file.write(text.encode()))


def _draw(growth: Growth, path: Path, surface: LesionSurface | None) -> None:
    from jaxgrow.render import render_growth

    position, species = growth.particles()
    site = growth.site
    render_growth(
        path,
        vertices=None if surface is None else surface.vertices,
        faces=None if surface is None else surface.faces,
        label=None if surface is None else surface.lesion,
        particles=position,
        species=species,
        site=np.zeros(3) if site is None else site.point,
        axis=np.array([0.0, 0.0, 1.0]) if site is None else site.normal,
        particle_diameter=growth.scene.r0_mm,
        caption=describe(growth),
    )


def describe(growth: Growth) -> str:
    """Describe a growth in one line."""
    where = "grown freely"
    if growth.site is not None and growth.organ is not None:
        where = f"at {growth.site.name} of {growth.organ.name}"
    kind, divisions = growth.scene.lesion.kind, growth.events.divisions
    return f"{kind} of {growth.size_mm:.1f} mm {where}, {divisions} divisions"


def _replace(directory: Path, partial: Path) -> None:
    """Replace an earlier run by a complete one."""
    for name in sorted(_files(), key=lambda name: name != REPORT):
        (directory / name).unlink(missing_ok=True)
    for file in sorted(partial.iterdir(), key=lambda file: file.name == REPORT):
        file.replace(directory / file.name)


def read_run(directory: str | Path) -> Run:
    """Read a run folder.

    Raises:
        RunFolderError: it is not a folder, not a run, or one of its files is damaged.
    """
    directory = Path(directory)
    if not (directory / REPORT).is_file():
        kind = "holds no report.json" if directory.is_dir() else "is no folder"
        raise RunFolderError(
            f"{directory} {kind}, so it is no run; give a folder that "
            "jaxgrow grow wrote."
        )
    try:
        report = json.loads((directory / REPORT).read_text(encoding="utf-8"))
        free = report["request"]["scene"]["organ"] is None
        surface = (None, None, None) if free else read_organ_ply(directory / ORGAN)
        attributes = {} if free else read_attributes(directory / ORGAN)
        position, species, _ = read_particles(directory / PARTICLES)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunFolderError(
            f"the run in {directory} is damaged: {_reason(error)}"
        ) from error
    return Run(*surface, position, species, report, attributes)


def _reason(error: Exception) -> str:
    """Return why a file of a run cannot be read, in words."""
    if isinstance(error, OSError):
        return f"{Path(str(error.filename)).name}: {error.strerror}."
    if isinstance(error, json.JSONDecodeError | UnicodeDecodeError):
        return f"{REPORT} is not valid JSON."
    if isinstance(error, KeyError | TypeError):
        return f"{REPORT} lacks the entry request.scene.organ."
    return str(error)


def audit_run(directory: str | Path) -> Audit:
    """Audit a run from its files alone, independent of the growth's memory.

    Raises:
        RunFolderError: it is not a folder, not a run, or one of its files is damaged.
    """
    from jaxgrow.io.audit import audit_arrays

    run = read_run(directory)
    return audit_arrays(
        run.position,
        run.vertices,
        run.faces,
        run.report["request"]["scene"].get("tissue", "outside"),
        run.report.get("counts", {}).get("euler_number_before"),
    )
