"""Growth: free clusters keep their density, and a polyp changes only its patch."""

import inspect
import json
from dataclasses import replace

import jax
import numpy as np
import pytest

import jaxgrow as jg
from jaxgrow.equilibrium.refresh_lists import stale
from jaxgrow.growth.adaptation import equilibrate
from jaxgrow.growth.grow import grow
from jaxgrow.growth.initial_state import make_free_cluster
from jaxgrow.growth.setup import Setup
from jaxgrow.growth.step import divide
from jaxgrow.io.audit import audit
from jaxgrow.lesions.myoma import Myoma
from jaxgrow.lesions.polyp import Polyp
from jaxgrow.lesions.size import height_above
from jaxgrow.mesh.audit import audit_surface
from jaxgrow.runtime.results import Result
from jaxgrow.scene.scene import Scene
from jaxgrow.transfer.device import get, get_particles

from .free_clusters import arrays, CLUSTER, free, nearest


# free clusters


def clusters(adhesion, tolerance, sizes, seed=0):
    """Positions at each size of one growth by the steps of `grow`, all converged."""
    parameters, rng = arrays(adhesion), np.random.default_rng(seed)
    setup, lesion = Setup(CLUSTER, parameters, tolerance), CLUSTER.lesion
    now, found = make_free_cluster(CLUSTER).growth_state(), {}
    for size in range(2, max(sizes) + 1):
        divisions = lesion.choose(now.state, parameters, rng, 1)
        divided = divide(lesion, now.state, divisions, parameters)
        made = equilibrate(setup, replace(now, state=divided), colliding=False)
        now = replace(now, state=made.state, lists=stale(made.relaxation.lists))
        assert made.result is Result.CONVERGED
        assert made.relaxation.stats.residual <= tolerance
        if size in sizes:
            found[size] = get_particles(now.state.particles)[0]
    return found


def gyration(position):
    return np.sqrt(np.sum((position - position.mean(axis=0)) ** 2, axis=1).mean())


def exponent(found):
    """Slope of log R_g over log N."""
    size = np.log(list(found))
    radius = np.log([gyration(position) for position in found.values()])
    return np.polyfit(size, radius, 1)[0]


@pytest.fixture(scope="module")
def stable():
    return clusters(0.2, 1e-3, [25, 50, 100])


def test_cluster_at_the_default_adhesion_grows_as_the_cube_root(stable):
    assert 0.30 < exponent(stable) < 0.37
    assert gyration(stable[100]) > 1.8


def test_cluster_at_the_default_adhesion_keeps_its_particles_apart(stable):
    assert nearest(stable[100]).min() > 0.75
    assert np.median(nearest(stable[100])) > 0.9


def test_cluster_at_the_default_adhesion_stays_together(stable):
    assert nearest(stable[100]).max() < 1.5


@pytest.mark.slow
def test_cluster_at_the_printed_adhesion_collapses():
    found = clusters(1.0, 1e-2, [25, 60])
    # twice as many particles and more, in hardly more room
    assert exponent(found) < 0.2
    assert gyration(found[60]) < 1.1
    assert nearest(found[60]).min() < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_cluster_of_300_grows_as_the_cube_root(seed):
    found = clusters(0.2, 1e-3, [50, 100, 200, 300], seed)
    assert 0.31 < exponent(found) < 0.36
    assert nearest(found[300]).min() > 0.7


@pytest.mark.slow
def test_cluster_of_200_at_the_printed_adhesion_has_the_size_of_100():
    found = clusters(1.0, 1e-2, [100, 200])
    assert exponent(found) < 0.12
    for position in found.values():
        assert gyration(position) == pytest.approx(1.0, abs=0.15)
        assert nearest(position).min() < 0.5
        assert np.median(nearest(position)) < 0.5


def test_steps_of_the_loop_are_those_of_grow(thirty):
    wanted = clusters(0.2, 1e-3, [30])[30]
    np.testing.assert_array_equal(get_particles(thirty.state.particles)[0], wanted)


def test_same_seed_gives_the_same_bits(thirty):
    again = free()
    np.testing.assert_array_equal(
        again.state.particles.position, thirty.state.particles.position
    )
    divisions = [event.divisions for event in thirty.events]
    assert [event.divisions for event in again.events] == divisions


def test_another_seed_gives_another_growth(thirty):
    other = free(seed=1)
    gap = other.state.particles.position - thirty.state.particles.position
    assert np.abs(gap).max() > 0.1


