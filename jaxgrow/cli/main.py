"""Command line application ``jaxgrow``: grow, fit, audit, sites.

As this is the application, it sets the configuration: 64-bit numbers and the cache of
compiled programs. No heavy module is imported before a command needs it.
"""

import contextlib
import enum
import os
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, TYPE_CHECKING

import typer

from jaxgrow.cli.interrupts import heard_interrupts
from jaxgrow.runtime.compile_cache import keep_programs


if TYPE_CHECKING:
    from jaxgrow.growth.result import Growth
    from jaxgrow.scene.scene import Scene


UNSUCCESSFUL = 1
"""Exit status if the run is written, but is not what was asked for."""

REFUSED = 2
"""Exit status if the input is wrong; nothing was written."""

INTERRUPTED = 130
"""Exit status after Ctrl-C."""

app = typer.Typer(
    add_completion=False, pretty_exceptions_enable=False, no_args_is_help=True
)


class _Tissue(enum.StrEnum):
    outside = "outside"
    inside = "inside"


class _Refusal(typer.TyperException):
    """Error in the input; its message is one sentence."""

    exit_code = REFUSED


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, and return the exit status.

    0: what was asked for was reached; 1: it was not, and the run says why; 2: the input
    is wrong; 130: interrupted. An error is reported in one line, without traceback.
    """
    try:
        with heard_interrupts():
            status = app(args=arguments, prog_name="jaxgrow", standalone_mode=False)
    except typer.TyperException as error:
        # Without any argument the help was shown, and the message is empty.
        if error.format_message():
            _say(error.format_message().replace("Value error, ", ""))
        return error.exit_code
    except OSError as error:
        _say(f"{error.filename or 'a file'}: {error.strerror or error}.")
        return UNSUCCESSFUL
    if status == INTERRUPTED:
        _say("interrupted.")
    return int(status or 0)


def command() -> int:
    """Run `main` for the installed command, and exit at once after Ctrl-C.

    An interpreter that is interrupted while XLA compiles may wait forever for its
    threads when it ends; there is nothing left to be cleaned up.
    """
    status = main()
    if status == INTERRUPTED:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    return status


def _show_version(wanted: bool | None) -> None:
    if wanted:
        import jaxgrow

        typer.echo(f"jaxgrow {jaxgrow.__version__}")
        raise typer.Exit


def _registered(names: list[str] | None) -> list[str]:
    """Return names of formats; refuse one that is not registered."""
    if names:
        from jaxgrow.io.formats.registry import check_formats

        try:
            check_formats(names)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from error
    return names or []


@app.callback()
def _options(
    version: Annotated[
        bool | None,
        typer.Option(
            "--version",
            help="Show the version and exit.",
            callback=_show_version,
            is_eager=True,
        ),
    ] = None,
) -> None:
    """Grow polyps and myomas into the surface mesh of an organ."""


@app.command()
def grow(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for the run; made if absent.")
    ],
    scene: Annotated[
        Path | None,
        typer.Argument(metavar="SCENE.toml", help="Scene; options override it."),
    ] = None,
    organ: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|uterus", help="OBJ, PLY, STL, GLB or OFF; default: uterus."
        ),
    ] = None,
    lesion: Annotated[
        str | None, typer.Option(metavar="polyp|myoma", help="Default: polyp.")
    ] = None,
    site: Annotated[
        str | None,
        typer.Option(metavar="NAME|X,Y,Z", help="In mm; default: fundus."),
    ] = None,
    size_mm: Annotated[
        float | None,
        typer.Option(metavar="S", help="Largest diameter in mm; default: 10."),
    ] = None,
    seed: Annotated[
        int, typer.Option(metavar="N", help="Of all random choices.", min=0)
    ] = 0,
    tolerance: Annotated[
        float,
        typer.Option(metavar="T", help="Largest force left in an equilibrium, F(0)."),
    ] = 1e-3,
    max_divisions: Annotated[
        int, typer.Option(metavar="N", help="Give up after so many.", min=1)
    ] = 3000,
    max_seconds: Annotated[
        float | None,
        typer.Option(metavar="S", help="Stop after so long, between two divisions."),
    ] = None,
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            metavar="obj|stl|glb|…",
            help="Also write the organ so; may be repeated.",
            callback=_registered,
        ),
    ] = None,
    rim: Annotated[
        bool,
        typer.Option("--rim", help="Bound the lesion by a smooth line of edges."),
    ] = False,
    refine: Annotated[
        int,
        typer.Option(
            metavar="L",
            min=0,
            max=4,
            help="Also write refined.ply: the lesion subdivided L times, smoothly.",
        ),
    ] = 0,
    unit_mm: Annotated[
        float | None,
        typer.Option(metavar="U", help="One unit of the organ's file, in mm."),
    ] = None,
    tissue: Annotated[
        _Tissue | None,
        typer.Option(
            help="Where the organ's tissue is: outside of a hollow organ's surface "
            "(the default), inside of a solid one's."
        ),
    ] = None,
) -> None:
    """Grow a lesion into an organ; write mesh, picture and report to a folder."""
    from rich.console import Console

    from jaxgrow.cli.progress import ProgressDisplay

    if not tolerance > 0:
        raise _Refusal(f"the tolerance is {tolerance:g}, but it must be positive.")
    if max_seconds is not None and not max_seconds > 0:
        raise _Refusal(f"--max-seconds is {max_seconds:g}, but it must be positive.")
    wanted = {
        "organ": organ,
        "unit_mm": unit_mm,
        "tissue": tissue and tissue.value,
        "lesion": {"kind": lesion, "size_mm": size_mm, "site": site},
    }
    started = time.perf_counter()
    with _refusals(), ProgressDisplay(Console(stderr=True)) as display:
        from jaxgrow.io import run_folder

        run_folder.check_destination(out)
        _configure()
        import jaxgrow as jg

        growth = jg.grow(
            combine(scene, wanted),
            seed=seed,
            tolerance=tolerance,
            max_divisions=max_divisions,
            max_seconds=max_seconds,
            progress=display,
        )
        given = formats or ()
        report = run_folder.write_run(growth, out, given, rim=rim, refine=refine)
    _conclude(growth, report, out, time.perf_counter() - started)


def _conclude(
    growth: "Growth", report: dict[str, Any], out: Path, seconds: float
) -> None:
    """Report the outcome, and exit with 1 if it is not what was asked for."""
    from jaxgrow.io.run_folder import describe

    if growth.mended.get("patch_enlarged"):
        _say(f"the patch was enlarged {growth.mended['patch_enlarged']} times.")
    if not growth.result.success:
        reason = growth.result.sentence
        _say(f"{out} holds only a {describe(growth)}: {_lowered(reason)}")
        raise typer.Exit(UNSUCCESSFUL)
    refined = (report["surface"] or {}).get("refined") or {}
    if refined.get("refused"):
        _say(f"{out} has no refined.ply: {refined['refused']}")
        raise typer.Exit(UNSUCCESSFUL)
    if not report["audit"]["clean"]:
        _say(f"the result in {out} has defects; see: jaxgrow audit {out}")
        raise typer.Exit(UNSUCCESSFUL)
    typer.echo(f"{out}: {describe(growth)}, {seconds:.0f} s, audit clean")


@app.command()
def fit(
    scene: Annotated[Path, typer.Argument(metavar="SCENE.toml", help="What to grow.")],
    targets: Annotated[
        Path,
        typer.Argument(
            metavar="TARGETS.toml",
            help="Targets with uncertainties, parameters with bounds, effort.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Folder; an interrupted fit in it goes on."),
    ],
) -> None:
    """Fit parameters such that grown lesions have the target shape metrics."""
    with _refusals():
        _configure()
        from jaxgrow.calibration import fit as run, load_task
        from jaxgrow.calibration.console import say_grown, say_tried, show
        from jaxgrow.scene.scene import load_scene

        loaded, task = load_scene(scene), load_task(targets)
        try:
            found = run(
                loaded,
                task.targets,
                task.parameters,
                folder=out,
                progress=say_tried,
                grown=say_grown,
                **dict(task.fit),
            )
        except KeyboardInterrupt:
            if out.exists():
                _say(f"{out} holds what was grown; the same command goes on there.")
            raise
    show(found)
    if not found.outcome.success:
        _say(found.outcome.value)
        raise typer.Exit(UNSUCCESSFUL)
    typer.echo(f"{out}: {found.outcome.value}")


@app.command()
def audit(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run.")],
) -> None:
    """Audit a run's files independently; exit status 0 if they have no defect."""
    with _refusals():
        from jaxgrow.io.run_folder import audit_run

        findings = audit_run(directory)
    for name, value in _flat(findings.as_dict()):
        typer.echo(f"{name:32} {value}")
    if not findings.clean:
        raise typer.Exit(UNSUCCESSFUL)


