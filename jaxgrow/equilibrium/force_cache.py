"""Cache of pair forces, updated only near particles that changed.

After a division the force changes only on particles within the cutoff of one that
moved, or is new: for all others the sum over pairs is the same. So the forces are kept
with the particles they were evaluated for, and only those near a changed row are
evaluated again: in a tenth of the time for 10 000 of 100 000 particles.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgrow.energy.a2 import CUTOFF
from jaxgrow.energy.pair import PAIRS
from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.lists import Kept, Lists
from jaxgrow.equilibrium.loops import pair_module, with_loops
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.kernels import loops
from jaxgrow.neighbors.verlet_list import Neighbors
from jaxgrow.state import Particles, Species
from jaxgrow.transfer.device import get, get_number, put


LARGEST_SHARE = 0.25
"""Share of changed particles above which all forces are evaluated again."""


@eqx.filter_jit
def _forces(problem: Problem, lists: Lists) -> Float[Array, "n 3"]:
    force = problem.forces(problem.nodes(), lists).particles
    assert force is not None
    return force


def _law_of(parameters: Parameters) -> Float[np.ndarray, " p"]:
    values = (getattr(parameters, name) for name in PAIRS.parameters)
    return np.array([get_number(number) for number in values])


def evaluated(
    particles: Particles, neighbors: Neighbors, parameters: Parameters
) -> Kept:
    """Evaluate the pair forces on all particles, with a valid list."""
    lists, alone = Lists(neighbors, None), Problem.of(particles, None, parameters)
    force = _forces(with_loops(alone, lists), lists)
    return Kept(particles, put(_law_of(parameters)), force)


def renewed(
    kept: Kept | None, particles: Particles, parameters: Parameters
) -> Kept | None:
    """Update cached forces to the present particles.

    Args:
        kept: of the same slots; None if there are none.
        particles: at their present positions.
        parameters: of the energy.

    Returns:
        The same as a full evaluation, to rounding; None if a full evaluation is needed:
        too many particles changed, or no compiled loop is available.
    """
    kernel, law = loops("vicinity"), _law_of(parameters)
    root = pair_module() if particles.position.dtype == jnp.float64 else None
    if root is None or kept is None:
        return None
    if kept.force.shape != particles.position.shape or (get(kept.law) != law).any():
        return None
    now, before = _rows(particles), _rows(kept.particles)
    changed = np.zeros(len(now[0]), bool)
    count = kernel.differ(*now, *before, changed)
    if count == 0:
        return kept
    if not count <= LARGEST_SHARE * len(changed):
        return None
    force = np.array(kept.force)
    tumour = now[1] == Species.TUMOUR
    numbers = np.array([CUTOFF, *law])
    root.renew(now[0], tumour, now[2], before[0], before[2], changed, numbers, force)
    return Kept(particles, kept.law, put(force))


def _rows(particles: Particles) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions, species and liveness on the host."""
    return get(particles.position), get(particles.species), get(particles.alive)
