"""Enlargement of the patch during a growth, for reactions on its boundary."""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxgrow.growth.boundary import boundary_reaction
from jaxgrow.growth.events import PatchEnlargement
from jaxgrow.growth.ground import Ground
from jaxgrow.growth.initial_state import meeting_distance
from jaxgrow.growth.settling import FairingResult, settle, settle_again
from jaxgrow.growth.setup import GrowthState, quality_bound, Setup
from jaxgrow.organ import enlarge, Enlargement, Lining, OrganError, walls_around
from jaxgrow.organ.tissue import HOLD
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.timer import Clock
from jaxgrow.scene.scene import Surroundings
from jaxgrow.state import (
    FormerSurface,
    Frame,
    Particles,
    replaced,
    Species,
    State,
)
from jaxgrow.transfer.device import (
    get,
    get_number,
    get_surface,
    put,
    put_membrane,
    reset_springs,
    with_capacity,
)


WIDER, DEEPER = 2.0, 1.0
"""Increase of a patch's radius, or of its thickness, by an enlargement, in r0."""


class EnlargedPatch(NamedTuple):
    """State of a growth on a larger patch.

    Attributes:
        state: the former nodes first, in their order and place, then the new ones; not
            in equilibrium, springs at rest.
        ground: with the larger patch, and the rest of the organ around that.
        organ_index: for each membrane vertex the same vertex of the organ, or -1.
        enlargement: the added parts, for a replay.
    """

    state: State
    ground: Ground
    organ_index: Int[np.ndarray, " m"]
    enlargement: Enlargement


def enlarge_ground(
    state: State,
    ground: Ground,
    organ_index: Int[np.ndarray, " m"],
    *,
    radius: float,
    thickness: float,
    meeting_distance: float,
    surroundings: Surroundings,
    contact_range: float,
    rng: np.random.Generator,
) -> EnlargedPatch:
    """Enlarge the patch of a state by more of the organ's surface and tissue.

    See `jaxgrow.organ.enlarge`. Relax the result before the next division, with new
    lists, as particles and faces have been added.

    Args:
        state: of the growth, with a membrane.
        ground: its surroundings.
        organ_index: of its membrane.
        radius: of the new patch, in r0; it grows by a row of triangles at least.
        thickness: of the new layer of tissue, in r0.
        meeting_distance: distance from the site, in r0, up to which the lesion may
            touch the rest of the organ.
        surroundings: density of the tissue, and size of the triangles.
        contact_range: distance of new tissue to the membrane, in r0.
        rng: draws the new tissue.

    Raises:
        OrganError: the organ has no more surface, or the state cannot be enlarged.
    """
    assert state.membrane is not None
    alive = get(state.particles.alive)
    enlargement = enlarge(
        ground.organ,
        ground.patch,
        Lining(get_surface(state.membrane), organ_index),
        get(state.particles.position)[alive],
        get(state.particles.held)[alive],
        radius=radius,
        thickness=thickness,
        thickness_before=ground.thickness,
        density=surroundings.density,
        max_area=surroundings.max_area,
        min_area=surroundings.min_area,
        gap=contact_range,
        hold=HOLD,
        rng=rng,
    )
    wider = replace(
        ground,
        patch=enlargement.patch,
        walls=walls_around(ground.organ, enlargement.patch, meeting_distance),
        radius=max(radius, ground.radius),
        thickness=thickness,
    )
    return EnlargedPatch(
        put_enlarged(state, enlargement),
        wider,
        enlargement.lining.organ_index,
        enlargement,
    )


