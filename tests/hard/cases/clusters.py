"""Hard cases of particles alone."""

import warnings
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import jaxgrow as jg
from jaxgrow.transfer.device import get_particles, put_particles

from .case import Case, Found
from .examine import gyration, of_growth, of_relaxation, spacing


SLOTS = 64
"""Room of all clouds, so that they share their compiled programs."""


def cloud(position: Float[np.ndarray, "n 3"], slots: int = SLOTS) -> jg.Particles:
    """Free tissue particles at these places."""
    count = len(position)
    species = np.zeros(count, dtype=np.int64)
    return put_particles(position, species, np.zeros(count, bool), max(slots, count))


def relaxed(
    make: Callable[[], Float[np.ndarray, "n 3"]], **call: Any
) -> Callable[[], Found]:
    """A case that relaxes a cloud."""

    def run() -> Found:
        outcome = jg.relax(cloud(make()), **call)
        assert outcome.state[0] is not None
        position, _ = get_particles(outcome.state[0])
        found = of_relaxation(outcome, spacing=round(spacing(position), 3))
        if outcome.result is jg.Result.CONVERGED:
            parameters = call.get("parameters", jg.Parameters())
            residual = dense_residual(position, parameters)
            missed = residual > 1.01 * outcome.stats.residual + 1e-9
            found.defects["forces that the lists miss"] = int(missed)
        return found

    return run


def grown(
    divisions: int, tolerance: float = 1e-3, **parameters: float
) -> Callable[[], Found]:
    """A case that grows a free cluster."""

    def run() -> Found:
        scene = jg.Scene(organ=None, lesion=jg.Myoma(divisions=divisions))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", jg.UnstableAdhesionWarning)
            given = jg.Parameters(**parameters)
            growth = jg.grow(scene, parameters=given, tolerance=tolerance)
        position, _ = get_particles(growth.state.particles)
        found = of_growth(
            growth,
            gyration=round(gyration(growth), 2),
            spacing=round(spacing(position), 3),
        )
        kept = jg.relax(growth.state.particles, parameters=given, max_steps=0)
        moving = kept.stats.residual > 1.001 * tolerance
        found.defects["final states that are no equilibrium"] = int(moving)
        return found

    return run


def dense_residual(
    position: Float[np.ndarray, "n 3"], parameters: jg.Parameters
) -> float:
    """Largest force on a particle, by the sum over all pairs."""
    law = jg.A2(float(parameters.adhesion), float(parameters.smoothing))
    gap = position[:, None] - position[None]
    length = np.linalg.norm(gap, axis=-1)
    force = np.asarray(law.force(jnp.asarray(length))) / np.where(length, length, 1)
    total = (force[..., None] * gap).sum(axis=1)
    return float(np.linalg.norm(total, axis=1).max())


def at_one_point(count: int) -> Float[np.ndarray, "n 3"]:
    return np.full((count, 3), 0.3)


def in_a_cluster(count: int) -> Float[np.ndarray, "n 3"]:
    """Twenty particles around a point where all others are."""
    around = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 3))
    return np.concatenate([np.zeros((count, 3)), around])


def uniform(density: float, count: int = 60) -> Float[np.ndarray, "n 3"]:
    """Particles at random in a cube, so many per r0³."""
    side = (count / density) ** (1 / 3)
    return np.random.default_rng(0).uniform(0, side, (count, 3))


def line_that_folds() -> Float[np.ndarray, "n 3"]:
    """A chain that is drawn together far from where its list was made."""
    wobble = 0.3 * np.random.default_rng(10).normal(size=(60, 2))
    return np.column_stack([1.2 * np.arange(60), wobble])


def far_from_the_origin() -> Float[np.ndarray, "n 3"]:
    """A cloud across the place where a hashed grid of cells changes its sign."""
    return uniform(1.0) - 512.0 - 2.0


def far_apart() -> Float[np.ndarray, "n 3"]:
    """Two clouds a hundred million r0 from each other."""
    position = uniform(1.0)
    position[30:] += 1e8
    return position


def in_float32() -> Found:
    with jax.enable_x64(False):
        outcome = jg.relax(cloud(uniform(1.0)), tolerance=1e-3)
        assert outcome.state[0] is not None
        assert outcome.state[0].position.dtype == jnp.float32
        return of_relaxation(outcome)


