import numpy as np
import pytest
import trimesh

from jaxgrow.mesh.quality import radius_ratio, side_lengths
from jaxgrow.organ import locate_site, OrganError, room, uterus as build
from jaxgrow.organ.uterus import (
    _tessellated,
    CANAL_LENGTH_MM,
    cavity,
    CAVITY_LENGTH_MM,
    CAVITY_WIDTH_MM,
    CORNUAL_ANGLE_DEG,
    CORONAL_AREA_MM2,
    DEPTH_MM,
    INDENTATION_MM,
    INTERNAL_OS_MM,
    make,
)
from jaxgrow.organ.validity import check_surface


@pytest.fixture(scope="module")
def mesh(womb):
    return trimesh.Trimesh(womb.vertices, womb.faces, process=False)


@pytest.fixture(scope="module")
def widths(mesh):
    """Height z of horizontal cuts and the widths of the cavity there."""
    heights = np.linspace(-23, 31, 271)
    cuts = [
        mesh.section(plane_origin=[0, 0, z], plane_normal=[0, 0, 1]) for z in heights
    ]
    return heights, np.array([np.ptp(cut.vertices[:, 0]) for cut in cuts])


@pytest.fixture(scope="module")
def internal_os(widths):
    """Height and width where the surface is narrowest between canal and body."""
    heights, width = widths
    between = np.flatnonzero(np.abs(heights) < 8)
    index = between[np.argmin(width[between])]
    return heights[index], width[index]


@pytest.fixture(scope="module")
def horn(mesh):
    """Tip of the left horn, in the coronal plane."""
    tip = mesh.vertices[np.argmax(mesh.vertices[:, 0])]
    return tip[[0, 2]]


def fundus(mesh):
    middle = mesh.vertices[np.hypot(*mesh.vertices[:, :2].T) < 1.0]
    return middle[:, 2].max()


def test_the_cavity_is_as_long_as_published(mesh, internal_os):
    length = fundus(mesh) - internal_os[0]
    assert length == pytest.approx(CAVITY_LENGTH_MM, rel=0.03)
    assert 26 < length < 38


def test_the_cavity_is_as_wide_as_published(mesh):
    assert mesh.extents[0] == pytest.approx(CAVITY_WIDTH_MM, rel=0.03)
    assert 25 < mesh.extents[0] < 40


def test_the_distended_cavity_is_as_deep_as_published(mesh):
    assert mesh.extents[1] == pytest.approx(DEPTH_MM, rel=0.03)
    assert 6 < mesh.extents[1] < 38


def test_the_internal_os_is_as_narrow_as_published(internal_os):
    assert internal_os[1] == pytest.approx(INTERNAL_OS_MM, rel=0.05)
    assert 4 < internal_os[1] < 11


def test_the_internal_os_is_at_the_origin(internal_os):
    assert abs(internal_os[0]) < 1.0


def test_the_canal_is_as_long_as_published(mesh, internal_os):
    length = internal_os[0] - mesh.bounds[0, 2]
    assert length == pytest.approx(CANAL_LENGTH_MM, rel=0.05)


def test_the_cornual_angle_is_as_published(internal_os, horn):
    across, up = horn - [internal_os[1] / 2, internal_os[0]]
    angle = np.degrees(np.arctan2(up, across))
    assert angle == pytest.approx(CORNUAL_ANGLE_DEG, abs=2)
    assert 39 < angle < 88


def test_the_coronal_area_is_as_published(widths, internal_os):
    heights, width = widths
    above = heights >= internal_os[0]
    area = np.trapezoid(width[above], heights[above])
    assert area == pytest.approx(CORONAL_AREA_MM2, rel=0.05)
    assert 300 < area < 800


def test_the_lateral_wall_is_indented_as_published(widths, internal_os, horn):
    heights, width = widths
    wall = np.stack([width / 2, heights], axis=1)
    wall = wall[(heights > internal_os[0]) & (heights < horn[1])]
    line = horn - [internal_os[1] / 2, internal_os[0]]
    offset = wall - [internal_os[1] / 2, internal_os[0]]
    gap = (offset @ [-line[1], line[0]]) / np.linalg.norm(line)
    assert gap.max() == pytest.approx(INDENTATION_MM, rel=0.15)
    assert 0.8 < gap.max() < 6.4