@app.command()
def sites(
    organ: Annotated[
        str, typer.Option(metavar="FILE|uterus", help="The organ.")
    ] = "uterus",
) -> None:
    """List an organ's named sites, and the depth of the lumen there (mm)."""
    with _refusals():
        from jaxgrow.organ import load_organ, locate_site, make_organ, ORGANS, room

        found = make_organ(organ) if organ in ORGANS else load_organ(organ)
        if not found.sites:
            raise _Refusal(f"{found.name} has no named sites; give X,Y,Z in mm.")
        for name in found.sites:
            place = locate_site(found, name)
            point = ",".join(f"{value:.2f}" for value in place.point)
            typer.echo(f"{name:20} {point:26} {room(found, place):6.1f} deep")


def combine(path: Path | None, wanted: dict[str, Any]) -> "Scene":
    """Make the scene of a file, or the default one, overridden by options.

    A size on the command line replaces a number of divisions in the file; with another
    kind of lesion, entries that only the former kind has are dropped.

    Args:
        path: the scene file, or None.
        wanted: entries as a scene file has them; None for options not given.
    """
    from jaxgrow.scene.scene import LESIONS, make_scene, read_entries

    entries = {} if path is None else read_entries(path)
    chosen = {name: value for name, value in wanted.items() if value is not None}
    lesion = {k: value for k, value in wanted["lesion"].items() if value is not None}
    before = entries.get("lesion", {})
    kind = lesion.get("kind", before.get("kind", "polyp"))
    if kind != before.get("kind", "polyp"):
        known = LESIONS[kind].model_fields if kind in LESIONS else before
        before = {name: value for name, value in before.items() if name in known}
    if "size_mm" in lesion:
        before.pop("divisions", None)
    entries |= chosen
    entries["lesion"] = {**before, **lesion, "kind": kind}
    source = "the command line" if path is None else f"{path} with the command line"
    return make_scene(entries, source=source)


