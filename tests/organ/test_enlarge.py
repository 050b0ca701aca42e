from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from jaxgrow.mesh.audit import audit_surface
from jaxgrow.mesh.proximity import nearest_on_mesh
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.topology import euler_number, is_manifold
from jaxgrow.mesh.winding import particles_outside
from jaxgrow.organ import (
    cut_patch,
    enlarge,
    fill_tissue,
    line_patch,
    Lining,
    locate_site,
    merge,
    Organ,
    OrganError,
    widen_patch,
)


GAP, HOLD, THICK = 0.7, 1.0, 3.0
AREAS = {"max_area": 0.7, "min_area": 0.1}


class Grown:
    """What grew, made up: a bump of membrane that takes the tissue under it along."""

    def __init__(self, organ, site, radius=6.5, height=3.0, r0_mm=1.0):
        place = locate_site(organ, site)
        self.organ = organ
        self.patch = cut_patch(organ, place, radius * r0_mm, r0_mm=r0_mm)
        surface, index = line_patch(organ, self.patch, **AREAS)
        inner = np.flatnonzero(~surface.fixed)
        source = inner[np.linalg.norm(surface.vertices[inner], axis=1).argmin()]
        tissue = fill_tissue(
            organ,
            self.patch,
            spacing=1.0,
            density=1.2,
            thickness=THICK,
            gap=GAP,
            hold=HOLD,
            rng=np.random.default_rng(0),
        )

        def raised(points, still):
            reach = np.linalg.norm(points, axis=1)
            bump = height * np.exp(-((reach / 2.5) ** 2))[:, None] * place.normal
            return np.where(still[:, None], points, points + bump)

        vertices = raised(surface.vertices, surface.fixed)
        surface = Surface(vertices, surface.faces, surface.fixed, int(source))
        self.lining = Lining(surface, index)
        self.points, self.held = raised(tissue.points, tissue.held), tissue.held

    def enlarge(self, radius=9.0, thickness=THICK, seed=1, **changes):
        given = {
            "points": self.points,
            "held": self.held,
            "lining": self.lining,
            "patch": self.patch,
            "thickness_before": THICK,
            "density": 1.2,
            **AREAS,
            "gap": GAP,
            "hold": HOLD,
            **changes,
        }
        return enlarge(
            self.organ,
            radius=radius,
            thickness=thickness,
            rng=np.random.default_rng(seed),
            **given,
        )


def merged(organ, enlarged):
    surface, index = enlarged.lining
    patch = enlarged.patch
    return merge(organ, patch, patch.to_mm(surface.vertices), surface.faces, index)


def all_points(grown, enlarged):
    return np.concatenate([grown.points, enlarged.tissue.points])


def depth_under(organ, patch, points):
    """Distance to the organ before growth, in r0."""
    vertices = patch.to_local(organ.vertices)
    return nearest_on_mesh(points, vertices, organ.faces)[0]


@pytest.fixture(scope="module")
def grown(womb):
    return Grown(womb, "fundus")


@pytest.fixture(scope="module")
def wider(grown):
    return grown.enlarge()


@pytest.fixture(scope="module")
def deeper(grown):
    return grown.enlarge(radius=9.0, thickness=5.0)


def test_the_larger_patch_has_every_triangle_of_the_old_one(grown, wider):
    before, after = grown.patch.face_mask, wider.patch.face_mask
    assert np.all(after[before])
    assert after.sum() > 1.3 * before.sum()


def test_local_positions_stay(grown, wider):
    place = np.searchsorted(wider.patch.organ_index, grown.patch.organ_index)
    np.testing.assert_array_equal(wider.patch.vertices[place], grown.patch.vertices)
    assert wider.patch.site is grown.patch.site


def test_what_has_grown_comes_first_to_the_last_bit(grown, wider):
    before, index = grown.lining
    after, names = wider.lining
    vertices, faces = len(before.vertices), len(before.faces)
    np.testing.assert_array_equal(after.vertices[:vertices], before.vertices)
    np.testing.assert_array_equal(after.faces[:faces], before.faces)
    np.testing.assert_array_equal(names[:vertices], index)


def test_the_old_rim_is_free(grown, wider):
    count = len(grown.lining.surface.vertices)
    assert grown.lining.surface.fixed.any()
    assert not wider.lining.surface.fixed[:count].any()
    assert not wider.patch.rim[
        np.isin(wider.patch.organ_index, grown.patch.organ_index)
    ].any()


