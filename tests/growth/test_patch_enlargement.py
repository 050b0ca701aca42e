"""A larger patch under a running growth."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.equilibrium.relax import relax
from jaxgrow.growth.grow import grow
from jaxgrow.growth.patch_enlargement import enlarge_ground, put_enlarged
from jaxgrow.lesions.polyp import Polyp
from jaxgrow.mesh.audit import audit_surface
from jaxgrow.mesh.winding import particles_outside
from jaxgrow.organ import merge, OrganError
from jaxgrow.runtime.results import Result
from jaxgrow.scene.scene import Scene
from jaxgrow.state import Species
from jaxgrow.transfer.device import get, get_particles, get_surface, reset_springs


@pytest.fixture(scope="module")
def growth(tiny_polyp):
    return tiny_polyp


def enlarge(growth, seed=0, **changes):
    given = {"radius": 8.5, "thickness": growth.ground.thickness, **changes}
    return enlarge_ground(
        given.pop("state", growth.state),
        growth.ground,
        growth.organ_index,
        meeting_distance=30.0,
        surroundings=growth.scene.surroundings,
        contact_range=float(growth.scene.parameters.contact_range),
        rng=np.random.default_rng(seed),
        **given,
    )


@pytest.fixture(scope="module")
def enlarged(growth):
    return enlarge(growth)


def whole(enlarged, membrane):
    patch, surface = enlarged.ground.patch, get_surface(membrane)
    vertices = patch.to_mm(surface.vertices)
    organ = enlarged.ground.organ
    return merge(organ, patch, vertices, surface.faces, enlarged.organ_index)


def outside(enlarged, particles, membrane):
    """Particles that are not in the organ's tissue."""
    merged = whole(enlarged, membrane)
    position, _ = get_particles(particles)
    return particles_outside(
        merged.vertices,
        merged.faces,
        enlarged.ground.patch.to_mm(position),
        enlarged.ground.organ.tissue,
    )


def test_particles_stay_first_in_order_and_place(growth, enlarged):
    before, kinds = get_particles(growth.state.particles)
    after, species = get_particles(enlarged.state.particles)
    count = len(before)
    np.testing.assert_array_equal(after[:count], before)
    np.testing.assert_array_equal(species[:count], kinds)
    assert (kinds == Species.TUMOUR).any()
    assert len(after) > count
    assert np.all(species[count:] == Species.TISSUE)


def test_living_slots_stay_in_front_with_as_much_room_behind(growth, enlarged):
    before, after = growth.state.particles, enlarged.state.particles
    alive = get(after.alive)
    assert alive[: alive.sum()].all()
    assert (~alive).sum() == (~get(before.alive)).sum()
    distance = np.linalg.norm(get(after.position), axis=1)
    assert distance[alive].max() < 20
    assert distance[~alive].min(initial=np.inf) > 1e3
    assert not get(after.held)[~alive].any()


def test_membrane_stays_first_in_order_and_place(growth, enlarged):
    before, after = (get_surface(g.state.membrane) for g in (growth, enlarged))
    count = len(before.vertices)
    np.testing.assert_array_equal(after.vertices[:count], before.vertices)
    np.testing.assert_array_equal(after.faces[: len(before.faces)], before.faces)
    np.testing.assert_array_equal(enlarged.organ_index[:count], growth.organ_index)
    assert len(enlarged.organ_index) == len(after.vertices)
    assert after.source == before.source
    assert not after.fixed[:count].any()


def test_springs_are_at_rest(enlarged):
    membrane = enlarged.state.membrane
    np.testing.assert_array_equal(
        get(membrane.rest_length), get(reset_springs(membrane).rest_length)
    )
    alive = get(membrane.edge_alive)
    assert get(membrane.rest_length)[alive].min() > 0


def test_former_surface_is_the_new_patch(growth, enlarged):
    former, patch = enlarged.state.frame.former, enlarged.ground.patch
    np.testing.assert_array_equal(former.vertices, patch.vertices)
    np.testing.assert_array_equal(former.faces, patch.faces)
    before, after = growth.state.frame, enlarged.state.frame
    assert former.faces.shape[0] > before.former.faces.shape[0]
    np.testing.assert_array_equal(after.origin, before.origin)
    np.testing.assert_array_equal(after.axis, before.axis)


def test_ground_is_the_larger_one(growth, enlarged):
    before, after = growth.ground, enlarged.ground
    assert (after.radius, after.thickness) == (8.5, before.thickness)
    assert after.organ is before.organ
    # no triangle is both simulated and a wall
    names = set(map(frozenset, after.walls.names[after.walls.faces].tolist()))
    inside = after.organ.faces[after.patch.face_mask]
    assert names
    assert not names & set(map(frozenset, inside.tolist()))


