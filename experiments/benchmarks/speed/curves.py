"""Work-precision curves: error against seconds, along the axes of a `Setting`.

A point is one setting, relaxed from the same jittered dense ball as all others; on the
axis "division" from a ball at rest in which one particle divided, where jaxgrow's
"auto" relaxes by parts and its "lbfgs" the whole. Its errors are those of
`speed.errors.errors_of`: against the equilibrium to 1e-12 that its own end goes on to,
under the law of the axis. Another relaxer is an entry of `RELAXERS`, another axis one
of `AXES`.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import jaxgrow as jg
from jaxgrow.equilibrium.methods import Method
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.neighbors import verlet_list as nb
from jaxgrow.neighbors.verlet_list import SKIN
from jaxgrow.transfer.device import get

from .errors import errors_of
from .fire import FIRE, SKIN as SKIN_OF_JAX_MD
from .lbfgs import relax_lbfgs
from .measure import measure_in_turns, Options, spread
from .scenes import dense_ball, divided, particles_of, resting_ball


Points = Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class Setting:
    """One way to relax.

    Attributes:
        relaxer: name in `RELAXERS`.
        tolerance: largest force left, in F(0).
        smoothing: of the law, in r0.
        dtype: of the positions.
        skin: extra radius of the lists, in r0.
        sharpness: of the smooth minimum over triangles, where there is a membrane.
    """

    relaxer: str = "jaxgrow auto"
    tolerance: float = 1e-4
    smoothing: float = 0.1
    dtype: Literal["float64", "float32"] = "float64"
    skin: float = SKIN
    sharpness: float = jg.Parameters.contact_sharpness


JAXGROWS_SKINS = {
    0.05: "bfloat16",
    0.1: "tensorfloat32",
    SKIN: None,
    0.3: "float32",
    0.4: "high",
    0.6: "highest",
}
"""Skins of jaxgrow's lists that are tried, and what keeps their programs apart: they
are looked up by the precision of products of 32 bits, of which there are none."""


@contextmanager
def skin_of(skin: float) -> Iterator[None]:
    """Within the block jaxgrow's lists have this skin, which is a constant of it."""
    own, nb.SKIN = nb.SKIN, skin
    try:
        with jax.default_matmul_precision(JAXGROWS_SKINS[skin]):
            yield
    finally:
        nb.SKIN = own


def jaxgrow(method: Method) -> Callable[[Setting, Points], Callable[[int], Any]]:
    """A method of `jaxgrow.relax`, lists for the start given."""

    def prepared(setting: Setting, start: Points) -> Callable[[int], Any]:
        particles = eqx.tree_at(
            lambda p: p.position,
            particles_of(start),
            jnp.asarray(start, setting.dtype),
        )
        parameters = jg.Parameters(smoothing=setting.smoothing)
        with skin_of(setting.skin):
            lists = allocate_lists(Problem.of(particles, None, parameters))

        def relax(_: int) -> Any:
            with skin_of(setting.skin):
                end = jg.relax(
                    particles,
                    parameters=parameters,
                    tolerance=setting.tolerance,
                    method=method,
                    lists=lists,
                )
            assert end.state[0] is not None
            return get(end.state[0].position).astype(float), end.result.name

        return relax

    return prepared


def numba_lbfgs(setting: Setting, start: Points) -> Callable[[int], Any]:
    """The yardstick's L-BFGS."""
    if setting.dtype != "float64":
        raise ValueError("the yardsticks compute in 64 bits.")
    return lambda _: (
        relax_lbfgs(
            start,
            tolerance=setting.tolerance,
            smoothing=setting.smoothing,
            skin=setting.skin,
        ).position,
        "",
    )


def jax_md_fire(setting: Setting, start: Points) -> Callable[[int], Any]:
    """jax-md as it comes."""
    if setting.dtype != "float64" or setting.skin != SKIN_OF_JAX_MD:
        raise ValueError(f"jax-md has 64 bits and a skin of {SKIN_OF_JAX_MD}.")
    extent = float(start.min()), float(start.max())
    fire = FIRE(start, extent, smoothing=setting.smoothing)
    neighbours = fire.listed(start)
    return lambda _: (fire(start, setting.tolerance, neighbours).position, "")


RELAXERS: dict[str, Callable[[Setting, Points], Callable[[int], Any]]] = {
    "jaxgrow auto": jaxgrow("auto"),
    "jaxgrow lbfgs": jaxgrow("lbfgs"),
    "jaxgrow fire": jaxgrow("fire"),
    "numba lbfgs": numba_lbfgs,
    "jax-md fire": jax_md_fire,
}

SKINS = {"numba lbfgs": 0.4, "jax-md fire": SKIN_OF_JAX_MD}
"""Of the yardsticks as they come, in r0."""

TOLERANCES = tuple(10.0**-k for k in range(1, 9))

AXES: dict[str, list[Setting]] = {
    "tolerance": [
        Setting(relaxer=name, tolerance=t, skin=SKINS.get(name, SKIN))
        for name in RELAXERS
        for t in TOLERANCES
    ],
    "smoothing": [
        replace(Setting(tolerance=1e-6), smoothing=s)
        for s in (0.02, 0.05, 0.1, 0.15, 0.2)
    ],
    "dtype": [
        Setting(relaxer="jaxgrow lbfgs", tolerance=t, dtype=d)
        for d in ("float64", "float32")
        for t in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
    ],
    "skin": [
        Setting(relaxer="jaxgrow lbfgs", tolerance=1e-6, skin=s) for s in JAXGROWS_SKINS
    ],
    "division": [
        Setting(relaxer=name, tolerance=t, skin=SKINS.get(name, SKIN))
        for name in ("jaxgrow auto", "jaxgrow lbfgs", "numba lbfgs")
        for t in TOLERANCES
    ],
}


def work_precision(axis: str, options: Options) -> Iterator[dict[str, Any]]:
    """The points of an axis, all measured in turns.

    Args:
        axis: name in `AXES`.
        options: a ball of 1000 particles if quick, of 10 000 if not; three times as
            many where one divides.
    """
    count = 1000 if options.quick else 10_000
    if axis == "division":
        start = divided(resting_ball(3 * count), 0)
    else:
        start = dense_ball(count, np.random.default_rng(0))
    settings = {str(number): s for number, s in enumerate(AXES[axis])}
    contenders = {n: RELAXERS[s.relaxer](s, start) for n, s in settings.items()}
    measured = measure_in_turns(contenders, options, shortest=0.0)
    for name, setting in settings.items():
        position, result = measured.outcomes[name][-1]
        # another law has another equilibrium: its error is against the default's
        law = Setting() if axis == "smoothing" else setting
        yield {
            **asdict(setting),
            "axis": axis,
            "particles": len(start),
            "result": result,
            "seconds": spread(measured.seconds[name]),
            "cpu_seconds": spread(measured.cpu_seconds[name]),
            "errors": errors_of(position, smoothing=law.smoothing),
        }
