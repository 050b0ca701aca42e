"""One iteration: what is mended, and what comes back when it cannot be."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.parameters import as_arrays, Parameters
from jaxgrow.growth import (
    adaptation,
    boundary,
    choices,
    patch_enlargement,
    settling as module,
)
from jaxgrow.growth.choices import Drawn
from jaxgrow.growth.grow import grow
from jaxgrow.growth.initial_state import make_initial_state
from jaxgrow.growth.setup import LEAST_QUALITY, quality_bound, Setup
from jaxgrow.growth.step import grow_step
from jaxgrow.io.audit import audit
from jaxgrow.io.report import make_report
from jaxgrow.lesions import polyp
from jaxgrow.lesions.myoma import Myoma
from jaxgrow.lesions.polyp import Polyp
from jaxgrow.mesh.surface import Remeshing, Surface
from jaxgrow.organ import OrganError
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.timer import Clock
from jaxgrow.scene.scene import Scene, Surroundings
from jaxgrow.state import Species
from jaxgrow.transfer.device import get, get_surface


SMALL = Scene(
    lesion=Polyp(divisions=3, particle_mm=1.5), surroundings=Surroundings(radius=4.0)
)
TOLERANCE = 1e-2


@pytest.fixture(scope="module")
def planted():
    start = make_initial_state(setup_of(SMALL), np.random.default_rng(0))
    return replace(start.growth_state(), least_quality=LEAST_QUALITY)


def setup_of(scene, **parameters):
    return Setup(scene, as_arrays(Parameters(**parameters), jnp.float64), TOLERANCE)


def one(planted, setup=None, count=1):
    drawn = Drawn(np.random.default_rng(1))
    return grow_step(setup or setup_of(SMALL), planted, drawn, Clock(), count)


@pytest.fixture(scope="module")
def usual(planted):
    return one(planted)


def test_usual_iteration_needs_no_mending(usual):
    assert usual.result is Result.CONVERGED
    assert usual.settled.mended == {}
    assert usual.check.place is None


@pytest.mark.parametrize(
    "offset, thickness, wanted", [(0.3, 3.0, 3), (0.1, 3.0, 8), (0.1, 1.05, 1)]
)
def test_particles_born_at_once_stay_in_the_upper_half_of_the_free_layer(
    planted, offset, thickness, wanted
):
    layer = replace(planted.ground, thickness=thickness)
    thin = replace(planted, ground=layer)
    drawn = Drawn(np.random.default_rng(1))
    chosen = drawn.divisions(setup_of(SMALL, daughter_offset=offset), thin, 8)
    assert [division.depth for division in chosen] == list(range(1, wanted + 1))


@pytest.mark.parametrize("places, depths", [(8, [1, 2, 3]), (2, [1, 2]), (0, None)])
def test_daughters_that_have_a_place_are_born_without_the_others(
    planted, monkeypatch, places, depths
):
    real = polyp.choose_polyp

    def choose(surface, slot, place, depth):
        return real(surface, slot, place, depth) if depth <= places else None

    monkeypatch.setattr(polyp, "choose_polyp", choose)
    parameters, rng = Parameters(), np.random.default_rng(1)
    found = SMALL.lesion.choose(planted.state, parameters, rng, 3)
    assert (found and [division.depth for division in found]) == depths


def test_failed_iteration_has_its_choices_and_its_equilibrium(planted, monkeypatch):
    found = one(replace(planted, least_quality=1.0))
    assert found.result is Result.SLIVER
    assert found.event is not None
    assert found.settled is not None
    monkeypatch.setattr(polyp, "choose_polyp", lambda *_: None)
    nowhere = one(planted)
    assert nowhere.result is Result.ON_MEMBRANE
    assert nowhere.event is None
    assert nowhere.settled is None


def inside_out(surface):
    """The surface with one vertex pulled through the opposite side of its patch."""
    vertices = surface.vertices.copy()
    free = np.flatnonzero(~surface.fixed)
    far = np.linalg.norm(vertices[free] - vertices[free[0]], axis=1).argmax()
    vertices[free[0]] = vertices[free[far]] + 0.3
    return Surface(vertices, surface.faces, surface.fixed, surface.source)


def test_fairing_that_would_intersect_is_rejected(planted, usual, monkeypatch):
    def bad(surface, *rest, **more):
        return inside_out(surface), Remeshing.unchanged(surface)

    monkeypatch.setattr(module, "fair", bad)
    found = one(planted)
    assert found.result is Result.CONVERGED
    assert found.settled.mended == {"fairing_rejected": 1}
    before = get_surface(found.settled.found.state.membrane)
    after = get_surface(found.now.state.membrane)
    np.testing.assert_array_equal(after.vertices, before.vertices)
    np.testing.assert_array_equal(after.faces, before.faces)
    # the springs are reset all the same
    membrane = found.now.state.membrane
    alive = get(membrane.edge_alive)
    start, end = get(membrane.vertices)[get(membrane.edges)[alive].T]
    np.testing.assert_allclose(
        get(membrane.rest_length)[alive], np.linalg.norm(end - start, axis=1)
    )


def test_fairing_that_would_sweep_over_a_particle_is_rejected(planted, monkeypatch):
    def bad(surface, particles, **more):
        free = np.flatnonzero(~surface.fixed)
        nearest = np.linalg.norm(surface.vertices[free, None] - particles[None], axis=2)
        index = np.unravel_index(nearest.argmin(), nearest.shape)
        vertices = surface.vertices.copy()
        vertices[free[index[0]]] += 1.05 * (
            particles[index[1]] - vertices[free[index[0]]]
        )
        new = Surface(vertices, surface.faces, surface.fixed, surface.source)
        return new, Remeshing.unchanged(surface)

    monkeypatch.setattr(module, "fair", bad)
    assert one(planted).settled.mended == {"fairing_rejected": 1}


def test_equilibrium_that_intersects_is_no_step(planted, monkeypatch):
    real = module.equilibrate
    seen = []

    def always(*args):
        return True

    def through_itself(setup, now, *, colliding):
        seen.append(colliding)
        found = real(setup, now, colliding=colliding)
        monkeypatch.setattr(module, "_intersects", always)
        return found

    monkeypatch.setattr(module, "equilibrate", through_itself)
    found = one(planted)
    assert found.result is Result.INTERSECTION
    assert found.now is planted
    # it was tried again with the energy of collisions
    assert seen == [False, True]


def test_surface_with_a_triangle_of_too_little_quality_is_no_step(planted, usual):
    quality = usual.settled.quality
    assert LEAST_QUALITY < quality < 1
    found = one(replace(planted, least_quality=1.01 * quality))
    assert found.result is Result.SLIVER
    assert found.now.state is planted.state
    assert one(replace(planted, least_quality=0.99 * quality)).result.success


def test_slivers_of_the_organ_lower_what_is_asked_for(planted):
    assert quality_bound(planted.state) == LEAST_QUALITY
    membrane = planted.state.membrane
    a, b, c = get(membrane.faces)[0]
    corners = get(membrane.vertices)[[a, b]]
    flat = membrane.vertices.at[c].set(corners.mean(axis=0) + 1e-4)
    worse = eqx.tree_at(lambda s: s.membrane.vertices, planted.state, flat)
    assert 0 < quality_bound(worse) < 1e-4


def test_collisions_join_as_soon_as_sheets_come_near(planted, usual, monkeypatch):
    def near(*args):
        return 0.1

    monkeypatch.setattr(adaptation.CollisionFinder, "gap", near)
    found = one(planted)
    assert found.result is Result.CONVERGED
    assert found.settled.mended == {"collisions_joined": 1}
    assert found.now.colliding
    # there was nothing to collide with: the same equilibrium
    np.testing.assert_allclose(
        get(found.now.state.particles.position),
        get(usual.now.state.particles.position),
        atol=0.2,
    )


NARROW = Scene(
    lesion=Myoma(divisions=4, depth_mm=1.5, site="posterior", particle_mm=1.5),
    surroundings=Surroundings(radius=3.5, thickness=3.2),
)


@pytest.fixture(scope="module")
def sensitive():
    """A border that feels what otherwise counts as rearrangements of tissue."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(boundary, "FORCE_CHANGE_LIMIT", 1e-3)
        patch.setattr(boundary, "SHARE", 0.0)
        patch.setattr(choices, "ENLARGEMENTS", 1)
        yield


