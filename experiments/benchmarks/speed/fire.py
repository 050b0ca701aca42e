"""Yardstick: jax-md as it comes: its FIRE, an energy derived by JAX, its lists.

Nothing is tuned: `minimize.fire_descent` with its defaults, the energy of all listed
pairs through `smap.pair_neighbor_list`, `partition.neighbor_list` with a cut-off of
1.5 r0 and a skin of 0.4 r0, in 64 bits. One program does all steps of a relaxation; it
is compiled once for a number of particles and a capacity of the list, which are chosen
for the final state, so that nothing is compiled again on the way.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax_md import minimize, partition, smap, space
from jaxtyping import Array, Float
from numpy.polynomial import polynomial

from .lbfgs import Relaxed
from .pairs import CUTOFF


def a2_energy(
    u: Float[Array, "*shape"], adhesion: float, smoothing: float
) -> Float[Array, "*shape"]:
    """Energy of A2 in F(0) r0 at distance u, as short as it can be written.

    One polynomial for each interval, its coefficients made on the host. The form of
    `jaxgrow.A2.energy`, whose parameters may be traced, would cost jax-md 1.6 times as
    much.
    """
    near, far = np.array([1.0, 0.0, -1.0]), np.array([1.0, -1.5, 0.5])
    low, high, edge = 0.5 - smoothing, 0.5 + smoothing, CUTOFF - smoothing
    pieces = [(0.0, low, near), (high, 1.0, far), (1.0, edge, adhesion * far)]
    if smoothing > 0:
        share = np.array([-low, 1.0]) / (2 * smoothing)
        blend = polynomial.polyadd(near, polynomial.polymul(share, far - near))
        taper = np.array([CUTOFF, -1.0]) / smoothing
        tail = polynomial.polymul(adhesion * far, taper)
        pieces = [pieces[0], (low, high, blend), *pieces[1:], (edge, CUTOFF, tail)]
    value, total, top = jnp.zeros_like(u), 0.0, CUTOFF
    for begin, end, force in reversed(pieces):
        terms = -polynomial.polyint(force)
        terms[0] += total - polynomial.polyval(end, terms)
        total = polynomial.polyval(begin, terms)
        here = jnp.zeros_like(u)
        for term in terms[::-1]:
            here = here * u + term
        value, top = jnp.where(u < top, here, value), begin
    return value


SKIN = 0.4
"""Extra radius of the lists, in r0."""

ROOM = 4
"""Slots that a list and its cells get more of when they were too small."""

MARGIN = 4.0
"""Free room around all positions, in r0: jax-md's cells do not cover negative ones."""


class _Progress(NamedTuple):
    state: Any
    neighbours: Any
    residual: Array
    evaluations: Array
    lists: Array


class FIRE:
    """jax-md's FIRE for one number of particles.

    Args:
        example: positions whose neighbours just fit the list with jax-md's headroom.
        extent: least and largest coordinate that will occur, in r0.
        adhesion: of the law.
        smoothing: of the law.
        max_steps: bound on the number of steps.
    """

    def __init__(
        self,
        example: Float[np.ndarray, "n 3"],
        extent: tuple[float, float],
        *,
        adhesion: float = 0.2,
        smoothing: float = 0.1,
        max_steps: int = 5000,
    ) -> None:
        self._shift = MARGIN - extent[0]

        def law(u: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
            return a2_energy(u, adhesion, smoothing)

        displacement, shift = space.free()
        self._lists = partition.neighbor_list(
            displacement,
            box=extent[1] - extent[0] + 2 * MARGIN,
            r_cutoff=CUTOFF,
            dr_threshold=SKIN,
        )
        energy = smap.pair_neighbor_list(law, space.metric(displacement))
        init, apply = minimize.fire_descent(energy, shift)
        self._example = jnp.asarray(example + self._shift)
        self._roomy, self._extra = self._lists.allocate(self._example), 0

        def largest(force: Array) -> Array:
            return jnp.sqrt(jnp.max(jnp.sum(force**2, axis=1)))

        def relax(position: Array, neighbours: Any, tolerance: Array) -> _Progress:
            def running(now: _Progress) -> Array:
                fits = now.neighbours.error.code == 0
                unfinished = now.residual > tolerance
                return fits & unfinished & (now.evaluations <= max_steps)

            def move(now: _Progress) -> _Progress:
                before = now.neighbours.reference_position
                neighbours = now.neighbours.update(now.state.position)
                anew = jnp.any(neighbours.reference_position != before)
                state = apply(now.state, neighbor=neighbours)
                return _Progress(
                    state,
                    neighbours,
                    largest(state.force),
                    now.evaluations + 1,
                    now.lists + anew,
                )

            state = init(position, neighbor=neighbours)
            one = jnp.ones((), int)
            first = _Progress(state, neighbours, largest(state.force), one, one)
            return jax.lax.while_loop(running, move, first)

        self._relax = jax.jit(relax)
        self._update = jax.jit(lambda neighbours, at: neighbours.update(at))

    def listed(self, position: Float[np.ndarray, "n 3"]) -> Any:
        """The list for a start, in the capacity of the example's."""
        return self._update(self._roomy, jnp.asarray(position + self._shift))

    def __call__(
        self,
        position: Float[np.ndarray, "n 3"],
        tolerance: float,
        neighbours: Any = None,
    ) -> Relaxed:
        """Bring free particles to equilibrium.

        If the list is too small, a roomier one is allocated for this and all later
        calls, and the relaxation is made again; this compiles a new program.

        Args:
            position: in r0.
            tolerance: largest force allowed at the end, in F(0).
            neighbours: the list for them, of `listed`; made here if None.
        """
        if neighbours is None:
            neighbours = self.listed(position)
        start = jnp.asarray(position + self._shift)
        end = self._relax(start, neighbours, jnp.asarray(tolerance))
        while int(end.neighbours.error.code):
            self._extra += ROOM
            self._roomy = self._lists.allocate(
                self._example, extra_capacity=self._extra
            )
            end = self._relax(start, self.listed(position), jnp.asarray(tolerance))
        return Relaxed(
            np.asarray(end.state.position) - self._shift,
            float(end.residual),
            int(end.evaluations),
            int(end.lists),
        )


def relax_jax_md(
    position: Float[np.ndarray, "n 3"],
    *,
    tolerance: float,
    adhesion: float = 0.2,
    smoothing: float = 0.1,
    max_steps: int = 5000,
) -> Relaxed:
    """Bring free particles to equilibrium; see `FIRE` for a second call in less time.

    Args:
        position: in r0.
        tolerance: largest force allowed at the end, in F(0).
        adhesion: of the law.
        smoothing: of the law.
        max_steps: bound on the number of steps.
    """
    extent = float(position.min()), float(position.max())
    fire = FIRE(
        position, extent, adhesion=adhesion, smoothing=smoothing, max_steps=max_steps
    )
    return fire(position, tolerance)
