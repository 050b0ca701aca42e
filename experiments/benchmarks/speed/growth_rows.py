"""Rows: growing a free cluster from one particle, every division relaxed."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

import jaxgrow as jg
from jaxgrow.lesions.division import Division
from jaxgrow.transfer.device import get, get_particles

from .errors import errors_of, gyration
from .fire import FIRE
from .lbfgs import relax_lbfgs, Relaxed
from .measure import FEWEST, measure_in_turns, Options, Row


TOLERANCE = 1e-4

JAX_MD_UP_TO = 1000
"""Particles up to which jax-md grows the same cluster."""

MANY = 1000
"""Particles from which on what takes minutes is measured once; of so many are the bars:
for fewer, what a division costs apart from its forces decides."""

PARKING = 4.0
"""Distance of slots that are not used yet, in r0."""


class Grown(NamedTuple):
    """A cluster, and what its relaxations took.

    Attributes:
        position: of all particles, in r0.
        residual: largest of all relaxations, as the method itself sees it.
        evaluations: of forces, or steps, over all divisions.
    """

    position: Float[np.ndarray, "n 3"]
    residual: float
    evaluations: int


def grow_numba(
    divisions: list[Division],
    relax: Callable[[Float[np.ndarray, "n 3"]], Relaxed],
) -> Grown:
    """The same divisions, each relaxed by a yardstick.

    Args:
        divisions: who divides, and in which direction.
        relax: of any number of particles.
    """
    position, residual, evaluations = np.zeros((1, 3)), 0.0, 0
    for division in divisions:
        centre, offset = position[division.parent], np.array(division.offset)
        position = np.concatenate([position, [centre + offset]])
        position[division.parent] = centre - offset
        end = relax(position)
        position = end.position
        residual = max(residual, end.residual)
        evaluations += end.evaluations
    return Grown(position, residual, evaluations)


def parked(count: int, radius: float) -> Float[np.ndarray, "n 3"]:
    """Places far from a cluster of this radius and from each other."""
    side = int(np.ceil(count ** (1 / 3)))
    lattice = np.stack(np.unravel_index(np.arange(count), (side,) * 3), axis=1)
    return radius + PARKING * (1.0 + lattice)


def grow_jax_md(divisions: list[Division], fire: FIRE, radius: float) -> Grown:
    """The same divisions in one array of the final size, not to compile for each.

    Args:
        divisions: who divides, and in which direction.
        fire: for that size.
        radius: that the cluster stays within, in r0.
    """
    position = parked(len(divisions) + 1, radius)
    position[0] = 0.0
    residual, evaluations = 0.0, 0
    for division in divisions:
        centre, offset = position[division.parent], np.array(division.offset)
        position = position.copy()
        position[division.slot] = centre + offset
        position[division.parent] = centre - offset
        end = fire(position, TOLERANCE)
        position = end.position
        residual = max(residual, end.residual)
        evaluations += end.evaluations
    return Grown(position, residual, evaluations)


def grow_free(count: int, options: Options) -> Iterator[Row]:
    """A free cluster of that many particles, to 1e-4 after every division."""
    scene = jg.Scene(
        organ=None,
        lesion=jg.Myoma(divisions=count - 1),
        parameters=jg.Parameters(),
    )
    first = jg.grow(scene, tolerance=TOLERANCE)
    divisions = [division for event in first.events for division in event.divisions]
    lbfgs = lambda position: relax_lbfgs(position, tolerance=TOLERANCE)
    contenders: dict[str, Callable[[int], Any]] = {
        "jaxgrow": lambda _: jg.grow(scene, tolerance=TOLERANCE),
        "numba": lambda _: grow_numba(divisions, lbfgs),
    }
    if count <= JAX_MD_UP_TO:
        final = grow_numba(divisions, lbfgs).position
        radius = 1.5 * float(np.abs(final).max()) + 2.0
        room = float(parked(count, radius).max())
        # capacities are those of the final state, with jax-md's own headroom
        fire = FIRE(final, (-radius, room))
        contenders["jax-md"] = lambda _: grow_jax_md(divisions, fire, radius)
    limited = options.limited(1 if count >= MANY else FEWEST)
    measured = measure_in_turns(contenders, limited, shortest=0.0)
    ends = {name: outcomes[-1] for name, outcomes in measured.outcomes.items()}
    growth = ends["jaxgrow"]
    ends["jaxgrow"] = Grown(
        get_particles(growth.state.particles)[0],
        max(record.residual for record in growth.history),
        sum(record.steps for record in growth.history),
    )
    shared: dict[str, Any] = {
        "errors": {
            name: {
                "largest_residual": end.residual,
                "at_the_end": errors_of(end.position),
            }
            for name, end in ends.items()
        },
        "details": {
            "particles": count,
            "slots_of_jaxgrow": len(get(growth.state.particles.alive)),
            "tolerance": TOLERANCE,
            "result": growth.result.name,
            "evaluations_per_division": {
                name: end.evaluations / (count - 1) for name, end in ends.items()
            },
            "gyration": {name: gyration(end.position) for name, end in ends.items()},
            "seconds_of_jaxgrow_by_phase": growth.seconds,
            "compilations_of_jaxgrow": {
                "first": first.compilations,
                "measured": growth.compilations,
            },
        },
    }
    yield Row(
        f"grow-{count}-over-numba",
        f"grow 1 to {count} free to 1e-4: jaxgrow over numba L-BFGS",
        **measured.compare("jaxgrow", "numba"),
        bar=2.0 if count == MANY else None,
        **shared,
    )
    if "jax-md" in contenders:
        yield Row(
            f"grow-{count}-over-jax-md",
            f"grow 1 to {count} free to 1e-4: jax-md over jaxgrow",
            **measured.compare("jax-md", "jaxgrow"),
            bar=15.0 if count == MANY else None,
            side="least",
            **shared,
        )
