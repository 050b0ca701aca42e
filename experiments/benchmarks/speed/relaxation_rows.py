"""Rows: relaxing a ball, and one division in balls of two sizes."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxgrow as jg
from jaxgrow.equilibrium.methods import Method
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.transfer.device import get

from .errors import errors_of, residual
from .fire import FIRE
from .lbfgs import relax_lbfgs
from .measure import measure_in_turns, Options, Row
from .scenes import dense_ball, divided, particles_of, resting_ball


SIZES = 10_000, 100_000
"""Particles of the balls in which one divides."""


def relax_ball(options: Options) -> Iterator[Row]:
    """A jittered dense ball of 10 000 to 1e-6; lists for the start are given to all."""
    count, tolerance = 10_000, 1e-6
    position = dense_ball(count, np.random.default_rng(0))
    particles = particles_of(position)
    lists = allocate_lists(Problem.of(particles, None))
    fire = FIRE(position, (float(position.min()), float(position.max())))
    neighbours = fire.listed(position)
    measured = measure_in_turns(
        {
            "jaxgrow": lambda _: jg.relax(particles, tolerance=tolerance, lists=lists),
            "numba": lambda _: relax_lbfgs(position, tolerance=tolerance),
            "jax-md": lambda _: fire(position, tolerance, neighbours),
        },
        options,
        shortest=0.0,
    )
    own = measured.outcomes["jaxgrow"][-1]
    numba, jax_md = (measured.outcomes[name][-1] for name in ("numba", "jax-md"))
    ends = {
        "jaxgrow": get(own.state[0].position),
        "numba": numba.position,
        "jax-md": jax_md.position,
    }
    errors = {name: errors_of(end) for name, end in ends.items()}
    details = {
        "particles": count,
        "tolerance": tolerance,
        "result": own.result.name,
        "method": own.stats.method,
        "steps": own.stats.steps,
        "evaluations": {"numba": numba.evaluations, "jax-md": jax_md.evaluations},
        "lists": {"numba": numba.lists, "jax-md": jax_md.lists},
    }
    shared: dict[str, Any] = {
        "errors": errors,
        "details": details,
    }
    yield Row(
        "relax-10k-over-jax-md",
        "relax a ball of 10k to 1e-6: jax-md over jaxgrow",
        **measured.compare("jax-md", "jaxgrow"),
        bar=6.0,
        side="least",
        **shared,
    )
    yield Row(
        "relax-10k-over-numba",
        "relax a ball of 10k to 1e-6: jaxgrow over numba L-BFGS",
        **measured.compare("jaxgrow", "numba"),
        bar=1.8,
        **shared,
    )


def division(options: Options) -> Iterator[Row]:
    """One division at 100 000 particles over one at 10 000, to 1e-4.

    Every repetition is another division, the same one at both sizes. The lists are
    those that the division before left behind, as in a growth.
    """
    tolerance = 1e-4
    contenders: dict[str, Callable[[int], Any]] = {}
    for count in SIZES:
        ball, size = resting_ball(count), f"{count // 1000}k"
        starts = [divided(ball, k) for k in range(options.repetitions)]
        contenders[f"jaxgrow, {size}"] = Divisions(starts, tolerance)
        contenders[f"jaxgrow whole, {size}"] = Divisions(starts, tolerance, "lbfgs")
        contenders[f"numba, {size}"] = lambda k, starts=starts: relax_lbfgs(
            starts[k], tolerance=tolerance
        )
    measured = measure_in_turns(contenders, options, shortest=0.0)
    errors, steps = {}, {}
    for name, ends in measured.outcomes.items():
        own = name.startswith("jaxgrow")
        positions = [get(e.state[0].position) if own else e.position for e in ends]
        errors[name] = {"residual": max(map(residual, positions))}
        steps[name] = [e.stats.steps if own else e.evaluations for e in ends]
    shared: dict[str, Any] = {
        "errors": errors,
        "details": {"tolerance": tolerance, "steps": steps},
    }
    yield Row(
        "division-100k-over-10k",
        "one division, to 1e-4 over all particles: 100k over 10k",
        **measured.compare(*[f"jaxgrow, {n // 1000}k" for n in reversed(SIZES)]),
        bar=1.5,
        **shared,
    )
    yield Row(
        "division-100k-local",
        "one division at 100k, to 1e-4 over all particles: by parts over the whole",
        **measured.compare("jaxgrow, 100k", "jaxgrow whole, 100k"),
        **shared,
    )
    yield Row(
        "division-100k-over-numba",
        "one division at 100k, to 1e-4 over all particles: jaxgrow over numba L-BFGS",
        **measured.compare("jaxgrow, 100k", "numba, 100k"),
        **shared,
    )


class Divisions:
    """Relaxes a ball after each of several divisions, its lists kept from before.

    Args:
        starts: positions after each, in r0.
        tolerance: in F(0).
        method: of `jaxgrow.relax`.
    """

    def __init__(
        self,
        starts: list[Float[np.ndarray, "n 3"]],
        tolerance: float,
        method: Method = "auto",
    ) -> None:
        self._starts = [particles_of(start) for start in starts]
        self._tolerance = tolerance
        self._method: Method = method
        self._lists = allocate_lists(Problem.of(self._starts[0], None))

    def __call__(self, repetition: int) -> jg.Relaxation:
        """The equilibrium after one of them."""
        start = self._starts[repetition]
        end = jg.relax(
            start, tolerance=self._tolerance, method=self._method, lists=self._lists
        )
        self._lists = end.lists
        return end
