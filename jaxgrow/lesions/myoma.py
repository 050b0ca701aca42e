"""Myoma: a ball under the surface; any particle may divide (paper §4)."""

import math
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxgrow.energy.parameters import Parameters
from jaxgrow.lesions.division import (
    add_particle,
    Division,
    first_free_slot,
    point_on_sphere,
)
from jaxgrow.lesions.lesion import Lesion
from jaxgrow.lesions.size import diameter_of
from jaxgrow.mesh.proximity import nearest_on_mesh
from jaxgrow.mesh.surface import Surface
from jaxgrow.organ import Organ, OrganError, room, Site, Tissue
from jaxgrow.runtime.entries import Positive
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Particles, Species, State
from jaxgrow.transfer.device import get, get_surface


HALF_DISTANCE = 0.5
"""Distance, in r0, by which each half of a dividing myoma particle moves."""


DEPTH = 0.25
"""Default depth of the first particle under the surface, as a share of the size."""

PROTRUDING = 0.5
"""Height of a myoma in a narrow canal, as a share of its diameter: 0.50 and 0.45 from
depths of a quarter and a half of it. On a wide wall it is a third."""

STAND_OFF = 0.7
"""Distance, in r0, of its surface from its particles."""


class Myoma(Lesion):
    """Myoma: a dense ball under the surface; any particle may divide.

    Its size is the largest diameter of the set of tumour particles.

    Attributes:
        depth_mm: of its first particle under the surface; a quarter of its size by
            default, so that it protrudes into the lumen.
    """

    kind: Literal["myoma"] = "myoma"
    depth_mm: Positive | None = None

    mechanics: ClassVar[dict[str, float]] = {
        "tumour_stiffness": 3.0,
        "area_modulus": 0.02,
    }
    particles_across: ClassVar[float] = 7.0
    needs_organ: ClassVar[bool] = False

    @property
    def depth(self) -> float:
        """Depth of its first particle under the surface, in r0."""
        if self.depth_mm is not None:
            return self.depth_mm / self.r0_mm
        return 2.0 if self.target_mm is None else DEPTH * self.target_mm / self.r0_mm

    def extent(self) -> tuple[float, float]:
        """Return radius and thickness of a patch that holds the ball, in r0.

        As it displaces tissue, two particles are added to its radius on every side.
        """
        return self.across / 2 + 2.5, self.depth + self.across / 2 + 2.0

    def check_site(self, organ: Organ, site: Site) -> None:
        """Refuse a myoma whose protruding part does not fit into the lumen.

        It protrudes by some half of its diameter, from whatever depth, and the surface
        keeps off its particles. A lumen that is too narrow for that is closed, and the
        surface crushed.

        Raises:
            OrganError: there is less room along the normal at the site.
        """
        if self.target_mm is None:
            return
        wide, needed = room(organ, site), PROTRUDING * self.target_mm
        if needed + STAND_OFF * self.r0_mm <= wide:
            return
        if self.particle_mm is None:
            most = wide / (PROTRUDING + STAND_OFF / self.particles_across)
        else:
            most = (wide - STAND_OFF * self.r0_mm) / PROTRUDING
        raise OrganError(
            f"a myoma of {self.target_mm:g} mm protrudes by some {needed:.1f} mm, and "
            f"at {site.name} of {organ.name} the opposite wall is {wide:.1f} mm away; "
            f"ask for {math.floor(10 * most) / 10:g} mm or less, or for another site."
        )

    def seed(
        self, surface: Surface, tissue: Tissue, site: Site
    ) -> tuple[Surface, Int[np.ndarray, " n"]]:
        """Mark the free particle nearest to the seed's depth as tumour."""
        species = np.full(len(tissue.points), int(Species.TISSUE))
        free = np.flatnonzero(~tissue.held)
        centre = -self.depth * site.normal
        distance = np.linalg.norm(tissue.points[free] - centre, axis=1)
        species[free[distance.argmin()]] = int(Species.TUMOUR)
        return surface, species

    def choose(
        self,
        state: State,
        parameters: Parameters,
        rng: np.random.Generator,
        count: int,
    ) -> tuple[Division, ...] | None:
        """Draw the dividing particles and their directions; none divides twice."""
        particles, slot = state.particles, first_free_slot(state)
        of_tumour = get(particles.species) == Species.TUMOUR
        tumour = np.flatnonzero(get(particles.alive) & of_tumour)
        clearance = np.full(len(tumour), np.inf)
        if state.membrane is not None:
            surface = get_surface(state.membrane)
            points = get(particles.position)[tumour]
            clearance, _, _ = nearest_on_mesh(points, surface.vertices, surface.faces)
        divisions = list[Division]()
        while len(tumour) and len(divisions) < count:
            division = choose_myoma(tumour, slot + len(divisions), clearance, rng)
            divisions.append(division)
            others = tumour != division.parent
            tumour, clearance = tumour[others], clearance[others]
        return tuple(divisions)

    def divide(self, state: State, division: Division, parameters: Parameters) -> State:
        """Divide a particle in two halves that move apart."""
        parent, slot = jnp.asarray(division.parent), jnp.asarray(division.slot)
        offset = jnp.asarray(division.offset)
        particles = divide_myoma(state.particles, parent, slot, offset)
        return State(particles, state.membrane, state.frame)

    def size(self, state: State) -> Scalar:
        """Measure the largest diameter of the tumour, in r0.

        The largest distance of two particles' centres, plus one particle diameter.
        """
        particles = state.particles
        tumour = get(particles.alive) & (get(particles.species) == Species.TUMOUR)
        return diameter_of(particles.position, np.flatnonzero(tumour)) + 1.0


@jax.jit
def divide_myoma(
    particles: Particles,
    parent: Int[Array, ""],
    slot: Int[Array, ""],
    offset: Float[Array, "3"],
) -> Particles:
    """Divide a tumour particle at x in two, at x + offset and x - offset.

    The new particle is at x + offset.
    """
    centre = particles.position[parent]
    moved = particles.at(particles.position.at[parent].set(centre - offset))
    return add_particle(moved, slot, centre + offset)


def choose_myoma(
    tumour: Int[np.ndarray, " t"],
    slot: int,
    clearance: Float[np.ndarray, " t"],
    rng: np.random.Generator,
) -> Division:
    """Draw the dividing particle and its direction, both uniformly.

    Each half moves by r0/2. A particle near the membrane moves by 0.4 of its distance
    to it at most, so that both halves stay on their side, which the paper's rule alone
    does not ensure.

    Args:
        tumour: slots of the tumour particles alive.
        slot: of the new particle.
        clearance: distance of each tumour particle to the membrane, in r0; infinite
            without one.
        rng: draws both.
    """
    index = int(rng.integers(len(tumour)))
    length = min(HALF_DISTANCE, 0.4 * float(clearance[index]))
    x, y, z = length * point_on_sphere(rng)
    offset = (float(x), float(y), float(z))
    return Division(slot, int(tumour[index]), offset=offset)
