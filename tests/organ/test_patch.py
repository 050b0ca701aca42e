import numpy as np
import pytest

from jaxgrow.mesh.quality import area_vectors
from jaxgrow.mesh.topology import build_topology, euler_number, is_manifold
from jaxgrow.organ import cut_patch, locate_site, Organ, OrganError
from jaxgrow.organ.patch import distances_along


SITES = ["fundus", "left-cornu", "anterior", "left-wall", "cervix"]


@pytest.mark.parametrize("name", SITES)
def test_a_patch_is_a_disc_without_bow_ties(womb, name):
    patch = cut_patch(womb, locate_site(womb, name), 6.0, r0_mm=1.0)
    assert is_manifold(patch.faces, len(patch.vertices))
    assert euler_number(patch.faces) == 1


@pytest.mark.parametrize("name", SITES)
def test_the_rest_of_the_organ_stays_a_manifold_in_one_piece(womb, name):
    patch = cut_patch(womb, locate_site(womb, name), 6.0, r0_mm=1.0)
    rest = womb.faces[~patch.face_mask]
    assert is_manifold(rest, len(womb.vertices))
    assert euler_number(rest) == 1


def test_normals_of_a_patch_point_into_the_lumen(ball, bubble):
    for organ, sign in ((ball, 1), (bubble, -1)):
        patch = cut_patch(organ, locate_site(organ, "top"), 4.0, r0_mm=1.0)
        normals = area_vectors(patch.vertices[patch.faces])
        corners = patch.to_mm(patch.vertices)[patch.faces].mean(axis=1)
        assert np.all(sign * np.einsum("ij,ij->i", normals, corners) > 0)


def test_the_rim_is_what_the_patch_shares_with_the_rest(womb):
    patch = cut_patch(womb, locate_site(womb, "fundus"), 8.0, r0_mm=1.0)
    shared = np.intersect1d(
        womb.faces[patch.face_mask].ravel(), womb.faces[~patch.face_mask].ravel()
    )
    np.testing.assert_array_equal(patch.organ_index[patch.rim], shared)


def test_local_positions_are_in_r0_around_the_site(womb):
    site = locate_site(womb, "fundus")
    patch = cut_patch(womb, site, 8.0, r0_mm=0.5)
    wanted = (womb.vertices[patch.organ_index] - site.point) / 0.5
    np.testing.assert_array_equal(patch.vertices, wanted)
    np.testing.assert_allclose(
        patch.to_mm(patch.vertices), womb.vertices[patch.organ_index], atol=1e-13
    )
    np.testing.assert_array_equal(patch.to_local(site.point[None]), 0)


def test_an_organ_a_kilometre_away_gives_the_same_patch(bubble):
    # vertices rounded so that adding 1e6 to them is exact
    near = Organ("near", np.round(bubble.vertices * 1024) / 1024, bubble.faces)
    far = Organ("far", near.vertices + 1e6, near.faces)
    point = near.vertices[7]
    one = cut_patch(near, locate_site(near, tuple(point)), 5.0, r0_mm=0.7)
    other = cut_patch(far, locate_site(far, tuple(point + 1e6)), 5.0, r0_mm=0.7)
    np.testing.assert_array_equal(other.face_mask, one.face_mask)
    np.testing.assert_array_equal(other.vertices, one.vertices)


def test_distances_along_a_sphere_are_its_arcs(ball):
    site = locate_site(ball, (0.0, 0.0, 10.0))
    local = ball.vertices - site.point
    topology = build_topology(ball.faces, len(ball.vertices))
    found = distances_along(local, ball.faces, topology, site.face)
    cosine = np.clip(ball.vertices @ site.point / 100, -1, 1)
    arc = 10 * np.arccos(cosine)
    far = arc > 2
    ratio = found[far] / arc[far]
    assert ratio.min() > 0.99
    assert ratio.max() < 1.06


def test_the_opposite_wall_of_a_thin_lumen_is_far_away(womb):
    # 14 mm across: a ball of this radius would reach it, a path does not
    patch = cut_patch(womb, locate_site(womb, "anterior"), 14.5, r0_mm=1.0)
    assert patch.to_mm(patch.vertices)[:, 1].max() < 5


def test_an_enclosed_island_is_filled_in(ball):
    # a spike: its tip is far along the surface, its foot is not
    vertices = ball.vertices.copy()
    tip = int(np.argmax(vertices[:, 2]))
    site = locate_site(ball, tuple(ball.vertices[np.argsort(-vertices[:, 2])[20]]))
    vertices[tip] *= 3
    spiked = Organ("spiked", vertices, ball.faces, "inside")
    patch = cut_patch(spiked, site, 8.0, r0_mm=1.0)
    assert patch.face_mask[(ball.faces == tip).any(axis=1)].all()
    assert euler_number(patch.faces) == 1


def test_a_patch_that_goes_round_a_tube_has_two_rims(tube):
    site = locate_site(tube, (5.0, 0.0, 0.0))
    patch = cut_patch(tube, site, 18.0, r0_mm=1.0)
    assert is_manifold(patch.faces, len(patch.vertices))
    assert euler_number(patch.faces) == 0
    assert euler_number(tube.faces[~patch.face_mask]) == 2


def test_a_patch_that_swallows_the_organ_is_refused(bubble):
    with pytest.raises(OrganError, match=r"takes \d+ % of bubble.* use a larger organ"):
        cut_patch(bubble, locate_site(bubble, "top"), 29.0, r0_mm=1.0)


def test_a_patch_of_a_few_triangles_is_refused(womb):
    with pytest.raises(OrganError, match="but 12 are needed: refine"):
        cut_patch(womb, locate_site(womb, "fundus"), 0.5, r0_mm=1.0)
