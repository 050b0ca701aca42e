import numpy as np
import pytest
from scipy.spatial import KDTree

from jaxgrow.mesh.proximity import nearest_on_mesh
from jaxgrow.organ import cut_patch, fill_tissue, locate_site, Organ, OrganError


LAYER = {
    "spacing": 1.0,
    "density": 1.2,
    "thickness": 3.0,
    "gap": 0.3,
    "hold": 1.0,
}


def fill(organ, patch, seed=0, **changes):
    return fill_tissue(
        organ, patch, rng=np.random.default_rng(seed), **{**LAYER, **changes}
    )


@pytest.fixture(scope="module")
def patch(womb):
    return cut_patch(womb, locate_site(womb, "fundus"), 8.0, r0_mm=1.0)


@pytest.fixture(scope="module")
def plate():
    """A solid plate of 40 x 40 x 2 mm."""
    half = np.array([20.0, 20.0, 1.0])
    steps = np.linspace(-1, 1, 21)
    corner = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    index = np.arange(21 * 21).reshape(21, 21)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    quads = np.stack([a, b, c, d], axis=-1).reshape(-1, 4)
    sheet = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    top = np.column_stack([corner, np.ones(len(corner))]) * half
    around = np.concatenate([index[:, 0], index[-1, 1:], index[-2::-1, -1]])
    around = np.concatenate([around, index[0, -2:0:-1]])
    after, below = np.roll(around, -1), len(corner)
    sides = np.concatenate(
        [
            np.stack([around + below, after + below, after], axis=1),
            np.stack([around + below, after, around], axis=1),
        ]
    )
    faces = np.concatenate([sheet, sheet[:, ::-1] + below, sides])
    return Organ("plate", np.concatenate([top, top * [1, 1, -1]]), faces, "inside")


@pytest.fixture(scope="module")
def tissue(womb, patch):
    return fill(womb, patch)


def solid_angle(points, vertices, faces):
    """Winding number of a closed surface around points, by solid angles."""
    a, b, c = (vertices[faces[:, k]] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=2) for side in (a, b, c))
    top = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    bottom = la * lb * lc
    bottom += np.einsum("pfi,pfi->pf", a, b) * lc
    bottom += np.einsum("pfi,pfi->pf", b, c) * la
    bottom += np.einsum("pfi,pfi->pf", c, a) * lb
    return np.arctan2(top, bottom).sum(axis=1) / (2 * np.pi)


def test_depths_are_exact_and_in_the_layer(womb, patch, tissue):
    points = patch.to_mm(tissue.points)
    exact = nearest_on_mesh(points, womb.vertices, womb.faces)[0]
    np.testing.assert_allclose(tissue.depth, exact, atol=1e-12)
    assert exact.min() >= 0.3
    assert exact.max() <= 3.0


def test_the_patch_is_the_nearest_part_of_the_organ(womb, patch, tissue):
    points = patch.to_mm(tissue.points)
    own = nearest_on_mesh(points, womb.vertices, womb.faces[patch.face_mask])[0]
    np.testing.assert_allclose(tissue.depth, own, atol=1e-12)


def test_tissue_of_a_hollow_organ_is_outside_its_surface(womb, patch, tissue):
    some = patch.to_mm(tissue.points[::4])
    winding = solid_angle(some, womb.vertices, womb.faces)
    np.testing.assert_allclose(winding, 0, atol=1e-9)


def test_tissue_of_a_solid_organ_is_inside_its_surface(ball):
    patch = cut_patch(ball, locate_site(ball, "top"), 7.0, r0_mm=1.0)
    tissue = fill(ball, patch)
    some = patch.to_mm(tissue.points[::2])
    winding = solid_angle(some, ball.vertices, ball.faces)
    np.testing.assert_allclose(winding, 1, atol=1e-9)


def test_tissue_in_a_thin_wall_stays_in_it(plate):
    patch = cut_patch(plate, locate_site(plate, (0.0, 0.0, 1.0)), 8.0, r0_mm=1.0)
    tissue = fill(plate, patch, gap=0.1)
    height = patch.to_mm(tissue.points)[:, 2]
    assert len(height) > 50
    # beyond the middle the other wall is nearer
    assert height.min() >= -1e-9
    assert height.max() <= 0.9 + 1e-9


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_no_two_particles_are_closer_than_promised(womb, patch, seed):
    tissue = fill(womb, patch, seed)
    gaps = KDTree(tissue.points).query(tissue.points, k=2)[0][:, 1]
    assert tissue.distance == 0.8
    assert gaps.min() >= tissue.distance


def test_there_are_as_many_particles_as_the_density_asks_for(tissue):
    assert len(tissue.points) == round(1.2 * tissue.volume)


