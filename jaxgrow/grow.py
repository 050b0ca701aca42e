"""The growth loop: divide, adapt, fair, reset (paper §4)."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from jaxgrow.compilations import count_compilations
from jaxgrow.division import choose_myoma, divide_myoma, divide_polyp, Division
from jaxgrow.equilibrium.problem import Lists
from jaxgrow.equilibrium.relax import relax, Relaxation, stale
from jaxgrow.growth import Event, Growth, Progress
from jaxgrow.lesion import size_of
from jaxgrow.mesh.fairing import fair
from jaxgrow.mesh.proximity import nearest_on_mesh
from jaxgrow.mesh.surface import Remeshing
from jaxgrow.parameters import Parameters
from jaxgrow.planting import plant, SPARE
from jaxgrow.results import Result
from jaxgrow.scene import Myoma, Scene
from jaxgrow.state import Particles, Species, State
from jaxgrow.transfer import (
    get,
    get_particles,
    get_surface,
    put_remeshed,
    with_capacity,
)


@dataclass(frozen=True, eq=False)
class Step:
    """The state between two divisions, with what is carried along on the host."""

    state: State
    organ_index: Int[np.ndarray, " m"]
    lists: Lists | None


def grow(
    scene: Scene,
    *,
    seed: int = 0,
    parameters: Parameters | None = None,
    tolerance: float = 1e-3,
    max_divisions: int = 3000,
    progress: Callable[[Progress], None] | None = None,
) -> Growth:
    """Grow a lesion until it has the size, or the number of divisions, asked for.

    Every iteration makes the paper's steps in its order: one tumour particle divides,
    tissue and surface come to equilibrium (here together, see `jaxgrow.relax`), the
    surface is faired, and its springs get their current length as new rest length.

    Args:
        scene: what to grow, and where.
        seed: of all random choices; the same seed gives the same growth.
        parameters: of the mechanics, instead of the scene's.
        tolerance: largest force left in every equilibrium, in F(0).
        max_divisions: bound on the divisions, for a size that is never reached.
        progress: called after every division.

    Returns:
        The growth. Its result is REACHED, or says why it ended before that, with the
        last equilibrium as its state.

    Raises:
        OrganError: the organ or the site cannot be used.
        SceneError: the lesion does not fit.
        ValueError: JAX computes in 32 bits, or the tolerance is not positive.
    """
    if jnp.zeros(()).dtype != jnp.float64:
        raise ValueError(
            "JAX computes in 32 bits here, and growth needs 64; put "
            'jax.config.update("jax_enable_x64", True) before it, or set '
            "JAX_ENABLE_X64=1."
        )
    parameters = parameters or scene.parameters
    rng = np.random.default_rng(seed)
    clock = _Clock()
    with count_compilations() as compilations:
        with clock.phase("plant"):
            planted = plant(scene, parameters, tolerance=tolerance, rng=rng)
        lists = None if planted.outcome is None else planted.outcome.lists
        step = Step(planted.state, planted.organ_index, lists)
        result = Result.CONVERGED
        if planted.outcome is not None:
            result = planted.outcome.result
        events: list[Event] = []
        history: list[dict[str, Any]] = []
        size = size_of(scene, step.state) * scene.r0_mm
        while result is Result.CONVERGED:
            if _done(scene, size, len(events)):
                result = Result.REACHED
            elif len(events) == max_divisions:
                result = Result.DIVISION_LIMIT
            else:
                step, event, relaxed = _iterate(
                    scene, step, parameters, tolerance, rng, clock
                )
                result = relaxed.result
                events.append(event)
                with clock.phase("measure"):
                    size = size_of(scene, step.state) * scene.r0_mm
                record = _record(len(events), size, step, event, relaxed, clock)
                history.append(record)
                if progress is not None:
                    progress(_progress(scene, record, clock))
    return Growth(
        scene=scene,
        seed=seed,
        tolerance=tolerance,
        state=step.state,
        result=result,
        size_mm=size,
        events=tuple(events),
        history=tuple(history),
        seconds=dict(clock.total),
        compilations=compilations.count,
        ground=planted.ground,
        organ_index=step.organ_index,
    )


def _done(scene: Scene, size: float, divisions: int) -> bool:
    """Whether the lesion has its size, or made its divisions."""
    target = scene.lesion.target_mm
    if target is None:
        return divisions >= (scene.lesion.divisions or 0)
    return size >= target


def _iterate(
    scene: Scene,
    step: Step,
    parameters: Parameters,
    tolerance: float,
    rng: np.random.Generator,
    clock: "_Clock",
) -> tuple[Step, Event, Relaxation]:
    """One iteration of the paper's loop."""
    with clock.phase("divide"):
        state, division = divide_tumour(scene, step.state, parameters, rng)
    with clock.phase("adapt"):
        state, relaxed = adapt_tissue_and_surface(
            state, parameters, tolerance, step.lists
        )
    organ_index, remeshing = step.organ_index, None
    if state.membrane is not None and relaxed.result is Result.CONVERGED:
        with clock.phase("fair"):
            state, remeshing = fair_surface(scene, state)
        origin = remeshing.origin()
        organ_index = np.where(origin >= 0, organ_index[origin], -1)
    step = Step(state, organ_index, stale(relaxed.lists))
    return step, Event(division, remeshing), relaxed


