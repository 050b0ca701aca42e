"""Growths of a fit: made once, stored, and read when the fit is resumed."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgrow.calibration.spec import FitError, Task
from jaxgrow.energy.parameters import Parameters
from jaxgrow.growth.events import Events
from jaxgrow.growth.grow import grow
from jaxgrow.growth.result import Growth
from jaxgrow.metrics import measure
from jaxgrow.runtime.atomic_file import write_atomically
from jaxgrow.runtime.results import Result
from jaxgrow.scene.scene import Scene


FORMAT = 2
"""Version of the file's format, raised when an entry changes its meaning or place."""

Values = tuple[float, ...]
"""Values of the fitted parameters, in the order of the task."""


@dataclass(frozen=True)
class Evaluation:
    """Record of one growth.

    Attributes:
        seed: of the growth.
        values: of the fitted parameters.
        result: name of the growth's result; NON_FINITE if it has no finite metrics.
        metrics: in the order of the targets; empty if the growth failed.
        slopes: derivative of each metric in each fitted parameter, along the frozen
            path of the growth; None if not requested, empty if it failed.
    """

    seed: int
    values: Values
    result: str
    metrics: tuple[float, ...]
    slopes: tuple[tuple[float, ...], ...] | None = None

    @property
    def success(self) -> bool:
        """Whether the growth reached what the scene asks for."""
        return self.result == Result.REACHED.name


@runtime_checkable
class Grower(Protocol):
    """Source of growths; tests substitute another one."""

    def measure(self, seed: int, values: Values) -> Evaluation:
        """Grow a lesion and return its metrics."""
        ...

    def slopes(self, seed: int, values: Values) -> tuple[tuple[float, ...], ...]:
        """Return the derivatives of the metrics; empty if they do not exist."""
        ...


class LesionGrower:
    """Grower of a scene's lesions by `jaxgrow.grow`.

    The growths have the default tolerance. The derivatives are of a replay of their
    events, whose equilibria are exact enough for a derivative (1e-10 F(0)): the same
    lesions in the same packings, with metrics that differ by some tenths of a per cent
    from those at 1e-3. Growing at 1e-10 directly takes two to three times as long.

    Args:
        scene: the scene to grow.
        task: gives the metrics and the fitted parameters.
    """

    def __init__(self, scene: Scene, task: Task) -> None:
        self._scene, self._task = scene, task
        self._base = jax.tree.map(lambda p: jnp.asarray(p, float), scene.parameters)
        self._events: dict[tuple[int, Values], Events] = {}

    def measure(self, seed: int, values: Values) -> Evaluation:
        """Grow a lesion and return its metrics."""
        growth = self._grow(seed, self._parameters(jnp.asarray(values)))
        if any(other != values for _, other in self._events):
            self._events.clear()  # derivatives are requested at the last values only
        self._events[seed, values] = growth.events
        metrics = np.asarray(self._metrics(growth))
        result = growth.result
        if result is Result.REACHED and not np.isfinite(metrics).all():
            result = Result.NON_FINITE
        kept = tuple(metrics.tolist()) if result is Result.REACHED else ()
        return Evaluation(seed, values, result.name, kept)

    def slopes(self, seed: int, values: Values) -> tuple[tuple[float, ...], ...]:
        """Return the derivatives of the metrics; empty if they do not exist."""
        if (seed, values) not in self._events:  # the fit was interrupted in between
            self.measure(seed, values)
        events = self._events[seed, values]
        results = list[Result]()

        def metrics(fitted: Float[Array, " p"]) -> Float[Array, " t"]:
            growth = self._grow(seed, self._parameters(fitted), events)
            results.append(growth.result)
            return self._metrics(growth)

        _, along = jax.linearize(metrics, jnp.asarray(values))
        if set(results) != {Result.REACHED}:  # it ended before, with finite derivatives
            return ()
        columns = np.stack([np.asarray(along(e)) for e in jnp.eye(len(values))])
        if not np.isfinite(columns).all():
            return ()
        return tuple(tuple(row) for row in columns.T.tolist())

    def _parameters(self, fitted: Float[Array, " p"]) -> Parameters:
        names = self._task.parameters
        changed = {name: fitted[i] for i, name in enumerate(names)}
        return replace(self._base, **changed)

    def _grow(
        self, seed: int, parameters: Parameters, events: Events | None = None
    ) -> Growth:
        return grow(
            self._scene,
            seed=seed,
            parameters=parameters,
            max_divisions=self._task.fit.max_divisions,
            events=events,
        )

    def _metrics(self, growth: Growth) -> Float[Array, " t"]:
        fit, names = self._task.fit, self._task.targets
        found = measure(growth.state, names, smoothing=fit.smoothing)
        return jnp.stack([found[name] for name in names])


