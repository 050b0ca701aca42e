"""Iso-lines against circles."""

import numpy as np
import pytest

from jaxgrow.mesh.isoline import polygon_length, trace_isolines


TURN = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]


def _circles(sphere, *levels):
    surface = sphere(4)
    vertices = surface.vertices @ TURN.T
    height = np.abs(vertices[:, 2]) if len(levels) > 1 else vertices[:, 2]
    return vertices, surface.faces, height, levels[0]  # pyright: ignore[reportGeneralTypeIssues]


def test_a_section_of_a_sphere_is_as_long_as_its_circle(sphere):
    (line,) = trace_isolines(*_circles(sphere, 0.3))
    circle = 2 * np.pi * np.sqrt(1 - 0.3**2)
    assert line.length == pytest.approx(circle, rel=2e-3)


def test_its_length_converges_at_second_order(sphere):
    errors = []
    for level in (3, 4):
        surface = sphere(level)
        (line,) = trace_isolines(
            surface.vertices @ TURN.T,
            surface.faces,
            (surface.vertices @ TURN.T)[:, 2],
            0.3,
        )
        errors.append(2 * np.pi * np.sqrt(1 - 0.3**2) - line.length)
    assert 3 < errors[0] / errors[1] < 5.5


def test_points_are_on_the_level_and_in_order(sphere):
    (line,) = trace_isolines(*_circles(sphere, 0.3))
    assert np.allclose(line.points[:, 2], 0.3, atol=1e-14)
    angle = np.unwrap(np.arctan2(line.points[:, 1], line.points[:, 0]))
    assert (np.diff(angle) > 0).all() or (np.diff(angle) < 0).all()


def test_a_line_runs_counter_clockwise_round_what_is_above(sphere):
    vertices, faces, height, level = _circles(sphere, 0.3)
    (line,) = trace_isolines(vertices, faces, height, level)
    x, y = line.points[:, 0], line.points[:, 1]
    area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    outward = np.linalg.det(vertices[faces[0]]) > 0
    assert (area > 0) == outward


def test_two_caps_have_two_lines_the_longest_first(sphere):
    vertices, faces, _, _ = _circles(sphere, 0.3)
    value = np.where(vertices[:, 2] > 0, vertices[:, 2] - 0.3, -vertices[:, 2] - 0.8)
    lines = trace_isolines(vertices, faces, value, 0.0)
    assert len(lines) == 2
    assert lines[0].length > lines[1].length
    assert lines[0].points[0, 2] > 0


def test_a_level_that_no_vertex_reaches_has_no_line(sphere):
    surface = sphere(1)
    assert trace_isolines(surface.vertices, surface.faces, np.zeros(42), 0.5) == ()


def test_a_line_through_a_vertex_has_it_once(sphere):
    surface = sphere(1)
    value = np.where(np.arange(42) == 5, 0.5, 0.0)
    value[surface.faces[(surface.faces == 5).any(axis=1)]] = 0.5
    (line,) = trace_isolines(surface.vertices, surface.faces, value, 0.5)
    assert len(np.unique(line.within)) == len(line.within)


def test_a_line_that_ends_at_the_rim_is_left_out(grid):
    surface = grid(4)
    assert not trace_isolines(
        surface.vertices, surface.faces, surface.vertices[:, 0], 1.5
    )


def test_a_square_is_as_long_as_its_sides():
    square = np.array([[0.0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]])
    assert polygon_length(square) == 8
