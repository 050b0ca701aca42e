import numpy as np
import pytest

from jaxgrow.organ import locate_site, Organ, OrganError, room


def test_a_named_site_is_found_on_the_surface(ball):
    site = locate_site(ball, "top")
    assert site.name == "top"
    np.testing.assert_allclose(site.point, ball.sites["top"], atol=1e-12)
    assert np.isin(0, ball.faces[site.face])


def test_the_normal_of_a_solid_organ_points_out_of_it(ball):
    site = locate_site(ball, "top")
    assert site.normal @ site.point / 10 > 0.999


def test_the_normal_of_a_hollow_organ_points_into_it(bubble):
    site = locate_site(bubble, "top")
    assert site.normal @ site.point / 10 < -0.999


@pytest.mark.parametrize("wanted", [(0.0, 0.0, 10.5), "0,0,10.5", " 0, 0 ,1.05e1"])
def test_coordinates_near_the_surface_are_moved_onto_it(ball, wanted):
    site = locate_site(ball, wanted)
    assert np.linalg.norm(site.point) == pytest.approx(10, abs=0.02)
    np.testing.assert_allclose(site.point[:2], 0, atol=0.02)


def test_a_site_off_the_surface_is_refused_with_the_nearest_point(ball):
    with pytest.raises(
        OrganError, match=r"is 2 mm off .* at most 1 mm .* surface is \(.*10\) mm\.$"
    ):
        locate_site(ball, (0.0, 0.0, 12.0))


def test_a_misspelt_site_gets_a_suggestion_and_the_list(womb):
    with pytest.raises(
        OrganError, match=r"no site 'fundas': did you mean 'fundus'\? choose one of ant"
    ):
        locate_site(womb, "fundas")


def test_a_name_that_is_nothing_like_a_site_gets_the_list(ball):
    with pytest.raises(OrganError, match="no site 'xyz': choose one of top, or give"):
        locate_site(ball, "xyz")


def test_a_name_on_an_organ_without_sites_asks_for_coordinates(ball):
    bare = Organ("bare", ball.vertices, ball.faces)
    with pytest.raises(OrganError, match="bare has no named sites"):
        locate_site(bare, "top")


@pytest.mark.parametrize("wanted", ["1,2", "1,2,x", (1.0, 2.0, float("inf"))])
def test_coordinates_that_are_not_three_numbers_are_refused(ball, wanted):
    with pytest.raises(OrganError, match="neither a name nor three finite"):
        locate_site(ball, wanted)


def test_the_room_in_a_bubble_is_its_diameter(bubble):
    assert room(bubble, locate_site(bubble, "top")) == pytest.approx(20, rel=2e-3)


def test_the_room_outside_a_ball_is_infinite(ball):
    assert room(ball, locate_site(ball, "top")) == np.inf


def test_the_room_does_not_depend_on_where_the_origin_is(bubble):
    far = Organ("far", bubble.vertices + 1e6, bubble.faces)
    here = locate_site(bubble, (3.0, 4.0, 8.66))
    there = locate_site(far, (1e6 + 3.0, 1e6 + 4.0, 1e6 + 8.66))
    assert room(far, there) == pytest.approx(room(bubble, here), abs=1e-6)
