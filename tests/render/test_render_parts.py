"""What a picture is made of, against areas and lengths that can be written down."""

import numpy as np
import pytest
import trimesh

from jaxgrow.render.camera import look
from jaxgrow.render.cut import behind_plane, cut_faces_of_balls, cut_line, stroke
from jaxgrow.render.occlusion import occlusion
from jaxgrow.render.scene import Balls, DrawnSurface, make_surface
from jaxgrow.render.view import see


def test_the_cut_of_a_sphere_is_a_closed_circle() -> None:
    sphere = trimesh.creation.uv_sphere(count=(80, 120))
    surface = make_surface(
        sphere.vertices, sphere.faces, np.zeros(len(sphere.vertices))
    )
    centre = np.array([0.0, 0.0, 0.6])
    camera = look(
        centre, np.array([0, 0, -1.0]), np.eye(3)[1], width=4.0, pixels=400, reach=0.0
    )
    segments, lesion = cut_line(surface, camera)
    assert not lesion.any()
    assert np.hypot(*(segments - 200).T) / 100 == pytest.approx(0.8, abs=2e-3)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum() / 100
    assert length == pytest.approx(2 * np.pi * 0.8, rel=2e-3)
    ends = np.round(segments.reshape(-1, 2), 6)
    assert np.all(np.unique(ends, axis=0, return_counts=True)[1] == 2)


def test_a_stroke_covers_its_length_times_its_width() -> None:
    segment = np.array([[[20.3, 30.0], [70.1, 55.7]]])
    cover = stroke(segment, 6.0, 100)
    length = np.linalg.norm(segment[0, 1] - segment[0, 0])
    assert cover.sum() == pytest.approx(6 * length + 9 * np.pi, rel=5e-3)
    turned = stroke(segment[:, ::-1].copy(), 6.0, 100)
    assert cover == pytest.approx(turned, abs=1e-6)


@pytest.mark.parametrize("offset", [-0.9, -0.3, 0.0, 0.5])
def test_the_plane_cuts_a_ball_in_a_disc(offset) -> None:
    ball = Balls(np.array([[0, 0, offset]]), np.array([0]), 1.0)
    camera = look(
        np.zeros(3), np.eye(3)[2], np.eye(3)[1], width=4.0, pixels=400, reach=0.0
    )
    sample, _, inside = cut_faces_of_balls(ball, camera)
    assert len(sample) / 1e4 == pytest.approx(np.pi * (1 - offset**2), rel=0.01)
    assert inside.max() == pytest.approx(100 * np.sqrt(1 - offset**2), abs=1)


def test_overlapping_discs_meet_half_way() -> None:
    pair = Balls(np.array([[-0.5, 0, 0], [0.5, 0, 0.0]]), np.array([0, 1]), 1.0)
    camera = look(
        np.zeros(3), np.eye(3)[2], np.eye(3)[1], width=4.0, pixels=100, reach=0.0
    )
    sample, owner, _ = cut_faces_of_balls(pair, camera)
    x = (sample % 100 + 0.5 - 50) * camera.pitch * camera.right[0]
    assert np.array_equal(owner, (x > 0).astype(int))


def test_balls_that_only_touch_the_near_side_are_not_behind_the_plane() -> None:
    centre = np.array([[0, 0, -1.1], [0, 0, -0.9], [0, 0, 3.0]])
    camera = look(
        np.zeros(3), np.eye(3)[2], np.eye(3)[1], width=4.0, pixels=64, reach=0.0
    )
    left = behind_plane(Balls(centre, np.arange(3), 1.0), camera)
    assert left.species.tolist() == [1, 2]


def _floor(lid: bool) -> DrawnSurface:
    """A large square; at will a second one half a millimetre above its left half."""
    square = np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    cover = square * [0.5, 1, 1] + np.array([-4.5, 0, 0.5])
    vertices = np.concatenate([square, cover])
    return make_surface(
        vertices, np.concatenate([faces, faces + 4][: 1 + lid]), np.zeros(8)
    )


@pytest.mark.parametrize(
    "lid, least, most, light", [(False, 1.0, 1.0, 1.0), (True, 0.1, 0.6, 0.0)]
)
def test_a_lid_darkens_what_lies_close_below_it(lid, least, most, light) -> None:
    pytest.importorskip("embreex")
    empty = Balls(np.zeros((0, 3)), np.zeros(0, int), 1.0)
    below = np.array([-0.25, 0, 0])
    aslant = np.array([-1.0, 0, -1.0])
    camera = look(below, aslant, np.eye(3)[1], width=0.1, pixels=64, reach=5.0)
    view = see(_floor(lid), empty, camera)
    assert np.all(view.hits.face[view.traced] < 2)
    sky, key = occlusion(view, np.eye(3)[2], reach=2.0)
    assert least <= sky[view.traced].mean() <= most
    assert np.all(key[view.traced] == light)