class Growths:
    """Collection of all growths of a fit, each made once.

    With a file, it is rewritten after every growth and read at the start. A fit
    requests its growths in an order that depends on their numbers alone, and JSON keeps
    every bit of a number; so a fit that was interrupted repeats the same path, finds
    its earlier growths, and ends with the same result.

    Args:
        grower: makes those that are not stored.
        request: request of the fit; a file with another request is refused.
        file: stores them; its folder is created with it. None for memory only.
        grown: called after every new growth.

    Raises:
        FitError: the file holds another fit, or is damaged.
    """

    def __init__(
        self,
        grower: Grower,
        request: dict[str, Any],
        file: Path | None = None,
        grown: Callable[[Evaluation], None] | None = None,
    ) -> None:
        self._grower, self._request, self._file = grower, request, file
        self._grown = grown
        self._known: dict[tuple[int, Values], Evaluation] = {}
        if file is not None and file.exists():
            for entry in read_fit(file, request)["growths"]:
                known = _measured(entry)
                self._known[known.seed, known.values] = known

    @property
    def all(self) -> Sequence[Evaluation]:
        """All stored growths, in the order in which they were made."""
        return tuple(self._known.values())

    def measure(self, seed: int, values: Values) -> Evaluation:
        """Return the metrics of a growth, growing it if it is not stored."""
        if (seed, values) not in self._known:
            measured = self._grower.measure(seed, values)
            self._keep(measured)
            if self._grown is not None:
                self._grown(measured)
        return self._known[seed, values]

    def slopes(self, seed: int, values: Values) -> tuple[tuple[float, ...], ...]:
        """Return the derivatives of a growth's metrics; empty if none exist."""
        known = self.measure(seed, values)
        if known.slopes is None:
            known = replace(known, slopes=self._grower.slopes(seed, values))
            self._keep(known)
        assert known.slopes is not None
        return known.slopes

    def write(self, outcome: dict[str, Any] | None = None) -> None:
        """Write the file, with the outcome once there is one."""
        if self._file is None:
            return
        content = {
            "format": FORMAT,
            "request": self._request,
            "growths": [asdict(known) for known in self._known.values()],
            "outcome": outcome,
        }
        text = json.dumps(content, indent=1, allow_nan=False) + "\n"
        self._file.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(self._file, lambda file: file.write(text.encode()))

    def _keep(self, known: Evaluation) -> None:
        self._known[known.seed, known.values] = known
        self.write()


def read_fit(file: Path, request: dict[str, Any]) -> dict[str, Any]:
    """Read a fit's file and check that it fits the request.

    Args:
        file: to read.
        request: the request that the fit must have, except the number of evaluations:
            with more of them it is continued.

    Raises:
        FitError: it is damaged, or of another request, format or version.
    """
    content = _read(file)
    # as JSON returns it: lists for tuples
    found, wanted = content["request"], json.loads(json.dumps(request))
    asked, asking = ({**each, "versions": None} for each in (found, wanted))
    other = _first_difference(asked, asking)
    if other is not None:
        raise FitError(
            f"{file.parent} holds a fit with another {other}; give a new folder, or "
            "what that fit was asked for, to go on with it."
        )
    _check_versions(file.parent, found.get("versions", {}), wanted.get("versions", {}))
    return content


def _read(file: Path) -> dict[str, Any]:
    """Read a file that has the format of this version."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        form = content["format"]
        if form == FORMAT:
            content["request"] = dict(content["request"])
            for entry in content["growths"]:
                _measured(entry)
    except (ValueError, KeyError, TypeError) as error:
        raise FitError(
            f"{file} is damaged or no fit; remove it, or give a new folder."
        ) from error
    except OSError as error:
        raise FitError(f"{file} cannot be read: {error.strerror}.") from error
    if form != FORMAT:
        raise FitError(
            f"{file} has format {form}, and this version of jaxgrow reads {FORMAT}; "
            "go on with the version that wrote it, or give a new folder."
        )
    return content


def _check_versions(
    folder: Path, found: dict[str, Any], wanted: dict[str, Any]
) -> None:
    """Raise if growths are of other versions; unnamed versions pass.

    Raises:
        FitError: names all that differ.
    """
    other = [n for n in wanted if n in found and found[n] != wanted[n]]
    if other:
        then, now = (
            " and ".join(
                f"{name} {of[name]}" if of[name] else f"no {name}" for name in other
            )
            for of in (found, wanted)
        )
        raise FitError(
            f"{folder} holds growths made with {then}, and here is {now}, which may "
            f"make others; go on with {then}, or give a new folder."
        )


def _measured(entry: dict[str, Any]) -> Evaluation:
    slopes = entry["slopes"]
    return Evaluation(
        entry["seed"],
        tuple(entry["values"]),
        entry["result"],
        tuple(entry["metrics"]),
        None if slopes is None else tuple(tuple(row) for row in slopes),
    )


def _first_difference(found: Any, wanted: Any, path: str = "") -> str | None:
    """Return the path of the first entry that differs; None if none does."""
    if path == "task.fit.evaluations" or found == wanted:
        return None
    if not (isinstance(found, dict) and isinstance(wanted, dict)):
        return path
    if list(found) != list(wanted):
        return next(iter(sorted(set(found) ^ set(wanted))), None) or f"order of {path}"
    joined = ((name, f"{path}.{name}".lstrip(".")) for name in found)
    differences = (_first_difference(found[n], wanted[n], p) for n, p in joined)
    return next((other for other in differences if other is not None), None)