def test_every_division_has_a_record_with_a_residual_within_tolerance(thirty):
    assert [r.division for r in thirty.history] == list(range(1, 30))
    assert all(r.result == "CONVERGED" for r in thirty.history)
    assert all(r.residual <= thirty.tolerance for r in thirty.history)
    assert [r.particles for r in thirty.history] == list(range(2, 31))
    assert len(thirty.events) == 29


def test_several_divisions_share_an_equilibrium():
    # nobody divides twice in a step, so at first there are fewer than four
    lesion = Myoma(divisions=10, particle_mm=1.0, divisions_per_step=4)
    growth = grow(Scene(organ=None, lesion=lesion))
    assert [r.division for r in growth.history] == [1, 3, 7, 10]
    assert [r.particles for r in growth.history] == [2, 4, 8, 11]
    assert growth.events.divisions == 10
    for event in growth.events:
        parents = [division.parent for division in event.divisions]
        assert len(set(parents)) == len(parents)
    slots = [d.slot for event in growth.events for d in event.divisions]
    assert slots == list(range(1, 11))


def test_several_divisions_do_not_exceed_the_limit():
    lesion = Myoma(size_mm=50.0, particle_mm=1.0, divisions_per_step=4)
    growth = grow(Scene(organ=None, lesion=lesion), max_divisions=9)
    assert growth.result is Result.DIVISION_LIMIT
    assert growth.events.divisions == 9


def test_division_limit_is_a_result(thirty):
    assert thirty.result is Result.DIVISION_LIMIT
    assert not thirty.result.success


def test_divisions_asked_for_are_made(tiny_cluster):
    assert tiny_cluster.result is Result.REACHED
    assert len(tiny_cluster.history) == 4
    assert get(tiny_cluster.state.particles.alive).sum() == 5


def test_progress_is_told_after_every_division(tiny_cluster):
    seen = []
    again = grow(tiny_cluster.scene, progress=seen.append)
    assert [p.divisions for p in seen] == [1, 2, 3, 4]
    assert seen[-1].target_divisions == 4
    assert seen[-1].target_mm is None
    assert seen[-1].size_mm == again.size_mm
    assert seen[-1].residual == again.history[-1].residual


def test_time_limit_is_a_result():
    ended = free(max_seconds=1e-9)
    assert ended.result is Result.TIME_LIMIT
    assert len(ended.events) == 0
    assert np.isfinite(get_particles(ended.state.particles)[0]).all()


@pytest.mark.parametrize("seconds", [0.0, -1.0, np.nan])
def test_time_limit_that_is_not_positive_is_refused(seconds):
    with pytest.raises(ValueError, match=r"max_seconds is .*; it must be positive"):
        free(max_seconds=seconds)


@pytest.mark.parametrize("name", ["merged", "surface", "mesh"])
def test_free_cluster_has_no_surface(tiny_cluster, name):
    with pytest.raises(ValueError, match="grew without an organ"):
        getattr(tiny_cluster, name)()


# in an organ


def test_everything_outside_of_the_patch_is_bit_identical(tiny_polyp):
    organ, patch = tiny_polyp.organ, tiny_polyp.ground.patch
    vertices, _, _ = tiny_polyp.surface()
    outside = np.setdiff1d(np.arange(len(organ.vertices)), patch.organ_index)
    kept = {tuple(row) for row in vertices}
    assert len(outside) > 100
    assert {tuple(row) for row in organ.vertices[outside]} <= kept


def test_rim_is_bit_identical(tiny_polyp):
    patch = tiny_polyp.ground.patch
    vertices, _, _ = tiny_polyp.surface()
    kept = {tuple(row) for row in vertices}
    rim = tiny_polyp.organ.vertices[patch.organ_index[patch.rim]]
    assert len(rim) > 10
    assert {tuple(row) for row in rim} <= kept


def test_rim_of_the_membrane_has_not_moved_by_a_bit(tiny_polyp):
    membrane, patch = tiny_polyp.state.membrane, tiny_polyp.ground.patch
    pinned = get(membrane.vertices)[get(membrane.pinned)]
    start = {tuple(row) for row in patch.vertices[patch.rim]}
    assert start <= {tuple(row) for row in pinned}


def test_euler_number_is_kept(tiny_polyp):
    organ = tiny_polyp.organ
    vertices, faces, _ = tiny_polyp.surface()
    before = audit_surface(organ.vertices, organ.faces)
    after = audit_surface(vertices, faces)
    assert after.euler_number == before.euler_number
    assert after.components == 1


def test_every_division_of_a_polyp_converges(tiny_polyp):
    assert tiny_polyp.result is Result.REACHED
    assert [r.result for r in tiny_polyp.history] == ["CONVERGED"] * 3
    assert all(r.residual <= tiny_polyp.tolerance for r in tiny_polyp.history)
    assert [r.tumour for r in tiny_polyp.history] == [1, 2, 3]


