"""A larger patch under a running growth, where its border feels the lesion."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
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
from jaxgrow.state import FormerSurface, Frame, Particles, Species, State
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
"""By how much radius or thickness of a patch grow when it is enlarged, in r0."""


class EnlargedPatch(NamedTuple):
    """A growth on a larger patch.

    Attributes:
        state: what there was first, in its order and its place, then what is new; not
            in equilibrium, springs at rest.
        ground: with the larger patch, and the rest of the organ around that.
        organ_index: for each membrane vertex the organ's vertex that it was, or -1.
        enlargement: what was taken in, to replay it.
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
    """Take more of the organ into a growth whose patch is too small.

    See `jaxgrow.organ.enlarge`. Relax the result before the next division, with new
    lists, as particles and faces have been added.

    Args:
        state: of the growth, with a membrane.
        ground: it stands on.
        organ_index: of its membrane.
        radius: of the new patch, in r0; it grows by a row of triangles at least.
        thickness: of the new layer of tissue, in r0.
        meeting_distance: distance from the site, in r0, up to which the lesion may meet
            the rest of the organ.
        surroundings: density of the tissue, and size of the triangles.
        contact_range: distance of new tissue to the membrane, in r0.
        rng: draws the new tissue.

    Raises:
        OrganError: the organ has no more to give, or the state cannot be enlarged.
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
    """Enlarge the patch around the same lesion, and find the equilibrium there.

    Args:
        setup: of the growth.
        now: where it stands.
        place: where its border feels the lesion, in r0: near the axis the layer of
            tissue becomes thicker, elsewhere the patch wider.
        rng: draws the new tissue.
        clock: counts the seconds.

    Returns:
        The state and the record of it, or PATCH_TOO_SMALL if the organ has no more to
        give, or why the wider patch did not come to equilibrium.
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
    """Make a recorded enlargement of the patch again.

    Args:
        setup: of the growth.
        now: where it stands.
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
    """Return the growth on a larger patch, not in equilibrium."""
    return replace(
        now,
        state=wider.state,
        organ_index=wider.organ_index,
        ground=wider.ground,
        lists=None,
        least_quality=min(now.least_quality, quality_bound(wider.state)),
    )


def put_enlarged(state: State, enlargement: Enlargement) -> State:
    """The state with an enlargement in it.

    Positions that there were stay on the device, with their derivatives. There is room
    for as many more particles as before.
    """
    assert state.membrane is not None
    count = int(get(state.membrane.vertex_alive).sum())
    membrane = put_membrane(enlargement.lining.surface)
    vertices = membrane.vertices.at[:count].set(state.membrane.vertices[:count])
    membrane = eqx.tree_at(lambda m: m.vertices, membrane, vertices)
    patch = enlargement.patch
    former = FormerSurface(put(patch.vertices), put(patch.faces))
    frame = state.frame
    return State(
        _with_tissue(state.particles, enlargement),
        reset_springs(membrane),
        Frame(frame.origin, frame.axis, frame.particle_mm, former),
    )


def _with_tissue(particles: Particles, enlargement: Enlargement) -> Particles:
    """The particles with the new tissue behind them; tumour is never held."""
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
