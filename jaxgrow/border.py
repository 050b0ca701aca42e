"""What the border of a patch feels: its rim, and the tissue that is held around it.

A patch is large enough if what holds it does not feel the lesion: if the forces on the
rim and on the held tissue are about those before growth, when tissue and pretension
alone act there, and if no tumour particle lies against them.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from jaxgrow.equilibrium.relax import Relaxation
from jaxgrow.state import Particles, Species
from jaxgrow.transfer import get


FELT = 0.3
"""Change of a force on the border, in F(0), above which a patch is too small.

Rearrangements in random tissue change the forces on its held particles by 0.1 to 0.17
in every growth.
"""

AGAINST = 0.85
"""Distance of a tumour particle to what is held, in r0, below which it presses on it:
neighbours at rest are 0.9 to 1 apart."""


@dataclass(frozen=True, eq=False)
class Border:
    """What is held around a patch, and the forces on it.

    Attributes:
        names: of the rim's vertices in the organ, ascending; then -1 for each held
            particle, by slot.
        position: in r0.
        force: in F(0).
    """

    names: Int[np.ndarray, " b"]
    position: Float[np.ndarray, "b 3"]
    force: Float[np.ndarray, "b 3"]


class Feeling(NamedTuple):
    """How a border feels the lesion.

    Attributes:
        force: largest change of a force since before growth, in F(0).
        distance: of the nearest tumour particle, in r0; infinite without any.
        place: where, in r0, if the border feels it; else None.
    """

    force: float
    distance: float
    place: Float[np.ndarray, "3"] | None


def border_of(relaxation: Relaxation, organ_index: Int[np.ndarray, " m"]) -> Border:
    """The border after the relaxation of a patch.

    Args:
        relaxation: of particles and membrane.
        organ_index: of each vertex alive the organ's vertex that it is.
    """
    particles, membrane = relaxation.state
    assert particles is not None
    assert membrane is not None
    forces = relaxation.forces
    assert forces.particles is not None
    assert forces.vertices is not None
    rim = np.flatnonzero(get(membrane.pinned)[get(membrane.vertex_alive)])
    rim = rim[np.argsort(organ_index[rim])]
    held = np.flatnonzero(get(particles.alive & particles.held))

    def both(
        vertices: Float[Array, "m 3"], points: Float[Array, "n 3"]
    ) -> Float[np.ndarray, "b 3"]:
        return np.concatenate([get(vertices)[rim], get(points)[held]])

    return Border(
        names=np.concatenate([organ_index[rim], np.full(len(held), -1)]),
        position=both(membrane.vertices, particles.position),
        force=both(forces.vertices, forces.particles),
    )


def feeling(border: Border, before: Border, particles: Particles) -> Feeling:
    """Whether a border feels the lesion.

    Args:
        border: now.
        before: the same border before growth.
        particles: now.
    """
    change = np.linalg.norm(border.force - before.force, axis=1)
    position, alive = get(particles.position), get(particles.alive)
    tumour = position[alive & (get(particles.species) == Species.TUMOUR)]
    distance = np.full(len(change), np.inf)
    if len(tumour):
        distance, _ = KDTree(tumour).query(border.position)
    force, nearest = float(change.max()), float(distance.min())
    place = None
    if force > FELT:
        place = border.position[change.argmax()]
    elif nearest < AGAINST:
        place = border.position[distance.argmin()]
    return Feeling(force, nearest, place)
