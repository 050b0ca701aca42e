"""The finished surface: smooth label, regions, ring, cut rim, subdivision."""

import dataclasses

import numpy as np
import pytest
import trimesh

from jaxgrow.io.lesion_surface import lesion_surface, LesionSurface, RefinementError
from jaxgrow.lesions.size import COVERING, height_above, lesion_vertices, RAISED
from jaxgrow.lesions.smooth_label import smooth_label
from jaxgrow.mesh.audit import audit_surface
from jaxgrow.mesh.isoline import polygon_length, trace_isolines
from jaxgrow.mesh.winding import particles_outside
from jaxgrow.organ.regions import find_regions
from jaxgrow.transfer.device import get, get_particles, get_surface

from ..revolved import dome, label_by_height, mushroom


@pytest.fixture(scope="module")
def plain(tiny_polyp):
    return lesion_surface(tiny_polyp)


@pytest.fixture(scope="module")
def cut(tiny_polyp):
    return lesion_surface(tiny_polyp, rim=True)


def _of_a_body(vertices, faces):
    lesion = label_by_height(vertices).astype(np.float32)
    (line,) = trace_isolines(vertices, faces, lesion.astype(float), 0.5)
    found = find_regions(vertices, faces, lesion.astype(float), line.length)
    inside = np.array([[0.0, 0.0, -5.0]])
    return LesionSurface(
        vertices,
        faces,
        lesion,
        found.region,
        line.points,
        1,
        found.neck,
        inside,
        "inside",
    )


def _sound(surface):
    audit = audit_surface(surface.vertices, surface.faces)
    outside = particles_outside(
        surface.vertices, surface.faces, surface.position, surface.tissue
    )
    return audit.clean and audit.euler_number == 2 and not outside.any()


def test_smooth_label_is_at_least_a_half_exactly_on_the_lesion(plain, tiny_polyp):
    _, _, label = tiny_polyp.surface()
    assert label.any()
    assert np.array_equal(plain.label, label)
    assert plain.lesion.dtype == np.float32


def test_smooth_label_is_the_stated_formula(tiny_polyp):
    state = tiny_polyp.state
    surface, former = get_surface(state.membrane), state.frame.former
    height = height_above(surface.vertices, get(former.vertices), get(former.faces))
    position, species = get_particles(state.particles)
    tumour = position[species == 1]
    far = np.linalg.norm(surface.vertices[:, None] - tumour, axis=2).min(axis=1)
    expected = 0.5 + np.maximum(height - RAISED, COVERING - far)
    on = lesion_vertices(state)
    found = smooth_label(state)
    assert np.allclose(found[on], np.clip(expected, 0, 1)[on], atol=1e-6)
    assert (found[~on] <= np.clip(expected, 0, 1)[~on] + 1e-6).all()
    assert ((found > 0) & (found < 1)).any()


def test_smooth_label_is_zero_outside_the_patch(plain, tiny_polyp):
    assert (plain.lesion[tiny_polyp.merged().origin >= 0] < 0.5).mean() > 0.9
    outside = np.ones(len(plain.vertices), dtype=bool)
    outside[tiny_polyp.merged().placed] = False
    assert not plain.lesion[outside].any()


def test_regions_are_healthy_exactly_where_the_label_is(plain, cut):
    for surface in (plain, cut, cut.refine(1)):
        assert np.array_equal(surface.region > 0, surface.label == 1)


def test_the_ring_of_a_dome_is_a_circle():
    surface = _of_a_body(*dome(radius=4.0))
    circle = 2 * np.pi * np.sqrt(4.0**2 - 0.5**2)
    assert polygon_length(surface.ring) == pytest.approx(circle, rel=5e-3)
    assert polygon_length(surface.refine(2).ring) == pytest.approx(circle, rel=2e-2)


def test_figures_of_a_mushroom_are_those_of_its_parts():
    figures = _of_a_body(*mushroom(stalk=1.5, length=8.0)).as_dict()
    assert figures["neck_circumference_mm"] == pytest.approx(2 * np.pi * 1.5, rel=2e-3)
    # the head begins where the ball is half-way between stalk and equator
    start, half = np.sqrt(4.0**2 - 1.5**2), np.sqrt(4.0**2 - 2.75**2)
    stalk = 2 * np.pi * 1.5 * 7.5 + 2 * np.pi * 4.0 * (start - half)
    assert figures["area_mm2"]["stalk"] == pytest.approx(stalk, rel=0.1)
    head = 2 * np.pi * 4.0 * (4.0 + half)
    assert figures["area_mm2"]["head"] == pytest.approx(head, rel=0.1)
    assert figures["rings"] == 1