def enlarge_patch(
    setup: Setup,
    now: GrowthState,
    place: Float[np.ndarray, "3"],
    rng: np.random.Generator,
    clock: Clock,
) -> tuple[GrowthState, PatchEnlargement] | Result:
    """Enlarge the patch around a lesion, and find the new equilibrium.

    Args:
        setup: of the growth.
        now: its state.
        place: of the reaction on the boundary, in r0: near the axis the layer of tissue
            is thickened, elsewhere the patch is widened.
        rng: draws the new tissue.
        clock: counts the seconds.

    Returns:
        The state and the record of it; or PATCH_TOO_SMALL if the organ has no more
        surface, or the result of the failed search for an equilibrium.
    """
    ground, scene = now.ground, setup.scene
    assert ground is not None
    below = ground.is_below(place)
    radius = ground.radius + (0.0 if below else WIDER)
    try:
        with clock.phase("enlarge"):
            wider = enlarge_ground(
                now.state,
                ground,
                now.organ_index,
                radius=radius,
                thickness=ground.thickness + (DEEPER if below else 0.0),
                meeting_distance=meeting_distance(scene, radius),
                surroundings=scene.surroundings,
                contact_range=get_number(setup.parameters.contact_range),
                rng=rng,
            )
    except OrganError:
        return Result.PATCH_TOO_SMALL
    settled = settle(setup, _placed(now, wider), clock)
    if settled.result is not Result.CONVERGED:
        return settled.result
    border = boundary_reaction(settled.found.relaxation)
    record = PatchEnlargement(wider.ground, wider.enlargement, settled.record)
    return replace(settled.now, border=border), record


def enlarge_again(
    setup: Setup, now: GrowthState, record: PatchEnlargement, clock: Clock
) -> FairingResult:
    """Repeat a recorded enlargement of the patch.

    Args:
        setup: of the growth.
        now: its state.
        record: of the enlargement.
        clock: counts the seconds.
    """
    with clock.phase("enlarge"):
        wider = EnlargedPatch(
            put_enlarged(now.state, record.enlargement),
            record.ground,
            record.enlargement.lining.organ_index,
            record.enlargement,
        )
    return settle_again(setup, _placed(now, wider), record.equilibrium, clock)


def _placed(now: GrowthState, wider: EnlargedPatch) -> GrowthState:
    """Return the state of a growth on a larger patch, not in equilibrium."""
    return replace(
        now,
        state=wider.state,
        organ_index=wider.organ_index,
        ground=wider.ground,
        lists=None,
        least_quality=min(now.least_quality, quality_bound(wider.state)),
    )


def put_enlarged(state: State, enlargement: Enlargement) -> State:
    """Put an enlargement into a state on the device.

    The former positions stay on the device, with their derivatives. The number of free
    slots for particles is the same as before.
    """
    assert state.membrane is not None
    count = int(get(state.membrane.vertex_alive).sum())
    before, new = state.membrane, put_membrane(enlargement.lining.surface)
    everywhere = jnp.all(before.hyperplasia == 1)  # or in a focus only
    marks = jnp.where(everywhere, new.hyperplasia, 0)
    membrane = replaced(
        new,
        vertices=new.vertices.at[:count].set(before.vertices[:count]),
        reference=new.reference.at[:count].set(before.reference[:count]),
        hyperplasia=marks.at[:count].set(before.hyperplasia[:count]),
    )
    patch = enlargement.patch
    former = FormerSurface(put(patch.vertices), put(patch.faces))
    frame = state.frame
    return State(
        _with_tissue(state.particles, enlargement),
        reset_springs(membrane),
        Frame(frame.origin, frame.axis, frame.particle_mm, former),
    )


def _with_tissue(particles: Particles, enlargement: Enlargement) -> Particles:
    """Add the new tissue after the particles; tumour particles are never held."""
    tissue = enlargement.tissue
    first, more = len(enlargement.held), len(tissue.points)
    particles = with_capacity(particles, particles.position.shape[0] + more)
    new = slice(first, first + more)
    free = particles.species[:first] == Species.TUMOUR
    held = particles.held.at[:first].set(put(enlargement.held) & ~free)
    return Particles(
        position=particles.position.at[new].set(put(tissue.points)),
        species=particles.species.at[new].set(int(Species.TISSUE)),
        alive=particles.alive.at[new].set(True),
        held=held.at[new].set(put(tissue.held)),
    )
