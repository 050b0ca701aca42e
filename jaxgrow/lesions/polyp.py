"""Polyp: a vertex of the surface emits all particles (paper §4)."""

from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxgrow.energy.parameters import Parameters
from jaxgrow.lesions.division import add_particle, Division, first_free_slot
from jaxgrow.lesions.lesion import Lesion
from jaxgrow.lesions.size import diameter_of, height_above, RAISED, raised
from jaxgrow.mesh.surface import Surface
from jaxgrow.numerics.guards import safe_norm
from jaxgrow.organ import Site, Tissue
from jaxgrow.organ.signed_distance import Sides
from jaxgrow.organ.tissue import HOLD
from jaxgrow.runtime.entries import SceneError
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Membrane, Particles, Species, State
from jaxgrow.transfer.device import get, get_number, get_surface


DEEPEST = 0.5
"""Share of the free layer of tissue under a polyp in which new particles are placed."""


class Polyp(Lesion):
    """Polyp: a local overgrowth, all of its particles from one vertex.

    The vertex of the surface is called its source. The size is the largest diameter of
    the surface raised above the former one.
    """

    kind: Literal["polyp"] = "polyp"

    pushes_off: ClassVar[bool] = True

    def extent(self) -> tuple[float, float]:
        """Return radius and thickness of a patch around the base, in r0.

        The patch is only a little wider than the base.
        """
        return max(6.5, 0.5 * self.across), 3.0

    def seed(
        self, surface: Surface, tissue: Tissue, site: Site
    ) -> tuple[Surface, Int[np.ndarray, " n"]]:
        """Mark the vertex nearest to the site as the source."""
        inner = np.flatnonzero(~surface.fixed)
        source = inner[np.linalg.norm(surface.vertices[inner], axis=1).argmin()]
        seeded = Surface(surface.vertices, surface.faces, surface.fixed, int(source))
        return seeded, np.full(len(tissue.points), int(Species.TISSUE))

    def check_start(self, state: State, density: float) -> None:
        """Refuse tissue that lifts the surface as a polyp would.

        Raises:
            SceneError: the measured size would be that of the lift.
        """
        if self.target_mm is not None:
            check_lift(state, density)

    def most_at_once(self, thickness: float, parameters: Parameters) -> int:
        """Return the number of particles with enough room, one below the other."""
        deepest = DEEPEST * (thickness - HOLD)
        return max(1, int(deepest / get_number(parameters.daughter_offset)))

    def choose(
        self,
        state: State,
        parameters: Parameters,
        rng: np.random.Generator,
        count: int,
    ) -> tuple[Division, ...] | None:
        """Place particles under the source, one below the other, without drawing."""
        assert state.membrane is not None
        slot = first_free_slot(state)
        surface, divisions = get_surface(state.membrane), list[Division]()
        for depth in range(1, count + 1):
            far = jnp.asarray(float(depth))
            place = get(_daughter_of_source(state.membrane, far, parameters))
            division = choose_polyp(surface, slot + depth - 1, place, depth)
            if division is None:
                break
            divisions.append(division)
        return tuple(divisions) or None

    def divide(self, state: State, division: Division, parameters: Parameters) -> State:
        """Add a particle under the source."""
        membrane, slot = state.membrane, jnp.asarray(division.slot)
        assert membrane is not None
        if any(division.offset):
            offset = jnp.asarray(division.offset)
            particles = divide_polyp_to(state.particles, membrane, slot, offset)
        else:
            depth = jnp.asarray(float(division.depth))
            given = state.particles, membrane, slot, depth, parameters
            particles = divide_polyp(*given)
        return State(particles, membrane, state.frame)

    def size(self, state: State) -> Scalar:
        """Measure the largest diameter of the raised surface, in r0."""
        assert state.membrane is not None
        alive = np.flatnonzero(get(state.membrane.vertex_alive))
        return diameter_of(state.membrane.vertices, alive[raised(state)])


