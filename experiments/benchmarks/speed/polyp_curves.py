"""Work-precision curves of a polyp: particles, membrane and the contact between them.

*polyp-tolerance* relaxes the state just after a division, as a growth does, and
compares each end with the equilibrium that it goes on to itself. *contact-sharpness*
relaxes a polyp again after everything has been moved a little, under laws that differ
in the smooth minimum over triangles, and compares with the sharpest law; the error of
its forces is against the nearest triangle alone, by the numba loop.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

import jaxgrow as jg
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.equilibrium.relax import Method
from jaxgrow.growth.step import divide
from jaxgrow.io.report import named
from jaxgrow.transfer.device import get

from .curves import Setting, TOLERANCES
from .errors import REFERENCE, relative
from .force_rows import forces
from .measure import measure_in_turns, Measured, Options, spread
from .scenes import grown_polyp, moved, scene_of


DIVISIONS = 10, 100
"""Of the polyp, in quick mode and in full."""

METHODS: tuple[Method, ...] = ("auto", "lbfgs", "newton", "fire")

SHARPNESSES = (5.0, 10.0, 20.0, 40.0, 80.0)

MOVED = 0.02
"""Standard deviation, in r0, of what every coordinate is moved by."""

REFERENCES = (REFERENCE, 1e-11, 1e-10)
"""Tolerances of a reference, in F(0): the first that is reached counts."""


class Reference(NamedTuple):
    """An equilibrium that others are compared with.

    Attributes:
        state: the equilibrium.
        parameters: of its law.
        tolerance: in F(0); None if none of `REFERENCES` was reached.
        residual: largest force, in F(0).
    """

    state: jg.State
    parameters: jg.Parameters
    tolerance: float | None
    residual: float


def at_end(state: jg.State, end: jg.Relaxation) -> jg.State:
    """The state with particles and membrane of a relaxation's end."""
    particles, membrane = end.state
    assert particles is not None
    return jg.State(particles, membrane, state.frame)


def settled(state: jg.State, parameters: jg.Parameters) -> Reference:
    """The equilibrium that a state goes on to."""
    end = None
    for tolerance in REFERENCES:
        end = jg.relax(
            state.particles,
            state.membrane,
            parameters=parameters,
            tolerance=tolerance,
            max_steps=20_000,
        )
        if end.result.success:
            found = at_end(state, end)
            return Reference(found, parameters, tolerance, end.stats.residual)
    assert end is not None
    return Reference(at_end(state, end), parameters, None, end.stats.residual)


@eqx.filter_jit
def _energy(problem: Problem, lists: Any) -> Any:
    return problem.energy(problem.nodes(), lists)


def energy_of(state: jg.State, parameters: jg.Parameters) -> float:
    """Energy of all terms, in F(0) r0."""
    problem = Problem.of(state.particles, state.membrane, parameters)
    return float(_energy(problem, allocate_lists(problem)))


def errors_against(state: jg.State, reference: Reference) -> dict[str, Any]:
    """How far a state is from an equilibrium.

    Positions are in r0, of what is free; energies are of the reference's law, relative;
    metrics are relative where they are not 0.
    """
    there = reference.state
    assert state.membrane is not None
    assert there.membrane is not None
    free, loose = get(state.particles.free), get(state.membrane.free)
    moves = get(state.particles.position) - get(there.particles.position)
    shifts = get(state.membrane.vertices) - get(there.membrane.vertices)
    apart = {"position": moves[free], "vertex": shifts[loose]}
    errors: dict[str, Any] = {"residual_of_reference": reference.residual}
    for name, move in apart.items():
        length = np.linalg.norm(move, axis=1)
        errors[f"{name}_max"] = float(length.max())
        errors[f"{name}_rms"] = float(np.sqrt((length**2).mean()))
    lowest = energy_of(reference.state, reference.parameters)
    own = energy_of(state, reference.parameters)
    errors["energy_relative"] = (own - lowest) / abs(lowest)
    found, wanted = (
        {name: float(value) for name, value in named(metrics).items()}
        for metrics in (jg.shape_metrics(state), jg.shape_metrics(reference.state))
    )
    errors["metrics"] = {
        name: abs(found[name] - value) / (abs(value) or 1.0)
        for name, value in wanted.items()
    }
    errors["metrics_max"] = max(errors["metrics"].values())
    return errors


