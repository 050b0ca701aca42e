"""From a scene to the start of a growth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.growth.initial_state import (
    find_organ,
    make_initial_state,
)
from jaxgrow.growth.setup import Setup
from jaxgrow.lesions.division import SPARE
from jaxgrow.lesions.myoma import Myoma
from jaxgrow.lesions.polyp import check_lift, Polyp
from jaxgrow.mesh.winding import particles_outside
from jaxgrow.organ import merge
from jaxgrow.organ.tissue import HOLD
from jaxgrow.runtime.entries import SceneError
from jaxgrow.runtime.results import Result
from jaxgrow.scene.scene import Scene, Surroundings
from jaxgrow.state import Species
from jaxgrow.transfer.device import get, get_particles, get_surface


def start(lesion, seed=0):
    """A start of the same extent for either lesion, so that they share programs."""
    scene = Scene(lesion=lesion, surroundings=Surroundings(radius=6.5, thickness=3.0))
    return plant(scene, seed=seed)


def plant(scene, tolerance=1e-3, seed=0):
    setup = Setup(scene, scene.parameters, tolerance)
    return make_initial_state(setup, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def polyp():
    return start(Polyp(divisions=3))


@pytest.fixture(scope="module")
def myoma():
    return start(Myoma(divisions=3, depth_mm=1.5))


def test_tissue_is_relaxed_before_the_first_division(polyp):
    assert polyp.outcome.result is Result.CONVERGED
    assert polyp.outcome.stats.residual <= 1e-3


def test_all_tissue_is_on_its_side_of_the_organ(polyp):
    ground = polyp.ground
    surface = get_surface(polyp.state.membrane)
    vertices = ground.patch.to_mm(surface.vertices)
    merged = merge(
        ground.organ,
        ground.patch,
        vertices,
        surface.faces,
        polyp.growth_state().organ_index,
    )
    position, _ = get_particles(polyp.state.particles)
    outside = particles_outside(
        merged.vertices,
        merged.faces,
        ground.patch.to_mm(position),
        ground.organ.tissue,
    )
    assert not outside.any()


def test_polyp_starts_without_tumour_and_with_a_source_at_the_site(polyp):
    _, species = get_particles(polyp.state.particles)
    assert np.all(species == Species.TISSUE)
    membrane = polyp.state.membrane
    source = int(membrane.source)
    distance = np.linalg.norm(get(membrane.vertices), axis=1)
    assert not get(membrane.pinned)[source]
    assert distance[source] < 1.2


def test_myoma_starts_with_one_free_tumour_particle_at_its_depth(myoma):
    position, species = get_particles(myoma.state.particles)
    (first,) = np.flatnonzero(species == Species.TUMOUR)
    assert not get(myoma.state.particles.held)[first]
    depth = -position[first] @ get(myoma.state.frame.axis)
    assert depth == pytest.approx(1.5, abs=0.8)
    assert int(myoma.state.membrane.source) == -1


def test_some_tissue_is_held_and_some_is_free(polyp):
    particles = polyp.state.particles
    alive = get(particles.alive)
    held = get(particles.held)[alive]
    assert HOLD > 0
    assert 0.1 < held.mean() < 0.9


def test_rim_vertices_are_those_of_the_organ_to_the_bit(polyp):
    surface, organ = get_surface(polyp.state.membrane), polyp.ground.organ
    mapped = polyp.growth_state().organ_index >= 0
    assert np.all(mapped[surface.fixed])
    patch = polyp.ground.patch
    wanted = organ.vertices[polyp.growth_state().organ_index[surface.fixed]]
    np.testing.assert_allclose(
        patch.to_mm(surface.vertices[surface.fixed]), wanted, atol=1e-12
    )


def test_frame_is_that_of_the_site(polyp):
    frame, site = polyp.state.frame, polyp.ground.site
    np.testing.assert_array_equal(frame.origin, site.point)
    np.testing.assert_array_equal(frame.axis, site.normal)
    assert float(frame.particle_mm) == 1.0


def test_springs_start_at_rest(polyp):
    membrane = polyp.state.membrane
    alive = get(membrane.edge_alive)
    first, second = get(membrane.vertices)[get(membrane.edges)[alive].T]
    np.testing.assert_allclose(
        get(membrane.rest_length)[alive],
        np.linalg.norm(first - second, axis=1),
        rtol=1e-14,
    )


def test_same_generator_plants_the_same(polyp):
    again = start(Polyp(divisions=3))
    np.testing.assert_array_equal(
        again.state.particles.position, polyp.state.particles.position
    )


def test_free_cluster_starts_with_one_particle_and_room_for_all():
    scene = Scene(organ=None, lesion=Myoma(divisions=7))
    planted = plant(scene)
    particles = planted.state.particles
    assert particles.position.shape == (8, 3)
    assert get(particles.alive).sum() == 1
    assert particles.species[0] == Species.TUMOUR
    assert planted.state.membrane is None
    assert planted.ground is None
    assert planted.outcome is None


def test_depth_of_a_myoma_is_a_quarter_of_its_size_unless_given():
    assert Myoma(size_mm=8.0, particle_mm=2.0).depth == 1.0
    assert Myoma(size_mm=8.0, depth_mm=5.0, particle_mm=2.0).depth == 2.5
    assert Myoma(divisions=5).depth == 2.0


def test_organ_given_as_an_object_is_used_as_it_is(polyp):
    organ = polyp.ground.organ
    assert find_organ(Scene(organ=organ, lesion=Polyp(divisions=1))) is organ
    assert find_organ(Scene(organ=None, lesion=Myoma(divisions=1))) is None


def test_growth_state_holds_no_padding_at_the_site(polyp):
    particles = polyp.state.particles
    dead = ~get(particles.alive)
    assert dead.any()
    distance = jnp.linalg.norm(particles.position, axis=1)
    assert get(distance)[dead].min() > 1e3
    assert jax.tree.leaves(particles)[0].dtype == jnp.float64


def test_tissue_that_lifts_the_surface_by_itself_is_refused():
    scene = Scene(
        lesion=Polyp(size_mm=8.0, particle_mm=1.5),
        surroundings=Surroundings(radius=4.0, density=8.0),
    )
    with pytest.raises(SceneError, match=r"density 8 .* lifts the surface by .* r0"):
        plant(scene, tolerance=1e-1)


def test_tissue_of_a_myoma_may_lift_the_surface():
    """Its size is that of its body; the very tissue that is refused of a polyp."""
    scene = Scene(
        lesion=Myoma(size_mm=8.0, particle_mm=1.5, depth_mm=2.0),
        surroundings=Surroundings(radius=4.0, thickness=3.5, density=8.0),
    )
    planted = plant(scene, tolerance=1e-1)
    assert planted.outcome.result.success
    with pytest.raises(SceneError):
        check_lift(planted.state, 8.0)


def test_capacity_is_rounded_so_that_other_scenes_use_the_same_programs(polyp):
    assert polyp.state.particles.position.shape[0] % SPARE == 0