def test_the_volume_is_that_of_a_distended_cavity(mesh):
    assert 5e3 < mesh.volume < 10e3


def test_the_surface_is_a_sphere_that_an_organ_can_be(womb, mesh):
    check_surface(womb.vertices, womb.faces, womb.name)
    assert mesh.euler_number == 2


def test_the_surface_does_not_cut_itself(mesh):
    # a surface with f = 0 at its vertices cuts itself only where it is coarse against
    # its curvature: then the middles of its triangles are off
    middle = cavity(mesh.triangles_center)
    assert np.abs(middle).max() < 0.15


def test_triangles_are_even_and_near_one_millimetre(womb):
    triangles = womb.vertices[womb.faces]
    assert radius_ratio(triangles).min() > 0.5
    assert 0.95 < np.median(side_lengths(triangles)) < 1.1
    assert side_lengths(triangles).max() < 1.7
    assert side_lengths(triangles).min() > 0.5


@pytest.mark.parametrize("edge_mm", [0.9, 1.4])
def test_triangles_follow_the_edge_length(edge_mm):
    organ = build(edge_mm)
    check_surface(organ.vertices, organ.faces, organ.name)
    triangles = organ.vertices[organ.faces]
    assert np.median(side_lengths(triangles)) == pytest.approx(edge_mm, rel=0.08)
    assert radius_ratio(triangles).min() > 0.3


def test_the_same_tessellation_gives_the_same_mesh(womb):
    vertices, faces = _tessellated.__wrapped__(1.0)
    np.testing.assert_array_equal(vertices, womb.vertices)
    np.testing.assert_array_equal(faces, womb.faces)


def test_the_kept_mesh_is_what_the_tessellation_makes(womb):
    """But for the rounding of another machine, which may turn an edge round."""
    vertices, faces = make(1.0)
    made = trimesh.Trimesh(vertices, faces, process=False)
    kept = trimesh.Trimesh(womb.vertices, womb.faces, process=False)
    assert len(womb.vertices) == pytest.approx(len(vertices), rel=0.01)
    assert kept.volume == pytest.approx(made.volume, rel=1e-3)
    assert kept.area == pytest.approx(made.area, rel=1e-3)
    np.testing.assert_allclose(cavity(womb.vertices), 0.0, atol=1e-9)
    sites = np.array(list(womb.sites.values()))
    np.testing.assert_allclose(sites, vertices[: len(sites)], atol=1e-9)


def test_what_is_done_to_one_uterus_is_not_done_to_the_next(womb):
    changed = build()
    changed.vertices[:] = 0
    changed.faces[:] = 0
    changed.sites["fundus"][:] = 0
    again = build()
    np.testing.assert_array_equal(again.vertices, womb.vertices)
    np.testing.assert_array_equal(again.faces, womb.faces)
    np.testing.assert_array_equal(again.sites["fundus"], womb.sites["fundus"])
    assert again.sites["fundus"].any()


def test_the_cavity_is_symmetric(womb):
    mirrored = womb.vertices * [-1, 1, 1]
    np.testing.assert_allclose(cavity(mirrored), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    "name",
    [
        "fundus",
        "left-cornu",
        "right-cornu",
        "anterior",
        "posterior",
        "left-wall",
        "right-wall",
        "isthmus",
        "cervix",
    ],
)
def test_a_named_site_is_a_vertex_with_room_above_it(womb, name):
    gap = np.linalg.norm(womb.vertices - womb.sites[name], axis=1)
    assert gap.min() == 0
    assert 4 < room(womb, locate_site(womb, name)) < 60


@pytest.mark.parametrize(
    "name, axis, sign",
    [
        ("left-cornu", 0, 1),
        ("right-cornu", 0, -1),
        ("left-wall", 0, 1),
        ("right-wall", 0, -1),
        ("anterior", 1, -1),
        ("posterior", 1, 1),
        ("fundus", 2, 1),
        ("cervix", 2, -1),
    ],
)
def test_a_named_site_is_on_the_side_that_it_is_named_for(womb, name, axis, sign):
    assert sign * womb.sites[name][axis] > 5


@pytest.mark.parametrize("edge_mm", [0.1, 3.0])
def test_an_edge_length_out_of_range_is_refused(edge_mm):
    with pytest.raises(OrganError, match=r"edges between 0.4 and 1.5 mm, not"):
        build(edge_mm)