@pytest.mark.parametrize("thickness", [2.0, 4.0])
def test_the_volume_of_the_layer_is_right(ball, thickness):
    patch = cut_patch(ball, locate_site(ball, "top"), 7.0, r0_mm=1.0)
    tissue = fill(ball, patch, thickness=thickness)
    # the part of a ball's shells that lies over the patch's share of the sphere
    a, b, c = (ball.vertices[ball.faces[patch.face_mask, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    share = area / 100
    wanted = share / 3 * ((10 - 0.3) ** 3 - (10 - thickness) ** 3)
    assert tissue.volume == pytest.approx(wanted, rel=0.04)


def test_particles_fill_the_layer_evenly(womb, patch):
    tissue = fill(womb, patch, density=1.0)
    free = (tissue.depth > 0.8) & (tissue.depth < 2.5)
    inner = np.linalg.norm(tissue.points, axis=1) < 4
    probes = tissue.points[free & inner]
    near = [len(group) for group in KDTree(tissue.points).query_ball_point(probes, 0.8)]
    assert max(near) == 1
    gaps = KDTree(tissue.points).query(probes, k=2)[0][:, 1]
    assert gaps.max() < 1.5


def test_a_density_beyond_jamming_shrinks_the_distance(ball):
    patch = cut_patch(ball, locate_site(ball, "top"), 4.0, r0_mm=1.0)
    tissue = fill(ball, patch, density=3.0, thickness=2.0)
    assert len(tissue.points) == round(3.0 * tissue.volume)
    assert tissue.distance < 0.8
    gaps = KDTree(tissue.points).query(tissue.points, k=2)[0][:, 1]
    assert gaps.min() >= tissue.distance


def test_spacing_scales_the_particles(womb, patch):
    tissue = fill(womb, patch, spacing=1.5)
    assert len(tissue.points) == round(1.2 * tissue.volume / 1.5**3)
    assert tissue.distance == pytest.approx(1.2)


def test_particles_near_the_bottom_are_held(tissue):
    assert tissue.held[tissue.depth > 2.0].all()


def test_particles_near_the_sides_are_held(ball):
    patch = cut_patch(ball, locate_site(ball, "top"), 7.0, r0_mm=1.0)
    tissue = fill(ball, patch)
    # the sides of a ball's layer are radial: compare with the rim's directions
    points = patch.to_mm(tissue.points)
    rim = ball.vertices[patch.organ_index[patch.rim]] / 10
    along = np.linalg.norm(points, axis=1)
    across = np.linalg.norm(points[:, None] - along[:, None, None] * rim, axis=2)
    near = across.min(axis=1) < 0.9
    assert near.any()
    assert tissue.held[near].all()


def test_particles_in_the_middle_are_free(tissue):
    # the rim is 8 mm away along the surface
    middle = np.linalg.norm(tissue.points, axis=1) < 3.5
    shallow = tissue.depth < 1.9
    assert (middle & shallow).any()
    assert not tissue.held[middle & shallow].any()


def test_nothing_is_held_without_a_margin(womb, patch):
    assert not fill(womb, patch, hold=0.0).held.any()


def test_the_same_seed_gives_the_same_particles(womb, patch, tissue):
    again = fill(womb, patch)
    np.testing.assert_array_equal(again.points, tissue.points)
    np.testing.assert_array_equal(again.held, tissue.held)
    assert not np.array_equal(fill(womb, patch, seed=1).points, tissue.points)


def test_an_organ_a_kilometre_away_gets_the_same_particles(bubble):
    near = Organ("near", np.round(bubble.vertices * 1024) / 1024, bubble.faces)
    far = Organ("far", near.vertices + 1e6, near.faces)
    point = near.vertices[7]
    one = cut_patch(near, locate_site(near, tuple(point)), 5.0, r0_mm=1.0)
    other = cut_patch(far, locate_site(far, tuple(point + 1e6)), 5.0, r0_mm=1.0)
    np.testing.assert_array_equal(fill(far, other).points, fill(near, one).points)


@pytest.mark.parametrize(
    "changes",
    [
        {"gap": 3.0},
        {"gap": -0.1},
        {"spacing": 0.0},
        {"density": 0.0},
        {"hold": -1.0},
    ],
)
def test_lengths_that_make_no_sense_are_refused(womb, patch, changes):
    with pytest.raises(OrganError, match="cannot be filled: spacing and density must"):
        fill(womb, patch, **changes)


def test_a_layer_without_room_is_refused(plate):
    patch = cut_patch(plate, locate_site(plate, (0.0, 0.0, 1.0)), 8.0, r0_mm=1.0)
    with pytest.raises(OrganError, match="the wall is too thin there"):
        fill(plate, patch, gap=1.1)
