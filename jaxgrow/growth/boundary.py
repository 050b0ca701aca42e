"""Reaction forces on the boundary of a patch: on rim and held tissue.

A patch is large enough if the lesion does not act on its boundary: if the forces on the
held tissue are about those before growth, if no tumour particle presses on it or on the
rim, and if no particle has left the region under the patch, as the rest of the organ's
surface holds no particle back. (The force on the rim cannot serve as a criterion: the
tension of the springs there changes with every reset.)
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from jaxgrow.equilibrium.relax import Relaxation
from jaxgrow.mesh.collision_mesh import Walls
from jaxgrow.mesh.proximity import nearest_on_mesh
from jaxgrow.mesh.quality import area_vectors, lengths
from jaxgrow.mesh.surface import Surface
from jaxgrow.state import Particles, Species
from jaxgrow.transfer.device import get


FORCE_CHANGE_LIMIT = 0.3
"""Change of the force on a held particle, in F(0), above which a patch is too small.

Rearrangements in random tissue change such forces by 0.1 to 0.17 in every growth.
Under a stiff membrane they are larger from the beginning; there the bound is
`SHARE` of the largest before growth.
"""

SHARE = 0.5
"""Change of the force that is allowed, as a share of the largest before growth."""

CONTACT_DISTANCE = 0.58
"""Distance of a tumour particle to the rim or a held particle, in r0, at which a pair
repels by `FORCE_CHANGE_LIMIT`.

In tissue of the default density neighbours are 0.8 to 0.9 apart.
"""


@dataclass(frozen=True, eq=False)
class BoundaryReaction:
    """Boundary of a patch, with the reaction forces on it.

    Attributes:
        rim: position of the membrane's fixed vertices, in r0.
        held: position of the held particles, by slot, in r0.
        force: on each held particle, in F(0).
    """

    rim: Float[np.ndarray, "r 3"]
    held: Float[np.ndarray, "h 3"]
    force: Float[np.ndarray, "h 3"]


class BoundaryCheck(NamedTuple):
    """Effect of the lesion on the boundary of the patch.

    Attributes:
        force: largest change of the force on a held particle since before growth, in
            F(0).
        distance: of the nearest tumour particle, in r0; infinite without any.
        place: of the largest effect, in r0, if the patch is too small; else None.
        crossed: number of free particles outside the organ, which left it beside the
            patch, where there is no membrane.
    """

    force: float
    distance: float
    place: Float[np.ndarray, "3"] | None
    crossed: int = 0


class EscapedParticles(NamedTuple):
    """Free particles that have left the region under a patch.

    Attributes:
        position: of those that are near the rest of the organ's surface, in r0.
        crossed: number of these that are on its wrong side.
    """

    position: Float[np.ndarray, "b 3"]
    crossed: int = 0


def boundary_reaction(relaxation: Relaxation) -> BoundaryReaction:
    """Extract the boundary and its reaction forces from a relaxation."""
    particles, membrane = relaxation.state
    assert particles is not None
    assert membrane is not None
    assert relaxation.forces.particles is not None
    held = get(particles.alive & particles.held)
    return BoundaryReaction(
        rim=get(membrane.vertices)[get(membrane.pinned & membrane.vertex_alive)],
        held=get(particles.position)[held],
        force=get(relaxation.forces.particles)[held],
    )


def check_reaction(
    border: BoundaryReaction,
    before: BoundaryReaction,
    particles: Particles,
    beside: EscapedParticles,
) -> BoundaryCheck:
    """Compare the reaction forces on a boundary with those before growth.

    Args:
        border: now.
        before: the same boundary before growth.
        particles: now.
        beside: free particles that are beside the patch.
    """
    change = lengths(border.force - before.force)
    bound = max(FORCE_CHANGE_LIMIT, SHARE * lengths(before.force).max(initial=0.0))
    force = float(change.max(initial=0.0))
    position, alive = get(particles.position), get(particles.alive)
    tumour = position[alive & (get(particles.species) == Species.TUMOUR)]
    places = np.concatenate([border.rim, border.held])
    distance = np.full(len(places), np.inf)
    if len(tumour):
        distance, _ = KDTree(tumour).query(places)
    nearest = float(distance.min())
    place = None
    if len(beside.position):
        place = beside.position[0]
    elif force > bound:
        place = border.held[change.argmax()]
    elif nearest < CONTACT_DISTANCE:
        place = places[distance.argmin()]
    return BoundaryCheck(force, nearest, place, beside.crossed)


def find_escaped(
    particles: Particles, surface: Surface, walls: Walls, reach: float
) -> EscapedParticles:
    """Find escaped particles: the free ones that are nearest to a wall.

    The wall is within a given distance of them. Particles under the membrane are nearer
    to it than to any wall behind it.

    Args:
        particles: of the patch.
        surface: its live membrane.
        walls: the rest of the organ.
        reach: distance in r0 at which a particle would touch a membrane.
    """
    nothing = EscapedParticles(np.zeros((0, 3)))
    points = get(particles.position)[get(particles.free)]
    chosen = walls.near(points, reach)
    if not len(chosen):
        return nothing
    faces = walls.faces[chosen]
    corners = walls.vertices[faces]
    centre = corners.mean(axis=1)
    radius = lengths(corners - centre[:, None]).max()
    near, _ = KDTree(centre).query(points)
    points = points[near < radius + reach]
    if not len(points):
        return nothing
    to_wall, face, foot = nearest_on_mesh(points, walls.vertices, faces)
    to_membrane, _, _ = nearest_on_mesh(points, surface.vertices, surface.faces)
    out = (to_wall < reach) & (to_wall < to_membrane)
    normal = area_vectors(walls.vertices[faces[face]])
    above = np.einsum("ni,ni->n", points - foot, normal) >= 0
    # the nearest to a wall first
    order = np.argsort(to_wall[out], kind="stable")
    return EscapedParticles(points[out][order], int(np.count_nonzero(out & above)))