def test_a_cut_rim_is_a_line_of_edges_with_label_a_half(cut):
    lesion = cut.label[cut.faces].all(axis=1)
    mesh = trimesh.Trimesh(cut.vertices, cut.faces[lesion], process=False)
    border = trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)
    ends = mesh.edges_sorted[border]
    assert (cut.lesion[ends] == 0.5).all()
    points, found = np.unique(cut.vertices[np.unique(ends)], axis=0), cut.ring
    assert np.array_equal(points, np.unique(found, axis=0))
    length = np.linalg.norm(np.diff(cut.vertices[ends], axis=1), axis=2).sum()
    assert polygon_length(cut.ring) == pytest.approx(length, rel=1e-12)


def test_a_cut_rim_leaves_a_sound_surface_and_the_rest_of_the_organ(cut, tiny_polyp):
    assert _sound(cut)
    merged = tiny_polyp.merged()
    outside = np.ones(len(merged.vertices), dtype=bool)
    outside[merged.placed] = False
    old = cut.vertices[: len(outside)]
    assert old[outside].tobytes() == merged.vertices[outside].tobytes()
    figures = cut.as_dict()["rim"]
    assert figures["worst_triangle"] > 0.2
    assert figures["moved_vertices"] == np.count_nonzero(
        (old != merged.vertices).any(axis=1)
    )


@pytest.mark.parametrize("levels", [1, 2])
def test_a_subdivided_lesion_is_sound_smooth_and_in_the_same_organ(
    plain, tiny_polyp, levels
):
    refined = plain.refine(levels)
    assert _sound(refined)
    old = refined.vertices[: len(plain.vertices)]
    outside = np.ones(len(old), dtype=bool)
    outside[tiny_polyp.merged().placed] = False
    assert old[outside].tobytes() == plain.vertices[outside].tobytes()
    assert _steepest(refined) < 0.8 * _steepest(plain)
    figures = refined.as_dict()
    assert figures["levels"] == levels
    moved = np.linalg.norm(old - plain.vertices, axis=1).max()
    assert figures["largest_displacement_mm"] == pytest.approx(moved)
    assert moved < 0.5 * tiny_polyp.scene.r0_mm


def _steepest(surface):
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    on = surface.label[mesh.face_adjacency_edges].all(axis=1)
    return mesh.face_adjacency_angles[on].max()


def test_the_rim_stays_a_line_of_edges_when_subdivided(cut):
    refined = cut.refine(1)
    assert len(refined.ring) == 2 * len(cut.ring)
    mixed = np.ptp(refined.label[refined.faces], axis=1) > 0
    on = refined.lesion[refined.faces[mixed]] == 0.5
    assert on.any(axis=1).all()


def test_regions_keep_their_area_when_subdivided():
    surface = _of_a_body(*mushroom(stalk=1.5, length=8.0))
    before = surface.as_dict()["area_mm2"]
    after = surface.refine(2).as_dict()["area_mm2"]
    for name in ("stalk", "head"):
        assert after[name] == pytest.approx(before[name], rel=0.1)


def test_a_surface_that_would_pass_a_particle_is_not_subdivided():
    surface = _of_a_body(*dome(radius=4.0))
    tip = surface.vertices[-2]
    near = dataclasses.replace(surface, position=(tip * (1 - 1e-4))[None])
    with pytest.raises(RefinementError, match="particles_passed 1"):
        near.refine(1)


def test_a_surface_that_would_meet_itself_is_not_subdivided():
    surface = _of_a_body(*dome(radius=4.0))
    vertices = surface.vertices.copy()
    vertices[-2, 2] = -9.999  # a spike through the body to just above the bottom
    spiked = dataclasses.replace(surface, vertices=vertices, lesion=0 * surface.lesion)
    spiked.lesion[-1] = 1.0  # the bottom rises
    with pytest.raises(RefinementError, match="intersections"):
        spiked.refine(1)


def test_too_many_levels_are_refused(plain):
    with pytest.raises(ValueError, match="ask for 1 to 4"):
        plain.refine(5)


def test_a_free_cluster_has_no_surface(tiny_cluster):
    with pytest.raises(ValueError, match="grew without an organ"):
        lesion_surface(tiny_cluster)


def test_a_trimesh_has_label_and_values(cut):
    mesh = cut.mesh()
    assert mesh.is_watertight
    assert set(mesh.vertex_attributes) == {"label", "lesion", "region"}