def relaxer(
    state: jg.State, parameters: jg.Parameters, tolerance: float, method: Method
) -> Callable[[int], jg.Relaxation]:
    """Relaxes a state, lists for the start given."""
    lists = allocate_lists(Problem.of(state.particles, state.membrane, parameters))
    return lambda _: jg.relax(
        state.particles,
        state.membrane,
        parameters=parameters,
        tolerance=tolerance,
        method=method,
        lists=lists,
    )


def points(
    axis: str,
    state: jg.State,
    settings: Mapping[str, Setting],
    measured: Measured,
    errors: Callable[[str, jg.State], dict[str, Any]],
) -> Iterator[dict[str, Any]]:
    """Points of a curve, as they are written.

    Args:
        axis: name of it.
        state: that was relaxed.
        settings: by the contenders' names.
        measured: what they took.
        errors: of the end of the contender of that name.
    """
    assert state.membrane is not None
    for name, setting in settings.items():
        end = measured.outcomes[name][-1]
        yield {
            **asdict(setting),
            "axis": axis,
            "particles": int(get(state.particles.alive).sum()),
            "vertices": int(get(state.membrane.vertex_alive).sum()),
            "result": end.result.name,
            "steps": end.stats.steps,
            "seconds": spread(measured.seconds[name]),
            "cpu_seconds": spread(measured.cpu_seconds[name]),
            "errors": {
                "residual": end.stats.residual,
                **errors(name, at_end(state, end)),
            },
        }


def polyp_tolerance(options: Options) -> Iterator[dict[str, Any]]:
    """A polyp after one more division, by three methods to eight tolerances."""
    growth = grown_polyp(DIVISIONS[0 if options.quick else 1])
    parameters = growth.scene.parameters
    rng = np.random.default_rng(0)
    lesion = growth.scene.lesion
    divisions = lesion.choose(growth.state, parameters, rng, 1)
    assert divisions is not None
    start = divide(lesion, growth.state, divisions, parameters)
    settings = {
        f"{method} {tolerance:g}": Setting(f"jaxgrow {method}", tolerance)
        for method in METHODS
        for tolerance in TOLERANCES
    }
    contenders = {
        f"{method} {tolerance:g}": relaxer(start, parameters, tolerance, method)
        for method in METHODS
        for tolerance in TOLERANCES
    }
    measured = measure_in_turns(contenders, options, shortest=0.0)

    def errors(_: str, end: jg.State) -> dict[str, Any]:
        reference = settled(end, parameters)
        found = errors_against(end, reference)
        return {**found, "tolerance_of_reference": reference.tolerance}

    yield from points("polyp-tolerance", start, settings, measured, errors)


def contact_sharpness(options: Options) -> Iterator[dict[str, Any]]:
    """A polyp that was moved a little, relaxed with smooth minima of several powers."""
    growth = grown_polyp(DIVISIONS[0 if options.quick else 1])
    start = moved(growth.state, MOVED)
    assert start.membrane is not None
    settings = {
        f"{sharpness:g}": Setting("jaxgrow auto", 1e-6, sharpness=sharpness)
        for sharpness in SHARPNESSES
    }
    laws = {
        name: replace(growth.scene.parameters, contact_sharpness=setting.sharpness)
        for name, setting in settings.items()
    }
    contenders = {
        name: relaxer(start, law, settings[name].tolerance, "auto")
        for name, law in laws.items()
    }
    measured = measure_in_turns(contenders, options, shortest=0.0)
    sharpest = f"{max(SHARPNESSES):g}"
    end = at_end(start, measured.outcomes[sharpest][-1])
    reference = settled(end, laws[sharpest])
    force = {}
    for name, law in laws.items():
        scene = scene_of(start.particles, start.membrane, law)
        found = scene.of_living(forces(scene.problem, scene.lists))
        force[name] = relative(found, scene.loop(smooth=False)())

    def errors(name: str, end: jg.State) -> dict[str, Any]:
        return {
            **errors_against(end, reference),
            "tolerance_of_reference": reference.tolerance,
            "force_against_nearest": force[name],
        }

    yield from points("contact-sharpness", start, settings, measured, errors)


POLYP_AXES: dict[str, Callable[[Options], Iterator[dict[str, Any]]]] = {
    "contact-sharpness": contact_sharpness,
    "polyp-tolerance": polyp_tolerance,
}