@contextlib.contextmanager
def _refusals() -> Iterator[None]:
    """Convert errors in the input into one sentence and exit status 2."""
    from jaxgrow.io.run_folder import RunFolderError
    from jaxgrow.organ.validity import OrganError

    errors: tuple[type[ValueError], ...] = (OrganError, RunFolderError)
    try:
        yield
    except ValueError as error:
        # These modules import JAX; one that is not loaded cannot have raised.
        scene = sys.modules.get("jaxgrow.scene.scene")
        if scene is not None:
            errors = (*errors, scene.SceneError)
        task = sys.modules.get("jaxgrow.calibration.spec")
        if task is not None:
            errors = (*errors, task.FitError)
        if not isinstance(error, errors):
            raise
        raise _Refusal(str(error)) from error


def _configure() -> None:
    """Configure JAX: 64 bits, quiet, compiled programs cached on disk."""
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    warnings.formatwarning = lambda message, *_, **__: f"jaxgrow: warning: {message}\n"
    import jax

    jax.config.update("jax_enable_x64", True)
    keep_programs()
    _require_device()


def _require_device() -> None:
    """Refuse the run if JAX has no device of the configured platform."""
    import jax

    try:
        jax.devices()
    # JAX raises an AssertionError for a known platform whose plugin is missing
    except (RuntimeError, AssertionError) as error:
        platforms = jax.config.values["jax_platforms"]
        raise _Refusal(
            f"JAX_PLATFORMS is {platforms!r}, and JAX finds no such device here; "
            "install JAX for it, or set JAX_PLATFORMS=cpu."
        ) from error


def _flat(entries: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Iterate over nested entries, each named by its path."""
    for name, value in entries.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _say(message: str) -> None:
    """Print one line on standard error."""
    typer.echo("jaxgrow: " + " ".join(message.split()), err=True)


def _lowered(sentence: str) -> str:
    return sentence[:1].lower() + sentence[1:]