def grow_in_float32() -> Found:
    with jax.enable_x64(False):
        return of_growth(jg.grow(jg.Scene(organ=None, lesion=jg.Myoma(divisions=3))))


def with_one_at_nan() -> Float[np.ndarray, "n 3"]:
    position = uniform(1.0)
    position[7] = np.nan
    return position


def one_at_nan() -> Found:
    """What is not finite at the start stays so; it must only be told."""
    found = relaxed(with_one_at_nan)()
    found.defects.pop("non-finite particles")
    return found


def cases() -> Iterator[Case]:
    """Particles without a membrane."""
    ok, stuck = ("CONVERGED",), ("STEP_LIMIT",)
    yield Case(
        "literal-law",
        "free cluster, adhesion 1, smoothing 0: the law collapses in 3-D",
        grown(60, 1e-2, adhesion=1.0, smoothing=0.0),
        ("STEP_LIMIT",),
    )
    yield Case(
        "adhesion-just-under",
        "free cluster, adhesion 149/371 - 0.001",
        grown(60, adhesion=149 / 371 - 0.001),
        ("REACHED",),
        slow=True,
    )
    yield Case(
        "adhesion-just-over",
        "free cluster, adhesion 149/371 + 0.001",
        grown(60, adhesion=149 / 371 + 0.001),
        ("REACHED",),
    )
    yield Case(
        "smoothing-0",
        "free cluster with the jumps of the printed force",
        grown(60, smoothing=0.0),
        ("REACHED", "STEP_LIMIT"),
    )
    yield Case(
        "two-at-one-point",
        "two particles at exactly the same position",
        relaxed(lambda: at_one_point(2)),
        ok,
    )
    yield Case(
        "40-at-one-point",
        "40 particles at exactly the same position",
        relaxed(lambda: at_one_point(40)),
        ok,
    )
    yield Case(
        "40-at-one-point-in-a-cluster",
        "40 particles at one point amid 20 others",
        relaxed(lambda: in_a_cluster(40)),
        ok,
    )
    yield Case(
        "far-too-dense",
        "60 particles at 30 per r0³",
        relaxed(lambda: uniform(30.0)),
        ok,
    )
    yield Case(
        "far-too-sparse",
        "60 particles at 0.02 per r0³: most are alone",
        relaxed(lambda: uniform(0.02)),
        ok,
    )
    yield Case(
        "line-that-folds",
        "a chain that draws itself together: its list overflows on the way",
        relaxed(
            line_that_folds, parameters=jg.Parameters(adhesion=0.4), tolerance=1e-4
        ),
        ok,
    )
    yield Case(
        "far-from-the-origin",
        "a cloud around -512 r0, where the hash of the cells turns",
        relaxed(far_from_the_origin),
        ok,
    )
    yield Case(
        "far-apart",
        "two clouds 1e8 r0 apart",
        relaxed(far_apart),
        ok,
    )
    yield Case(
        "particle-at-nan",
        "one position is NaN",
        one_at_nan,
        ("NON_FINITE",),
    )
    yield Case(
        "tolerance-below-rounding",
        "tolerance 1e-18: no double can tell",
        relaxed(lambda: uniform(1.0), tolerance=1e-18),
        (*stuck, *ok),
        slow=True,
    )
    yield Case(
        "tolerance-0",
        "tolerance 0",
        relaxed(lambda: uniform(1.0), tolerance=0.0),
        ("ValueError",),
        "tolerance is 0",
    )
    yield Case(
        "float32-relax",
        "relaxation in 32 bits, at a tolerance that they hold",
        in_float32,
        ok,
    )
    yield Case(
        "float32-grow",
        "growth in 32 bits",
        grow_in_float32,
        ("ValueError",),
        "computes in 32 bits",
    )
    yield Case(
        "tumour-stiffness-1000",
        "free cluster a thousand times stiffer than the tissue",
        grown(60, tumour_stiffness=1000.0),
        ("REACHED",),
    )
    yield Case(
        "adhesion-0",
        "free cluster that nothing holds together",
        grown(60, adhesion=0.0),
        ("REACHED",),
    )
    for divisions in (60, 300):
        for tolerance in (1e-1, 1e-10):
            yield Case(
                f"{divisions}-divisions-to-{tolerance:g}",
                f"free cluster, {divisions} divisions at tolerance {tolerance:g}",
                grown(divisions, tolerance),
                ("REACHED",),
                slow=True,
            )