def divide_tumour(
    scene: Scene, state: State, parameters: Parameters, rng: np.random.Generator
) -> tuple[State, Division]:
    """1. Divide one tumour particle."""
    particles = _with_room(state.particles)
    slot = int(get(particles.alive).sum())
    if isinstance(scene.lesion, Myoma):
        division = _choose(state, slot, rng)
        particles = divide_myoma(
            particles,
            jnp.asarray(division.parent),
            jnp.asarray(slot),
            jnp.asarray(division.offset),
        )
    else:
        assert state.membrane is not None
        division = Division(slot)
        particles = divide_polyp(
            particles, state.membrane, jnp.asarray(slot), parameters
        )
    return State(particles, state.membrane, state.frame), division


def adapt_tissue_and_surface(
    state: State, parameters: Parameters, tolerance: float, lists: Lists | None
) -> tuple[State, Relaxation]:
    """2. and 3. Adapt tissues and surface: their common equilibrium."""
    relaxed = relax(
        state.particles,
        state.membrane,
        parameters=parameters,
        tolerance=tolerance,
        lists=lists,
    )
    particles, membrane = relaxed.state
    assert particles is not None
    return State(particles, membrane, state.frame), relaxed


def fair_surface(scene: Scene, state: State) -> tuple[State, Remeshing]:
    """4. Surface fairing; all springs are assigned their current length."""
    assert state.membrane is not None
    position, _ = get_particles(state.particles)
    surface, remeshing = fair(
        get_surface(state.membrane),
        position,
        max_area=scene.surroundings.max_area,
        min_area=scene.surroundings.min_area,
    )
    membrane = put_remeshed(state.membrane, surface, remeshing)
    return State(state.particles, membrane, state.frame), remeshing


def _choose(state: State, slot: int, rng: np.random.Generator) -> Division:
    """Draw a myoma's division, with the clearances that bound it."""
    particles = state.particles
    of_tumour = get(particles.species) == Species.TUMOUR
    tumour = np.flatnonzero(get(particles.alive) & of_tumour)
    clearance = np.full(len(tumour), np.inf)
    if state.membrane is not None:
        surface = get_surface(state.membrane)
        points = get(particles.position)[tumour]
        clearance, _, _ = nearest_on_mesh(points, surface.vertices, surface.faces)
    return choose_myoma(tumour, slot, clearance, rng)


def _with_room(particles: Particles) -> Particles:
    """Particles with a free slot; when they are full, half as many spare ones more."""
    capacity = particles.position.shape[0]
    if int(get(particles.alive).sum()) < capacity:
        return particles
    tumour = int((get(particles.species) == Species.TUMOUR).sum())
    return with_capacity(particles, capacity + max(SPARE, tumour))


class _Clock:
    """Seconds by phase, in all and since the last record."""

    def __init__(self) -> None:
        self.start = time.perf_counter()
        self.total: defaultdict[str, float] = defaultdict(float)
        self.recent: defaultdict[str, float] = defaultdict(float)

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        spent = time.perf_counter() - start
        self.total[name] += spent
        self.recent[name] += spent

    @property
    def elapsed(self) -> float:
        return time.perf_counter() - self.start


def _record(
    division: int,
    size: float,
    step: Step,
    event: Event,
    relaxed: Relaxation,
    clock: _Clock,
) -> dict[str, Any]:
    """What is written about one division."""
    particles, membrane = step.state.particles, step.state.membrane
    alive = get(particles.alive)
    record: dict[str, Any] = {
        "division": division,
        "size_mm": size,
        "residual": relaxed.stats.residual,
        "steps": relaxed.stats.steps,
        "method": relaxed.stats.method,
        "overflows": relaxed.stats.overflows,
        "result": relaxed.result.name,
        "particles": int(alive.sum()),
        "tumour": int((alive & (get(particles.species) == Species.TUMOUR)).sum()),
    }
    if membrane is not None:
        record["vertices"] = int(get(membrane.vertex_alive).sum())
        record["faces"] = int(get(membrane.face_alive).sum())
    if event.remeshing is not None:
        record["operations"] = dict(event.remeshing.counts)
    record["seconds"] = dict(clock.recent)
    clock.recent.clear()
    return record


def _progress(scene: Scene, record: dict[str, Any], clock: _Clock) -> Progress:
    return Progress(
        divisions=record["division"],
        size_mm=record["size_mm"],
        target_mm=scene.lesion.target_mm,
        target_divisions=scene.lesion.divisions,
        residual=record["residual"],
        seconds=clock.elapsed,
    )
