"""Record of a division, and functions common to all rules (paper §4)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from jaxgrow.state import Particles, Species, State
from jaxgrow.transfer.device import get, with_capacity


SPARE = 128
"""Initial number of free slots for new particles."""


class Division(NamedTuple):
    """Discrete choices of one division, sufficient for a replay.

    Attributes:
        slot: of the new particle.
        parent: slot of the dividing particle of a myoma; -1 for a polyp, whose parent
            is a vertex.
        depth: of a polyp's new particle under the source, in daughter offsets: 1, and
            2, 3, … for further ones of the same step.
        source: vertex that emits a polyp's particle; -1 for a myoma.
        offset: of a myoma's new particle from the former position of its parent, in r0;
            of a polyp's from the source vertex, if the rule would leave the tissue.
    """

    slot: int
    parent: int = -1
    depth: int = 1
    source: int = -1
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)


def point_on_sphere(rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """Draw a point uniformly on the unit sphere.

    Marsaglia 1972, the paper's reference 6.
    """
    while True:
        a, b = rng.uniform(-1.0, 1.0, 2)
        square = a * a + b * b
        if square < 1:
            root = 2 * np.sqrt(1 - square)
            return np.array([a * root, b * root, 1 - 2 * square])


def add_particle(
    particles: Particles, slot: Int[Array, ""], position: Float[Array, "3"]
) -> Particles:
    """Add a tumour particle in a free slot.

    Args:
        particles: with room, see `with_room`.
        slot: free.
        position: of the new particle, in r0.
    """
    return Particles(
        position=particles.position.at[slot].set(position),
        species=particles.species.at[slot].set(int(Species.TUMOUR)),
        alive=particles.alive.at[slot].set(True),
        held=particles.held.at[slot].set(False),
    )


def with_room(particles: Particles) -> Particles:
    """Enlarge the capacity of particles without a free slot.

    They get as many more slots as there are tumour particles, `SPARE` at least.
    """
    capacity = particles.position.shape[0]
    if int(get(particles.alive).sum()) < capacity:
        return particles
    tumour = int((get(particles.species) == Species.TUMOUR).sum())
    return with_capacity(particles, capacity + max(SPARE, tumour))


def first_free_slot(state: State) -> int:
    """Return the first free slot of the particles."""
    return int(get(state.particles.alive).sum())