def test_the_new_rim_is_fixed_and_the_organs(womb, wider):
    surface, names = wider.lining
    patch = wider.patch
    np.testing.assert_array_equal(
        np.sort(names[surface.fixed]), patch.organ_index[patch.rim]
    )
    np.testing.assert_array_equal(
        surface.vertices[surface.fixed],
        patch.to_local(womb.vertices[names[surface.fixed]]),
    )


def test_the_source_is_kept(grown, wider):
    assert grown.lining.surface.source >= 0
    assert wider.lining.surface.source == grown.lining.surface.source


@pytest.mark.parametrize("site", ["fundus", "left-cornu", "anterior", "cervix"])
@pytest.mark.parametrize("tissue", ["outside", "inside"])
def test_the_enlarged_surface_fits_into_the_organ(womb, site, tissue):
    organ = Organ("womb", womb.vertices, womb.faces, tissue, womb.sites)
    # on a solid organ the bump goes out, where the womb is narrow inwards
    grown = Grown(organ, site, height=1.5, r0_mm=0.9)
    enlarged = grown.enlarge(radius=9.0, density=0.3)
    surface = enlarged.lining.surface
    assert is_manifold(surface.faces, len(surface.vertices))
    assert euler_number(surface.faces) == euler_number(enlarged.patch.faces)
    whole = merged(organ, enlarged)
    found = audit_surface(whole.vertices, whole.faces)
    assert found.clean, found.defects
    assert found.euler_number == euler_number(organ.faces)


def test_no_particle_is_closer_to_a_new_one_than_promised(grown, wider):
    tissue = wider.tissue
    assert len(tissue.points) > 100
    assert tissue.distance >= 0.72
    tree = KDTree(all_points(grown, wider))
    gaps = tree.query(tissue.points, k=2)[0][:, 1]
    assert gaps.min() >= tissue.distance


def test_no_particle_is_outside_the_tissue(womb, grown, deeper):
    whole = merged(womb, deeper)
    points = deeper.patch.to_mm(all_points(grown, deeper))
    assert not particles_outside(whole.vertices, whole.faces, points, womb.tissue).any()


def test_new_tissue_lies_below_the_ring_alone_if_the_layer_is_as_thick(
    womb, grown, wider
):
    points = wider.tissue.points
    vertices = wider.patch.to_local(womb.vertices)
    depth, face, _ = nearest_on_mesh(points, vertices, womb.faces)
    ring = wider.patch.face_mask & ~grown.patch.face_mask
    assert ring[face].all()
    np.testing.assert_allclose(wider.tissue.depth, depth, atol=1e-12)
    assert depth.min() >= GAP
    assert depth.max() <= THICK


def test_a_thicker_layer_gets_tissue_below_the_old_one(womb, grown, deeper):
    vertices = deeper.patch.to_local(womb.vertices)
    points = deeper.tissue.points
    depth, face, _ = nearest_on_mesh(points, vertices, womb.faces)
    below = grown.patch.face_mask[face]
    assert below.sum() > 50
    assert depth[below].min() > THICK
    assert depth.max() <= 5.0
    assert depth.max() > 4.8


def test_new_tissue_keeps_its_distance_to_the_surface_as_it_is(womb):
    # a dent through the old layer, into the space of the new one
    dented = Grown(womb, "fundus", height=0.0)
    surface, index = dented.lining
    reach = np.linalg.norm(surface.vertices, axis=1)
    dent = -4.5 * np.exp(-((reach / 1.5) ** 4))[:, None] * dented.patch.site.normal
    vertices = np.where(
        surface.fixed[:, None], surface.vertices, surface.vertices + dent
    )
    dented.lining = Lining(replace(surface, vertices=vertices), index)
    away = np.linalg.norm(dented.points, axis=1) > 5.0
    enlarged = dented.enlarge(
        thickness=6.0, points=dented.points[away], held=dented.held[away]
    )
    after = enlarged.lining.surface
    gap = nearest_on_mesh(enlarged.tissue.points, after.vertices, after.faces)[0]
    assert gap.min() >= GAP
    whole = merged(womb, enlarged)
    points = enlarged.patch.to_mm(enlarged.tissue.points)
    assert not particles_outside(whole.vertices, whole.faces, points, womb.tissue).any()
    assert np.linalg.norm(enlarged.tissue.points, axis=1).min() < 6.5


def test_the_space_gets_the_density_asked_for(wider):
    assert len(wider.tissue.points) == round(1.2 * wider.tissue.volume)


