"""Fit of growth parameters to an expert's description of a shape."""

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Float

from jaxgrow.calibration.coordinates import Coordinates
from jaxgrow.calibration.evaluations import Evaluation, Grower, Growths, LesionGrower
from jaxgrow.calibration.folder import check_folder, FILE, write_folder
from jaxgrow.calibration.loss import Loss
from jaxgrow.calibration.outcome import Fit, Outcome
from jaxgrow.calibration.search import FURTHEST, search, Tried
from jaxgrow.calibration.spec import Bounds, FitError, make_task, Target, Task
from jaxgrow.calibration.uncertainty import achieved_targets, fitted_parameters
from jaxgrow.io.report import FITTING, named, versions
from jaxgrow.organ import make_organ, Organ, ORGANS
from jaxgrow.scene.scene import Scene


def fit(
    scene: Scene,
    targets: Mapping[str, Target | tuple[float, float]],
    parameters: Mapping[str, Bounds | tuple[float, float]],
    *,
    folder: str | Path | None = None,
    optimiser: optax.GradientTransformation | None = None,
    progress: Callable[[Tried], None] | None = None,
    grown: Callable[[Evaluation], None] | None = None,
    grower: Grower | None = None,
    **effort: Any,
) -> Fit:
    r"""Fit parameters so that lesions have the shape that an expert describes.

    Minimises :math:`\frac12 \sum_t ((\bar m_t - m_t)/\sigma_t)^2` with the means of the
    metrics over several seeds (for the reason see `jaxgrow.calibration.loss`), by
    gradient steps that are accepted only if newly grown lesions show that they lead
    closer to the targets, and without derivatives where those fail
    (`jaxgrow.calibration.search`). A growth with a result other than REACHED makes the
    loss infinite: the step is refused, and recorded in `Fit.failures`.

    Lesions differ from seed to seed, small ones (ten divisions) by a third in height,
    and a parameter that changes by a per cent changes the packing as another seed does.
    So the fit is that of the mean over its seeds, and the estimate at a point is a
    regression over the lesions of all points near it. More seeds, or larger lesions,
    make it sharper; fewer than eight seeds understate the uncertainties.

    Args:
        scene: the scene to grow. Its parameters apply unless fitted.
        targets: of metrics (`jaxgrow.metrics.shape.ShapeMetrics`, or those that
            `jaxgrow.register_metric` added), by their names;
            a pair is value and uncertainty.
        parameters: to be fitted, by their names; a pair is low and high.
        folder: of an earlier fit to continue, or of a new one: the growths are stored
            in its ``fit.json``, and a fit that was interrupted ends with the same
            result as one that was not. At the end the fitted scene and a plot are
            written to it. None to write nothing.
        optimiser: of optax, for the steps in unconstrained coordinates; by default
            `jaxgrow.calibration.search.gauss_newton`. It is not part of a folder's
            request.
        progress: called after every evaluation.
        grown: called after every growth.
        grower: makes the growths, instead of `jaxgrow.grow`.
        **effort: `jaxgrow.calibration.spec.Effort`: seeds, evaluations, smoothing,
            max_divisions.

    Returns:
        The fit; its outcome is REACHED, UNREACHED or NOT_GROWN.

    Raises:
        FitError: a name, a bound or an effort is invalid, or the folder cannot be used.
        OrganError: the organ or the site cannot be used.
    """
    entries = {"targets": targets, "parameters": parameters, "fit": effort}
    task = make_task(entries, source="the fit")
    coordinates = Coordinates.between(task.parameters.values())
    start = _start(scene, task, coordinates)
    file = None
    if folder is not None:
        check_folder(Path(folder), scene)
        file = Path(folder) / FILE
    grower = LesionGrower(scene, task) if grower is None else grower
    growths = Growths(grower, describe_request(scene, task), file, grown)
    loss = Loss(task, coordinates, growths)
    found = search(
        loss,
        start,
        evaluations=task.fit.evaluations,
        optimiser=optimiser,
        progress=progress,
    )
    fitted = fitted_parameters(coordinates, found.best, found.estimate)
    achieved = achieved_targets(task, found)
    outcome = Outcome.NOT_GROWN
    if found.estimate is not None:
        outcome = Outcome.REACHED if found.estimate.reached else Outcome.UNREACHED
    changed = dict(zip(task.parameters, found.best.values, strict=True))
    own = replace(scene.parameters, **changed)
    result = Fit(
        scene=scene.model_copy(update={"parameters": own}),
        task=task,
        outcome=outcome,
        end=found.end,
        loss=math.inf if found.estimate is None else found.estimate.loss,
        parameters=dict(zip(task.parameters, fitted, strict=True)),
        targets=dict(zip(task.targets, achieved, strict=bool(achieved))),
        history=found.history,
        growths=tuple(growths.all),
    )
    if folder is not None:
        write_folder(result, growths, Path(folder))
    return result


def _start(
    scene: Scene, task: Task, coordinates: Coordinates
) -> Float[np.ndarray, " p"]:
    """Return the coordinates of the start of the search.

    Raises:
        FitError: it is not between the bounds, or a target needs a surface.
    """
    values = list[float]()
    for name, bounds in task.parameters.items():
        own = bounds.start is None
        value = float(getattr(scene.parameters, name)) if own else bounds.start
        assert value is not None
        values.append(value)
        if not bounds.low < value < bounds.high:
            raise FitError(
                f"the scene's {name} is {value:g}, which is not between {bounds.low:g} "
                f"and {bounds.high:g}; give it a start, or other bounds."
            )
    start = np.asarray(coordinates.coordinates(jnp.asarray(values, float)))
    for (name, bounds), u in zip(task.parameters.items(), start, strict=True):
        if abs(u) > FURTHEST:
            side = "lower" if u < 0 else "upper"
            hint = "" if bounds.low > 0 else " (a positive lower one, maybe)"
            raise FitError(
                f"{name} starts too close to its {side} bound for a search; give it "
                f"another start, or other bounds{hint}."
            )
    surface = {name for name in task.targets if name != "tumour_diameter_mm"}
    if scene.organ is None and surface:
        raise FitError(
            f"{min(surface)} needs a surface, but the scene has no organ; give one, or "
            "fit tumour_diameter_mm."
        )
    return start


def describe_request(scene: Scene, task: Task) -> dict[str, Any]:
    """Describe all inputs that decide a fit's growths, as nested entries."""
    lesion = scene.lesion.model_dump(mode="json")
    return {
        "scene": {
            "organ": _identity(scene.organ),
            "unit_mm": scene.unit_mm,
            "tissue": scene.tissue,
            "lesion": lesion,
            "parameters": {n: float(v) for n, v in named(scene.parameters).items()},
            "surroundings": scene.surroundings.model_dump(mode="json"),
        },
        "task": task.model_dump(mode="json"),
        "versions": versions(FITTING),
    }


def _identity(organ: Organ | Path | str | None) -> str | None:
    """Return the built-in organ's name, or a name with the digest of a mesh."""
    if organ is None or organ == "uterus":
        return organ if isinstance(organ, str) else None
    if isinstance(organ, str) and organ in ORGANS:
        organ = make_organ(organ)
    digest = hashlib.sha256()
    if isinstance(organ, Organ):
        for array in (organ.vertices, organ.faces):
            digest.update(np.ascontiguousarray(array).tobytes())
        return f"{organ.name} {digest.hexdigest()[:16]}"
    path = Path(organ)
    if path.is_file():  # else growing raises the error
        digest.update(path.read_bytes())
    return f"{path.name} {digest.hexdigest()[:16]}"