def test_ground_keeps_its_radius_where_only_the_layer_is_thickened(growth):
    thicker = enlarge(growth, radius=1.0, thickness=growth.ground.thickness + 1.5)
    assert thicker.ground.radius == growth.ground.radius
    assert thicker.ground.thickness == growth.ground.thickness + 1.5


def test_tumour_is_never_held(growth):
    particles = growth.state.particles
    everyone = eqx.tree_at(lambda p: p.held, particles, particles.alive)
    state = eqx.tree_at(lambda s: s.particles, growth.state, everyone)
    after = enlarge(growth, state=state, radius=1.0).state.particles
    tumour = get(after.alive) & (get(after.species) == Species.TUMOUR)
    assert tumour.sum() == 3
    assert not get(after.held)[tumour].any()
    assert get(after.held).any()


def test_tumour_at_the_side_of_the_layer_is_not_held(growth):
    # one that strayed to the place of a particle that stays held
    particles = growth.state.particles
    thicker = {"radius": 1.0}
    held = enlarge(growth, **thicker).enlargement.held
    slot = int(np.flatnonzero(held)[0])
    strayed = eqx.tree_at(
        lambda p: p.species, particles, particles.species.at[slot].set(1)
    )
    state = eqx.tree_at(lambda s: s.particles, growth.state, strayed)
    after = enlarge(growth, state=state, **thicker)
    assert after.enlargement.held[slot]
    assert not get(after.state.particles.held)[slot]


def test_same_generator_enlarges_alike(growth, enlarged):
    again = enlarge(growth)
    np.testing.assert_array_equal(
        again.state.particles.position, enlarged.state.particles.position
    )
    other = enlarge(growth, seed=1)
    assert not np.array_equal(
        other.enlargement.tissue.points, enlarged.enlargement.tissue.points
    )


def test_enlargement_can_be_replayed(growth, enlarged):
    again = put_enlarged(growth.state, enlarged.enlargement)
    for one, other in zip(
        jax.tree.leaves(again), jax.tree.leaves(enlarged.state), strict=True
    ):
        np.testing.assert_array_equal(one, other)


def test_derivatives_of_what_has_grown_pass_through(growth, enlarged):
    state = growth.state

    def moved(shift):
        start = eqx.tree_at(
            lambda s: (s.particles.position, s.membrane.vertices),
            state,
            (state.particles.position + shift, state.membrane.vertices + shift),
        )
        after = put_enlarged(start, enlarged.enlargement)
        return after.particles.position, after.membrane.vertices

    _, tangents = jax.jvp(moved, (jnp.asarray(0.0),), (jnp.asarray(1.0),))
    grown = get(state.particles.alive).sum(), get(state.membrane.vertex_alive).sum()
    now = enlarged.state
    alive = get(now.particles.alive).sum(), get(now.membrane.vertex_alive).sum()
    for tangent, old, new in zip(tangents, grown, alive, strict=True):
        np.testing.assert_array_equal(tangent[:old], 1.0)
        np.testing.assert_array_equal(tangent[old:new], 0.0)


def check_sound_and_relaxing(growth, enlarged):
    found = whole(enlarged, enlarged.state.membrane)
    assert audit_surface(found.vertices, found.faces).clean
    state = enlarged.state
    assert not outside(enlarged, state.particles, state.membrane).any()
    outcome = relax(
        state.particles,
        state.membrane,
        parameters=growth.scene.parameters,
        tolerance=1e-2,
    )
    assert outcome.result is Result.CONVERGED
    assert outcome.stats.residual <= 1e-2
    particles, membrane = outcome.state
    found = whole(enlarged, membrane)
    assert audit_surface(found.vertices, found.faces).clean
    assert not outside(enlarged, particles, membrane).any()
    # what has grown adapts to its freedom, it is not thrown about
    moved = get(particles.position) - get(state.particles.position)
    assert np.linalg.norm(moved, axis=1).max() < 1.5


def test_enlarged_growth_is_sound_and_relaxes(growth, enlarged):
    check_sound_and_relaxing(growth, enlarged)


@pytest.mark.slow
def test_longer_growth_is_sound_and_relaxes_on_a_deeper_ground():
    scene = Scene(lesion=Polyp(divisions=15, particle_mm=1.0))
    growth = grow(scene, tolerance=1e-2)
    check_sound_and_relaxing(growth, enlarge(growth, thickness=4.5))


def test_organ_that_has_no_more_to_give_says_so(growth):
    with pytest.raises(OrganError, match=r"takes \d+ % of uterus"):
        enlarge(growth, radius=300.0)


def test_thinner_layer_is_refused(growth):
    with pytest.raises(OrganError, match="cannot become 1 r0 thick"):
        enlarge(growth, thickness=1.0)


def test_ground_given_is_not_changed(growth):
    ground = growth.ground
    copy = replace(ground)
    enlarge(growth)
    assert ground.patch is copy.patch
    assert ground.radius == copy.radius
