"""Division of one tumour particle: the only active process (paper §4)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxgrow.energy.parameters import Parameters
from jaxgrow.mesh.surface import Surface
from jaxgrow.numerics.guards import safe_norm
from jaxgrow.organ.signed_distance import Sides
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Membrane, Particles, Species


HALF_DISTANCE = 0.5
"""Distance, in r0, by which a dividing myoma particle and its daughter move apart."""


class Division(NamedTuple):
    """The discrete choices of one division, enough to replay it.

    Attributes:
        slot: of the new particle.
        parent: of a myoma; -1 for a polyp, whose parent is the source vertex.
        depth: of a polyp's new particle under the source, in daughter offsets: 1, and
            2, 3, … for those that are born together with it.
        offset: of a myoma's new particle from where its parent was, in r0; of a
            polyp's from the source vertex, where the rule would leave the tissue.
    """

    slot: int
    parent: int = -1
    depth: int = 1
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)


def point_on_sphere(rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """A point uniform on the unit sphere (Marsaglia 1972, the paper's reference 6)."""
    while True:
        a, b = rng.uniform(-1.0, 1.0, 2)
        square = a * a + b * b
        if square < 1:
            root = 2 * np.sqrt(1 - square)
            return np.array([a * root, b * root, 1 - 2 * square])


def source_normal(membrane: Membrane) -> Float[Array, "3"]:
    """Unit normal of the membrane at its source, into the lumen.

    The mean over the triangles around the source, weighted by their areas.
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
    """Where a polyp's new particle is put by the rule, in r0; see `Division.depth`."""
    start = membrane.vertices[membrane.source]
    return start - depth * parameters.daughter_offset * source_normal(membrane)


@jax.jit
def divide_polyp(
    particles: Particles,
    membrane: Membrane,
    slot: Int[Array, ""],
    depth: Float[Array, ""],
    parameters: Parameters,
) -> Particles:
    """The source vertex emits a tumour particle: x = x_source - δ n.

    It is put a little inside the tissue, "to ensure that it will never fall outside
    the endometrium"; relaxation pushes it further in. Of several at once the second is
    at 2δ, the third at 3δ. See `choose_polyp`.
    """
    return _born(particles, slot, daughter_of_source(membrane, depth, parameters))


@jax.jit
def divide_polyp_to(
    particles: Particles,
    membrane: Membrane,
    slot: Int[Array, ""],
    offset: Float[Array, "3"],
) -> Particles:
    """The source vertex emits a tumour particle elsewhere: x = x_source + offset."""
    return _born(particles, slot, membrane.vertices[membrane.source] + offset)


@jax.jit
def divide_myoma(
    particles: Particles,
    parent: Int[Array, ""],
    slot: Int[Array, ""],
    offset: Float[Array, "3"],
) -> Particles:
    """A tumour particle becomes two, at x + offset (the new one) and x - offset."""
    centre = particles.position[parent]
    moved = particles.at(particles.position.at[parent].set(centre - offset))
    return _born(moved, slot, centre + offset)


def choose_polyp(
    surface: Surface, slot: int, place: Float[np.ndarray, "3"], depth: int = 1
) -> Division | None:
    """The division of a source, checked: the daughter must be inside the tissue.

    Under a needle of a surface the rule's normal may lead out of it. Then the daughter
    goes where it is deepest at the same distance, or at a half or a quarter of it.

    Args:
        surface: with the source.
        slot: of the new particle.
        place: by the rule, x_source - δ n.
        depth: how many times δ it is there.

    Returns:
        The choice; None if every way leads out.
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
"""Directions that are tried, spread evenly over the sphere (a Fibonacci lattice)."""


def choose_myoma(
    tumour: Int[np.ndarray, " t"],
    slot: int,
    clearance: Float[np.ndarray, " t"],
    rng: np.random.Generator,
) -> Division:
    """Draw the particle that divides and the direction, both uniform.

    The two move apart by r0/2 each. A particle near the membrane moves by 0.4 of its
    distance to it at most: both halves stay on their side, which the paper's rule
    alone does not ensure.

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


def _born(
    particles: Particles, slot: Int[Array, ""], position: Float[Array, "3"]
) -> Particles:
    """The particles with a new tumour particle in a free slot."""
    return Particles(
        position=particles.position.at[slot].set(position),
        species=particles.species.at[slot].set(int(Species.TUMOUR)),
        alive=particles.alive.at[slot].set(True),
        held=particles.held.at[slot].set(False),
    )
