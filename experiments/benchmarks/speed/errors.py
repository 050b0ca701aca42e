"""How wrong a state is: against the equilibrium that it would come to at 1e-12."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

import jaxgrow as jg

from .lbfgs import relax_lbfgs
from .pairs import list_neighbours, pair_forces


REFERENCE = 1e-12
"""Tolerance of the reference, in F(0)."""


def relative(
    force: Float[np.ndarray, "n 3"], reference: Float[np.ndarray, "n 3"]
) -> float:
    """Largest error of a component over the largest component."""
    return float(np.abs(force - reference).max() / np.abs(reference).max())


def extended_forces(
    position: Float[np.ndarray, "n 3"],
    start: Int[np.ndarray, " n+1"],
    index: Int[np.ndarray, " p"],
    sample: Int[np.ndarray, " k"],
    *,
    adhesion: float,
    smoothing: float,
) -> Float[np.ndarray, "k 3"]:
    """Pair forces on a few particles in numpy's extended precision, smoothing > 0."""
    x = position.astype(np.longdouble)
    forces = np.zeros((len(sample), 3), np.longdouble)
    for row, i in enumerate(sample):
        apart = x[i] - x[index[start[i] : start[i + 1]]]
        u = np.sqrt((apart**2).sum(axis=1))
        share = np.clip((u - (0.5 - smoothing)) / (2 * smoothing), 0, 1)
        taper = np.clip((1.5 - u) / smoothing, 0, 1) * np.where(u > 1, adhesion, 1)
        size = (1 - u**2) * (1 - share) + (1 - u) * (2 - u) / 2 * share * taper
        forces[row] = ((size / u)[:, None] * apart).sum(axis=0)
    return forces


def residual(
    position: Float[np.ndarray, "n 3"], adhesion: float = 0.2, smoothing: float = 0.1
) -> float:
    """Largest force on any particle by a list made for these positions, in F(0)."""
    force = pair_forces(
        position, *list_neighbours(position), adhesion=adhesion, smoothing=smoothing
    )
    return float(np.sqrt((force**2).sum(axis=1)).max())


def energy(
    position: Float[np.ndarray, "n 3"], adhesion: float = 0.2, smoothing: float = 0.1
) -> float:
    """Energy of all pairs, in F(0) r0."""
    start, index = list_neighbours(position)
    owner = np.repeat(np.arange(len(position)), np.diff(start))
    distance = np.linalg.norm(position[owner] - position[index], axis=1)
    law = jg.A2(adhesion, smoothing)
    return 0.5 * float(np.sum(np.asarray(law.energy(jnp.asarray(distance)))))


def gyration(position: Float[np.ndarray, "n 3"]) -> float:
    """Radius of gyration, in r0."""
    return float(np.sqrt(position.var(axis=0).sum()))


def superposed(
    position: Float[np.ndarray, "n 3"], onto: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """The positions turned and moved to fit others best (Kabsch 1976)."""
    here, there = position - position.mean(axis=0), onto - onto.mean(axis=0)
    left, _, right = np.linalg.svd(here.T @ there)
    left[:, -1] *= np.sign(np.linalg.det(left @ right))
    return here @ left @ right + onto.mean(axis=0)


def errors_of(
    position: Float[np.ndarray, "n 3"],
    *,
    adhesion: float = 0.2,
    smoothing: float = 0.1,
    reference: Float[np.ndarray, "n 3"] | None = None,
) -> dict[str, Any]:
    """Errors of a state of free particles.

    Args:
        position: in r0.
        adhesion: of the law of the reference.
        smoothing: of the law of the reference.
        reference: the equilibrium; by default where this state itself goes on to, so
            that methods that come to different packings are compared by how well they
            settled.
    """
    law = {"adhesion": adhesion, "smoothing": smoothing}
    if reference is None:
        found = relax_lbfgs(position, tolerance=REFERENCE, max_steps=20_000, **law)
        reference = found.position
    apart = superposed(position, reference) - reference
    lowest = energy(reference, **law)
    return {
        "residual": residual(position, **law),
        "residual_of_reference": residual(reference, **law),
        "position_max": float(np.linalg.norm(apart, axis=1).max()),
        "position_rms": float(np.sqrt((apart**2).sum(axis=1).mean())),
        "energy_relative": (energy(position, **law) - lowest) / abs(lowest),
        "gyration": gyration(position) - gyration(reference),
    }