def test_particles_that_moved_into_the_ring_are_respected_and_counted(grown, wider):
    # put free particles where an enlargement found room for new ones
    free = np.flatnonzero(~grown.held)[:20]
    points = grown.points.copy()
    points[free] = wider.tissue.points[:20]
    again = grown.enlarge(points=points, seed=2)
    assert len(again.tissue.points) == round(1.2 * again.tissue.volume) - 20
    gaps = KDTree(points).query(again.tissue.points)[0]
    assert gaps.min() >= again.tissue.distance


def test_where_no_more_fits_particles_are_left_out_and_not_squeezed_in(
    womb, grown, wider
):
    # a thin space between two sheets of particles, which block nearly all of it
    sheets = [
        fill_tissue(
            womb,
            wider.patch,
            spacing=0.45,
            density=1.0,
            thickness=gap + 0.3,
            gap=gap,
            hold=HOLD,
            rng=np.random.default_rng(3),
        ).points
        for gap in (2.0, 3.1)
    ]
    points = np.concatenate([grown.points, *sheets])
    held = np.zeros(len(points), dtype=bool)
    tissue = grown.enlarge(points=points, held=held, gap=2.4).tissue
    assert 0 < len(tissue.points) < 0.5 * 1.2 * tissue.volume
    # 1.2 per r0³ is below jamming, so the distance may shrink twice from 0.8
    assert tissue.distance >= 0.8 * 0.95**2 - 1e-12
    gaps = KDTree(points).query(tissue.points)[0]
    assert gaps.min() >= tissue.distance


def test_only_what_was_held_stays_held(grown, wider):
    assert wider.held.any()
    assert not wider.held[~grown.held].any()


@pytest.mark.parametrize("name", ["wider", "deeper"])
def test_held_is_what_is_near_the_new_bottom_or_sides(ball, name):
    # the sides of a ball's layer are radial
    grown = Grown(ball, "top")
    thickness = {"wider": THICK, "deeper": 5.0}[name]
    enlarged = grown.enlarge(thickness=thickness)
    points = all_points(grown, enlarged)
    held = np.concatenate([enlarged.held, enlarged.tissue.held])
    could = np.concatenate([grown.held, np.ones(len(enlarged.tissue.points), bool)])
    patch = enlarged.patch
    depth = depth_under(ball, patch, points)
    rim = ball.vertices[patch.organ_index[patch.rim]] / 10
    from_centre = patch.to_mm(points)
    along = np.linalg.norm(from_centre, axis=1)
    across = np.linalg.norm(from_centre[:, None] - along[:, None, None] * rim, axis=2)
    beside = across.min(axis=1)
    deep = depth > thickness - HOLD
    assert held[could & (deep | (beside < 0.9))].all()
    # a rim edge is 0.7 long: its middle is as near as sqrt(1 - 0.35²) = 0.93 allows
    assert not held[~deep & (beside > 1.07)].any()
    released = grown.held & ~enlarged.held
    assert released.sum() > 20


def test_the_same_generator_gives_the_same_enlargement(grown, wider):
    again = grown.enlarge()
    np.testing.assert_array_equal(again.tissue.points, wider.tissue.points)
    np.testing.assert_array_equal(again.held, wider.held)
    np.testing.assert_array_equal(
        again.lining.surface.vertices, wider.lining.surface.vertices
    )
    other = grown.enlarge(seed=7)
    assert not np.array_equal(other.tissue.points, wider.tissue.points)


def test_a_radius_that_reaches_nothing_new_takes_in_one_row(womb, grown):
    enlarged = grown.enlarge(radius=1.0)
    before, after = grown.patch.face_mask, enlarged.patch.face_mask
    touching = np.isin(womb.faces, grown.patch.organ_index).any(axis=1)
    assert np.all(after[touching])
    assert after.sum() < 2 * before.sum()
    assert not enlarged.lining.surface.fixed[: len(grown.lining.organ_index)].any()


def test_enlarging_twice_is_possible(womb, grown, wider):
    points = all_points(grown, wider)
    held = np.concatenate([wider.held, wider.tissue.held])
    twice = grown.enlarge(
        radius=11.0, points=points, held=held, lining=wider.lining, patch=wider.patch
    )
    whole = merged(womb, twice)
    assert audit_surface(whole.vertices, whole.faces).clean
    count = len(wider.lining.organ_index)
    np.testing.assert_array_equal(
        twice.lining.surface.vertices[:count], wider.lining.surface.vertices
    )