def check_lift(state: State, density: float) -> None:
    """Refuse tissue that lifts the surface as a polyp would.

    Args:
        state: relaxed, before the first division.
        density: of the tissue, per r0³, for the message.

    Raises:
        SceneError: the measured size would be that of the lift.
    """
    membrane, former = state.membrane, state.frame.former
    assert membrane is not None
    assert former is not None
    surface = get_surface(membrane)
    height = height_above(surface.vertices, get(former.vertices), get(former.faces))
    if height.max() > RAISED:
        raise SceneError(
            f"tissue of density {density:g} per r0³ lifts the surface by "
            f"{height.max():.2g} r0 before anything grows, as much as counts as a "
            "lesion; ask for less density or softer springs (the defaults are 1.7 and "
            "0.04)."
        )


def source_normal(membrane: Membrane) -> Float[Array, "3"]:
    """Compute the unit normal of the membrane at its source, into the lumen.

    It is the mean of the normals of the triangles around the source, weighted by their
    areas.
    """
    corners = membrane.vertices[membrane.faces]
    edges = corners[:, 1:] - corners[:, :1]
    area = jnp.cross(edges[:, 0], edges[:, 1])
    touching = jnp.any(membrane.faces == membrane.source, axis=1)
    here = touching & membrane.face_alive
    total = jnp.sum(jnp.where(here[:, None], area, 0), axis=0)
    length = safe_norm(total)
    return total / jnp.where(length > 0, length, 1)


def daughter_of_source(
    membrane: Membrane, depth: Scalar, parameters: Parameters
) -> Float[Array, "3"]:
    """Compute the position of a new particle by the rule, in r0.

    x = x_source - k δ n, with the depth k (see `Division.depth`), the daughter offset δ
    and the surface normal n.
    """
    start = membrane.vertices[membrane.source]
    return start - depth * parameters.daughter_offset * source_normal(membrane)


_daughter_of_source = jax.jit(daughter_of_source)


@jax.jit
def divide_polyp(
    particles: Particles,
    membrane: Membrane,
    slot: Int[Array, ""],
    depth: Float[Array, ""],
    parameters: Parameters,
) -> Particles:
    """Add a tumour particle under the source vertex: x = x_source - δ n.

    It is placed slightly inside the tissue, "to ensure that it will never fall outside
    the endometrium"; relaxation pushes it further in. Of several in one step the second
    is at 2δ, the third at 3δ. See `choose_polyp`.
    """
    return add_particle(
        particles, slot, daughter_of_source(membrane, depth, parameters)
    )


@jax.jit
def divide_polyp_to(
    particles: Particles,
    membrane: Membrane,
    slot: Int[Array, ""],
    offset: Float[Array, "3"],
) -> Particles:
    """Add a tumour particle at a given offset: x = x_source + offset."""
    return add_particle(particles, slot, membrane.vertices[membrane.source] + offset)


def choose_polyp(
    surface: Surface, slot: int, place: Float[np.ndarray, "3"], depth: int = 1
) -> Division | None:
    """Choose the division of a source, with the daughter inside the tissue.

    Under a needle-like surface the rule's normal may lead out of the tissue. Then the
    daughter is placed at the deepest point at the same distance, or at a half or a
    quarter of it.

    Args:
        surface: with the source.
        slot: of the new particle.
        place: by the rule, x_source - k δ n.
        depth: k, a multiple of δ.

    Returns:
        The choice; None if every direction leads out.
    """
    start = surface.vertices[surface.source]
    delta = float(np.linalg.norm(place - start))
    # twice as far as anything that can be nearest, with the longest edges around
    around = surface.vertices[surface.faces[(surface.faces == surface.source).any(1)]]
    box = 2 * (delta + np.abs(around - start).max())
    sides = Sides(surface.vertices, surface.faces, start - box, start + box)
    if sides.measure(place[None]).side[0] < 0:
        return Division(slot, depth=depth)
    index = np.arange(_WAYS)
    height = 1 - (2 * index + 1) / _WAYS
    flat, turn = np.sqrt(1 - height**2), 2.399963 * index
    ways = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    for length in (delta, delta / 2, delta / 4):
        found = sides.measure(start + length * ways)
        deepness = np.where(found.side < 0, found.distance, 0)
        if deepness.max() > 0:
            x, y, z = length * ways[deepness.argmax()]
            return Division(slot, depth=depth, offset=(float(x), float(y), float(z)))
    return None


_WAYS = 256
"""Number of directions tried, spread evenly over the sphere (a Fibonacci lattice)."""
