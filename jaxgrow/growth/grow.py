"""Growth of a lesion until it has its size, or cannot grow (paper §4)."""

from collections.abc import Mapping
from dataclasses import fields, replace

import jax.numpy as jnp
import numpy as np

from jaxgrow.energy.parameters import as_arrays, at_resolution, Parameters
from jaxgrow.equilibrium.extra_terms import ExtraTerms
from jaxgrow.equilibrium.methods import exact_tolerance
from jaxgrow.equilibrium.transformations import (
    check_transformations,
    is_differentiated,
)
from jaxgrow.growth.choices import Drawn, Recorded
from jaxgrow.growth.events import Events, numbers
from jaxgrow.growth.loop import measure, Reached, run_loop, start_growth, Watch
from jaxgrow.growth.result import Continuation, Growth
from jaxgrow.growth.setup import Setup
from jaxgrow.growth.stopping import GrowthLimits
from jaxgrow.runtime.compilations import count_compilations
from jaxgrow.runtime.descents import count_descents
from jaxgrow.runtime.entries import check_names
from jaxgrow.runtime.forks import refuse_forked
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.timer import Clock
from jaxgrow.runtime.types import Scalar
from jaxgrow.scene.scene import Scene


def grow(
    scene: Scene | None = None,
    *,
    seed: int = 0,
    parameters: Parameters | Mapping[str, Scalar] | None = None,
    tolerance: float | None = None,
    max_divisions: int = 3000,
    max_seconds: float | None = None,
    progress: Watch | None = None,
    events: Events | None = None,
    terms: ExtraTerms = (),
    after: Growth | None = None,
) -> Growth:
    """Grow a lesion to the size, or the number of divisions, asked for.

    Every iteration makes the paper's four phases (§4) in its order: one tumour particle
    divides (or several, see `Lesion.divisions_per_step`); tissue and surface reach
    equilibrium (here together, see `jaxgrow.relax`); the surface is faired; and its
    springs get their current length as new rest length.

    Recovery from failures: an equilibrium that is not found, or that ejected particles,
    is tried again from its start with shorter steps, and then its step with fewer or
    other divisions, three times at most; lists that overflow are enlarged;
    a fairing that fails the exact check is omitted; sheets that approach each other
    begin to repel; a patch with a reaction on its boundary is enlarged.
    `Growth.mended` counts these. After any other failure the growth ends, and its
    result names it.

    *Derivatives.* `jax.grad`, `jax.jvp`, `jax.jacfwd` and `jax.jacrev` of any function
    of the state, and of `size_mm`, differentiate the whole growth with respect to the
    parameters: in every equilibrium, `jacfwd` solves once for each parameter, `jacrev`
    once for each result. The discrete choices (which particle divides, which edge is
    split, which packing an equilibrium is in) are frozen, and each equilibrium has its
    implicit derivative (`jaxgrow.relax`), for which it is relaxed to 1e-10 at least.
    `events` replays the choices of a growth: with its parameters bit for bit, with
    others as the frozen path along which the derivative is taken.

    *Gradient behaviour.* The choices do change with the parameters, so the response of
    a growth is piecewise smooth, with small pieces: lesions of 20 divisions whose
    spring stiffness differs by a quarter differ in height by 0.15 mm, while lesions
    scatter around their trend by 0.19 mm. The gradient is that of the piece, and omits
    the effect of changed choices: averaged over 4 seeds and a decade of stiffness it is
    0.2 (sphericity) to 0.4 (height, area) times the slope of the trend. Its sign is
    that of the trend at all but 0 to 11 % of the values for one seed, and for the mean
    of 4 at all that have 4. So use its direction, averaged over seeds, and determine
    the length of a step from newly grown lesions, as `jaxgrow.fit` does. Figures are
    those of ``experiments/studies/gradient_quality.py sweep``.

    Args:
        scene: organ, lesion and parameters; may be left out with `after`.
        seed: of all random choices; the same seed gives the same growth.
        parameters: of the mechanics: by name, those that differ from the scene's (so
            that a myoma keeps the others of its kind), or all of them.
        tolerance: largest force left in every equilibrium, in F(0); 1e-3 if None, or
            that of the growth whose events are replayed.
        max_divisions: bound on the divisions, for a size that is never reached.
        max_seconds: bound on the time; checked between divisions.
        progress: called after every step with a `Progress`, which has the state. If
            it returns True, the growth ends there: STOPPED.
        events: of a growth to replay; seed and bounds are ignored then. Record it at
            `tolerance=1e-10` if you replay it with other parameters.
        terms: energies besides those of jaxgrow, see `jaxgrow.relax`.
        after: a growth to continue, with the same bits as if it had not ended (to the
            tolerance, if it comes from another process); `scene` may ask for another
            size or number of divisions, if its particles have the same size. Seed,
            parameters, tolerance and terms are those of `after`.

    Returns:
        The growth. Its result is REACHED (it has its size, or lacks at most 3 % of it
        and cannot continue), or the reason of an earlier end, with the last equilibrium
        as its state: DIVISION_LIMIT, TIME_LIMIT, STOPPED (by
        `progress`), CAVITY_FULL (the lesion no longer grows against the walls),
        PATCH_TOO_SMALL (the organ has no more surface), INTERSECTION, SLIVER,
        EVAPORATED, STEP_LIMIT, NON_FINITE or ON_MEMBRANE.

    Raises:
        OrganError: the organ or the site cannot be used.
        ValueError: JAX computes in 32 bits, the tolerance is not positive, the
            events or `after` are those of another scene, a second derivative is taken
            (`jax.hessian`), or values are not concrete (`jax.jit`, `jax.checkpoint`,
            `jax.vmap`).
        GrowthInterrupted: Ctrl-C, with the growth up to then.
        RuntimeError: this process was forked from one that had grown something.
    """
    refuse_forked()
    if jnp.zeros(()).dtype != jnp.float64:
        raise ValueError(
            "JAX computes in 32 bits here, and growth needs 64; put "
            'jax.config.update("jax_enable_x64", True) before it, or set '
            "JAX_ENABLE_X64=1."
        )
    if max_seconds is not None and not max_seconds > 0:
        raise ValueError(f"max_seconds is {max_seconds}; it must be positive.")
    clock, bounds = Clock(), GrowthLimits(max_divisions, max_seconds)
    with count_compilations() as compilations, count_descents() as descents:
        if after is not None:
            if parameters is not None or tolerance is not None or events or terms:
                raise ValueError(
                    "a growth goes on as it began; with after=, give only scene, "
                    "bounds and progress."
                )
            setup, reached, choices = _go_on(after, scene)
            seed = after.seed
        else:
            setup = _setup(scene, parameters, tolerance, events, terms)
            rng = np.random.default_rng(seed)
            choices = Drawn(rng) if events is None else Recorded(events)
            reached = start_growth(setup, choices, clock)
        reached = run_loop(setup, reached, choices, bounds, clock, progress)
    goes_on = None
    if isinstance(choices, Drawn) and not is_differentiated((setup, reached.now.state)):
        generator = dict(choices.rng.bit_generator.state)
        goes_on = Continuation(setup, reached, generator)
    growth = Growth(
        scene=setup.scene,
        seed=seed,
        tolerance=setup.tolerance,
        state=reached.now.state,
        result=reached.result,
        size_mm=measure(setup, reached.now, clock),
        events=choices.events(setup, reached.result),
        history=reached.history,
        seconds=dict(clock.total),
        compilations=compilations.count,
        descents=descents,
        ground=reached.now.ground,
        organ_index=reached.now.organ_index,
        continuation=goes_on,
    )
    if reached.result is Result.INTERRUPTED:
        raise GrowthInterrupted(growth)
    return growth