def test_a_particle_on_a_surface_far_from_the_origin_is_treated_alike(bubble):
    near = Organ("near", np.round(bubble.vertices * 1024) / 1024, bubble.faces)
    far = Organ("far", near.vertices + 1e6, near.faces)
    point = near.vertices[7]
    one = Grown(near, tuple(point), radius=5.0).enlarge(radius=7.0)
    other = Grown(far, tuple(point + 1e6), radius=5.0).enlarge(radius=7.0)
    np.testing.assert_array_equal(
        other.lining.surface.vertices, one.lining.surface.vertices
    )
    assert len(other.tissue.points) == pytest.approx(len(one.tissue.points), rel=0.02)


def test_an_enlargement_may_close_round_a_tube_and_then_has_two_rims(tube):
    grown = Grown(tube, (5.0, 0.0, 0.0), radius=10.0)
    assert euler_number(grown.patch.faces) == 1
    enlarged = grown.enlarge(radius=18.0, density=0.3)
    surface = enlarged.lining.surface
    assert euler_number(surface.faces) == 0
    fixed = surface.vertices[surface.fixed]
    assert fixed[:, 2].min() < -5
    assert fixed[:, 2].max() > 5
    whole = merged(tube, enlarged)
    assert audit_surface(whole.vertices, whole.faces).clean


def test_a_patch_with_two_rims_grows_at_both(tube):
    grown = Grown(tube, (5.0, 0.0, 0.0), radius=17.0)
    assert euler_number(grown.patch.faces) == 0
    enlarged = grown.enlarge(radius=18.5, density=0.3)
    assert euler_number(enlarged.lining.surface.faces) == 0
    z = enlarged.tissue.points[:, 2]
    assert z.min() < -8
    assert z.max() > 8
    whole = merged(tube, enlarged)
    assert audit_surface(whole.vertices, whole.faces).clean


def test_an_island_that_the_new_patch_encloses_is_filled_in(ball):
    # a spike: its tip is far along the surface, its foot is not
    vertices = ball.vertices.copy()
    tip = int(np.argmax(vertices[:, 2]))
    by_height = np.argsort(-vertices[:, 2])
    site = tuple(ball.vertices[by_height[60]])
    vertices[tip] *= 2
    spiked = Organ("spiked", vertices, ball.faces, "inside")
    grown = Grown(spiked, site, radius=3.5, height=0.5)
    spike = (ball.faces == tip).any(axis=1)
    assert not grown.patch.face_mask[spike].any()
    enlarged = grown.enlarge(radius=8.0, density=0.3)
    assert enlarged.patch.face_mask[spike].all()
    whole = merged(spiked, enlarged)
    assert audit_surface(whole.vertices, whole.faces).clean


def test_an_enlargement_that_swallows_the_organ_is_refused(bubble):
    grown = Grown(bubble, "top")
    with pytest.raises(OrganError, match=r"takes \d+ % of bubble.* use a larger organ"):
        grown.enlarge(radius=29.0)


def test_a_thinner_layer_is_refused(grown):
    with pytest.raises(OrganError, match="of 3 r0 cannot become 2 r0 thick"):
        grown.enlarge(thickness=2.0)


def test_lengths_without_sense_are_refused(grown):
    with pytest.raises(OrganError, match="cannot be filled: spacing and density"):
        grown.enlarge(density=0.0)


def test_a_particle_that_left_the_tissue_is_refused(grown):
    points = grown.points.copy()
    # into the lumen above the ring
    vertex = int(np.flatnonzero(grown.patch.rim)[0])
    points[0] = 1.1 * grown.patch.vertices[vertex] + 0.5 * grown.patch.site.normal
    with pytest.raises(OrganError, match="1 particles are outside the tissue of"):
        grown.enlarge(points=points)


def test_a_membrane_with_another_rim_is_refused(grown):
    surface, index = grown.lining
    row = int(np.argmax(surface.fixed[surface.faces].sum(axis=1) == 2))
    faces = np.delete(surface.faces, row, axis=0)
    with pytest.raises(OrganError, match="Euler number"):
        grown.enlarge(lining=Lining(replace(surface, faces=faces), index))


def test_widening_by_a_radius_equals_cutting_with_it(womb, grown):
    whole = cut_patch(womb, grown.patch.site, 9.0, r0_mm=1.0)
    wide = widen_patch(womb, grown.patch, 9.0)
    np.testing.assert_array_equal(wide.face_mask, whole.face_mask)
    np.testing.assert_array_equal(wide.vertices, whole.vertices)