@pytest.fixture(scope="module")
def enlarged(sensitive):
    return grow(NARROW, tolerance=TOLERANCE)


def test_patch_that_feels_the_lesion_is_enlarged(enlarged):
    assert enlarged.result is Result.REACHED
    widened = [r for r in enlarged.history if r.mended.get("patch_enlarged")]
    assert len(widened) == 1
    after = enlarged.history[widened[0].division :]
    assert all(r.particles > widened[0].particles for r in after)
    ground = enlarged.ground
    assert (ground.radius, ground.thickness) > (3.5, 3.2)
    assert audit(enlarged).clean


def test_what_was_mended_is_counted_and_reported(enlarged):
    count = sum(r.mended.get("patch_enlarged", 0) for r in enlarged.history)
    assert count > 0
    assert enlarged.mended["patch_enlarged"] == count
    assert make_report(enlarged, None)["outcome"]["mended"] == enlarged.mended


def test_tumour_is_never_held_after_an_enlargement(enlarged):
    particles = enlarged.state.particles
    tumour = get(particles.alive) & (get(particles.species) == Species.TUMOUR)
    assert tumour.sum() == 5
    assert not get(particles.held)[tumour].any()


def test_patch_that_cannot_be_enlarged_ends_the_growth(
    monkeypatch, sensitive, enlarged
):
    def nothing_left(*args, **more):
        raise OrganError("the organ has no more surface.")

    monkeypatch.setattr(patch_enlargement, "enlarge_ground", nothing_left)
    ended = grow(NARROW, tolerance=TOLERANCE)
    assert ended.result is Result.PATCH_TOO_SMALL
    assert audit(ended).clean


def test_growth_without_collisions_never_looks_for_them(monkeypatch, planted):
    off = Scene(
        lesion=SMALL.lesion, surroundings=Surroundings(radius=4.0, collisions="off")
    )

    def never(*args, **more):
        raise AssertionError

    monkeypatch.setattr(adaptation.CollisionFinder, "of", never)
    found = one(planted, setup_of(off))
    assert found.result is Result.CONVERGED
