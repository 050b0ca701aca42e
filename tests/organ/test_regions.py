"""Base, stalk and head of bodies whose sections are known."""

import numpy as np
import pytest

from jaxgrow.mesh.audit import audit_surface
from jaxgrow.mesh.isoline import trace_isolines
from jaxgrow.organ.regions import find_regions, LESION, Region

from ..revolved import dome, label_by_height, mushroom


def _regions(vertices, faces, lesion=None):
    if lesion is None:
        lesion = label_by_height(vertices)
    lines = trace_isolines(vertices, faces, lesion, LESION)
    return find_regions(vertices, faces, lesion, lines[0].length if lines else 0.0)


def _bent(vertices, radius=12.0):
    """Bend what is above the plane along an arc."""
    x, y, z = vertices.T
    up = np.maximum(z, 0)
    turn = up / radius
    bent = np.stack([radius - (radius - x) * np.cos(turn), y, 0 * z], axis=1)
    bent[:, 2] = (radius - x) * np.sin(turn)
    return np.where(z[:, None] > 0, bent, vertices)


@pytest.mark.parametrize("length", [2.5, 4.0, 8.0])
@pytest.mark.parametrize("stalk", [1.5, 2.5])
def test_a_neck_is_as_long_as_the_circle_round_the_stalk(stalk, length):
    vertices, faces = mushroom(stalk, length)
    assert audit_surface(vertices, faces).clean
    found = _regions(vertices, faces)
    assert found.neck == pytest.approx(2 * np.pi * stalk, rel=2e-3)


@pytest.mark.parametrize("length", [4.0, 8.0])
def test_the_stalk_is_the_shaft_and_the_head_the_ball(length):
    vertices, faces = mushroom(1.5, length)
    z = vertices[:, 2]
    region = _regions(vertices, faces).region
    assert (region[(z > 1.2) & (z < length - 0.1)] == Region.STALK).all()
    assert (region[z > length + 1.0] == Region.HEAD).all()
    assert (region[(z > 0.51) & (z < 0.7)] == Region.BASE).all()
    assert (region[z < 0.5] == Region.HEALTHY).all()


def test_a_stalk_is_found_however_it_bends():
    vertices, faces = mushroom(1.5, 8.0)
    straight = _regions(vertices, faces)
    lesion = label_by_height(vertices)
    bent = _regions(_bent(vertices), faces, lesion)
    assert bent.neck == pytest.approx(straight.neck, rel=0.1)
    assert np.mean(bent.region != straight.region) < 0.05


def test_a_dome_has_no_stalk():
    found = _regions(*dome())
    assert found.neck is None
    assert not (found.region == Region.STALK).any()
    assert (found.region == Region.HEAD).any()


def test_a_ball_on_a_stalk_nearly_as_wide_has_none():
    assert _regions(*mushroom(3.6, 1.6)).neck is None


def test_scaling_changes_no_region():
    vertices, faces = mushroom()
    lesion = label_by_height(vertices)
    one = _regions(vertices, faces, lesion)
    other = _regions(1000 * vertices, faces, lesion)
    assert np.array_equal(one.region, other.region)
    assert other.neck == pytest.approx(1000 * one.neck)  # pyright: ignore[reportOperatorIssue]


def test_numbering_changes_no_region():
    vertices, faces = mushroom()
    order = np.random.default_rng(0).permutation(len(vertices))
    place = np.argsort(order)
    one = _regions(vertices, faces)
    other = _regions(vertices[order], place[faces])
    assert other.neck == pytest.approx(one.neck, rel=1e-6)
    assert np.mean(one.region[order] != other.region) < 0.02


def test_without_a_lesion_all_is_healthy():
    vertices, faces = dome()
    found = _regions(vertices, faces, np.zeros(len(vertices)))
    assert not found.region.any()
    assert found.neck is None


def test_a_lesion_of_one_vertex_is_base():
    vertices, faces = dome()
    lesion = np.where(vertices[:, 2] == vertices[:, 2].max(), 1.0, 0.0)
    found = _regions(vertices, faces, lesion)
    assert np.array_equal(found.region, lesion.astype(int))


def test_pits_stay_healthy_and_the_rest_is_told_apart():
    vertices, faces = mushroom()
    lesion = label_by_height(vertices)
    pit = np.linalg.norm(vertices - [4.0, 0, 7.7], axis=1) < 0.7
    assert pit.any()
    lesion[pit] = 0.2
    found = _regions(vertices, faces, lesion)
    whole = _regions(*mushroom())
    assert not found.region[pit].any()
    assert found.neck == pytest.approx(whole.neck, rel=1e-3)


def test_a_part_apart_from_the_lesion_is_base():
    vertices, faces = mushroom()
    lesion = label_by_height(vertices)
    apart = np.linalg.norm(vertices - [9.5, 0, 0], axis=1) < 1.0
    lesion[apart] = 0.8
    region = _regions(vertices, faces, lesion).region
    assert (region[apart] == Region.BASE).all()
    assert (region == Region.STALK).any()


def test_an_organ_that_is_lesion_all_over_has_only_base():
    vertices, faces = dome()
    region = _regions(vertices, faces, np.ones(len(vertices))).region
    assert (region == Region.BASE).all()