class GrowthInterrupted(KeyboardInterrupt):
    """Interrupt of a growth by Ctrl-C.

    Attributes:
        growth: up to the last complete step; ``grow(after=growth)`` continues it.
    """

    def __init__(self, growth: Growth) -> None:
        super().__init__(f"interrupted; its growth is {growth!r}.")
        self.growth = growth

    def __reduce__(self) -> tuple[type["GrowthInterrupted"], tuple[Growth]]:
        # by default an exception is made again from its message
        return type(self), (self.growth,)


def _setup(
    scene: Scene | None,
    parameters: Parameters | Mapping[str, Scalar] | None,
    tolerance: float | None,
    events: Events | None,
    terms: ExtraTerms,
) -> Setup:
    """Make the setup of a growth, common to all its steps."""
    if scene is None:
        raise ValueError("nothing to grow: give a scene, or after= a growth.")
    given, lesion = _parameters(scene, parameters), scene.lesion
    given = at_resolution(given, lesion.unit_mm / lesion.r0_mm)
    arrays = as_arrays(given, jnp.float64)
    check_transformations(arrays)
    if events is None:
        tolerance = 1e-3 if tolerance is None else tolerance
        if is_differentiated((arrays, terms)):
            tolerance = min(tolerance, exact_tolerance())
    else:
        events.check_scene(scene)
        tolerance = tolerance_of_replay(events, arrays, tolerance)
    return Setup(scene, arrays, tolerance, tuple(terms))


def _go_on(after: Growth, scene: Scene | None) -> tuple[Setup, Reached, Drawn]:
    """Prepare the continuation of a growth, possibly to another size."""
    if after.continuation is None:
        raise ValueError(
            "this growth cannot go on: it is a replay, or a derivative was taken; grow "
            "it without events."
        )
    setup, reached, generator = after.continuation
    if scene is not None:
        after.events.check_scene(scene)
        ends = {"size_mm": None, "divisions": None}
        one, other = (
            s.model_copy(update={"lesion": s.lesion.model_copy(update=ends)})
            for s in (scene, setup.scene)
        )
        if one != other:
            raise ValueError(
                "the scene differs from that of the growth in more than the size or "
                "the number of divisions; a growth goes on in its own scene."
            )
        setup = replace(setup, scene=scene)
    rng = np.random.default_rng()
    rng.bit_generator.state = generator
    going = replace(reached, result=Result.CONVERGED)
    return setup, going, Drawn.after(after.events, rng)


def tolerance_of_replay(
    events: Events, parameters: Parameters, tolerance: float | None
) -> float:
    """Choose the tolerance of a replay.

    It is the one asked for, or else the recorded one; with other parameters, or for a
    derivative, it is `exact_tolerance` at most. With the recorded parameters every
    recorded equilibrium is one again. With others, a tolerance like the recorded one
    could accept it unmoved.
    """
    wanted = events.tolerance if tolerance is None else tolerance
    same = numbers(parameters) == events.parameters
    if same and not is_differentiated(parameters):
        return wanted
    return min(wanted, exact_tolerance())


def _parameters(
    scene: Scene, given: Parameters | Mapping[str, Scalar] | None
) -> Parameters:
    """Merge the given parameters into the scene's, or replace those."""
    if isinstance(given, Mapping):
        check_names(given, [field.name for field in fields(Parameters)])
        return replace(scene.parameters, **given)
    return scene.parameters if given is None else given