def test_labels_are_near_the_lesion_only(tiny_polyp):
    vertices, _, label = tiny_polyp.surface()
    far = np.linalg.norm(vertices - tiny_polyp.site.point, axis=1)
    reach = 3 * tiny_polyp.scene.r0_mm
    assert 1 <= label.sum() < 60
    assert far[label == 1].max() < reach
    assert set(np.unique(label)) == {0, 1}


def test_source_is_the_same_vertex_through_every_remeshing():
    printed = Polyp(divisions=3, focus_mm=0.0, divisions_per_step=1)
    growth = grow(Scene(lesion=printed))
    source = growth.events[0].remeshing.source
    for event in growth.events[1:]:
        assert event.remeshing.origin()[event.remeshing.source] == source
        source = event.remeshing.source
    membrane = growth.state.membrane
    assert int(membrane.source) == source
    assert get(membrane.vertex_alive)[source]
    assert not get(membrane.pinned)[source]


@pytest.mark.slow
def test_source_is_at_the_tip_of_a_polyp():
    growth = grow(Scene(lesion=Polyp(divisions=40)))
    assert growth.result is Result.REACHED
    membrane = growth.state.membrane
    alive = get(membrane.vertex_alive)
    former = growth.state.frame.former
    height = height_above(
        get(membrane.vertices)[alive], get(former.vertices), get(former.faces)
    )
    highest = height.max()
    assert highest > 1.5
    assert height[int(membrane.source)] > highest - 1
    assert audit(growth).clean


def test_mesh_carries_the_labels(tiny_polyp):
    mesh = tiny_polyp.mesh()
    vertices, faces, label = tiny_polyp.surface()
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_array_equal(mesh.vertex_attributes["label"], label)


def test_springs_are_at_rest_after_each_step(tiny_polyp):
    membrane = tiny_polyp.state.membrane
    alive = get(membrane.edge_alive)
    start, end = get(membrane.vertices)[get(membrane.edges)[alive].T]
    np.testing.assert_allclose(
        get(membrane.rest_length)[alive],
        np.linalg.norm(end - start, axis=1),
        rtol=1e-14,
    )


def test_number_of_compilations_is_reported(tiny_polyp):
    assert tiny_polyp.compilations >= 0
    assert set(tiny_polyp.seconds) >= {"plant", "divide", "adapt", "fair"}


# refusals


def test_tolerance_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match=r"tolerance is 0\.0; it must be a positive"):
        grow(CLUSTER, tolerance=0.0)


def test_growth_in_32_bits_is_refused():
    with jax.enable_x64(False), pytest.raises(ValueError, match="growth needs 64"):
        inspect.unwrap(grow)(CLUSTER)


def test_parameters_by_name_leave_the_others_of_the_kind():
    scene = jg.Scene(organ=None, lesion=jg.Myoma(divisions=4))
    some = jg.grow(scene, parameters={"smoothing": 0.12})
    wanted = {**jg.Myoma.mechanics, "smoothing": 0.12}
    whole = jg.grow(scene, parameters=jg.Parameters(**wanted))
    assert wanted["tumour_stiffness"] != jg.Parameters().tumour_stiffness
    np.testing.assert_array_equal(
        some.state.particles.position, whole.state.particles.position
    )


def test_unknown_parameter_is_refused_by_name():
    scene = jg.Scene(organ=None, lesion=jg.Myoma(divisions=4))
    with pytest.raises(ValueError, match="did you mean spring_stiffness"):
        jg.grow(scene, parameters={"spring_stifness": 0.1})


def test_growth_and_metrics_show_themselves_in_a_line():
    growth = jg.grow(jg.Scene(organ=None, lesion=jg.Myoma(divisions=4)))
    assert repr(growth).startswith("Growth(myoma of 2")
    assert repr(growth).endswith("mm after 4 divisions, seed 0: REACHED)")
    assert repr(growth.state) == "State(5 particles)"
    assert repr(growth.events) == (
        "Events(myoma of 1 mm particles, 4 steps, 4 divisions: REACHED)"
    )
    assert repr(growth.events[0]) == "Event(divisions=1)"
    assert "particles" in repr(jax.eval_shape(lambda: growth.state))
    metrics = jg.shape_metrics(growth.state)
    row = metrics.as_dict()
    assert json.loads(json.dumps(row["tumour_diameter_mm"])) > 1
    assert all(type(value) is float for value in row.values())
    assert f"tumour_diameter_mm={row['tumour_diameter_mm']:.4g}" in repr(metrics)
