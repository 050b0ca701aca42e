"""Areas and shapes."""

import numpy as np
import pytest

from jaxgrow.mesh.quality import area_vectors, areas, radius_ratio, side_lengths


RIGHT = np.array([[[0.0, 0, 0], [3, 0, 0], [0, 4, 0]]])


def test_the_equilateral_triangle_has_ratio_one():
    triangle = np.array([[[0.0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0]]])
    assert radius_ratio(triangle)[0] == pytest.approx(1.0, abs=64 * 2**-52)


def test_the_3_4_5_triangle_has_inradius_1_and_circumradius_5_halves():
    assert radius_ratio(RIGHT)[0] == pytest.approx(2 * 1 / 2.5, abs=64 * 2**-52)


@pytest.mark.parametrize(
    "corners",
    [
        [[0.0, 0, 0]] * 3,
        [[0.0, 0, 0], [1, 0, 0], [2, 0, 0]],
        [[0.0, 0, 0]] * 2 + [[1.0, 0, 0]],
    ],
    ids=["point", "line", "repeated corner"],
)
def test_a_degenerate_triangle_has_ratio_zero(corners):
    assert radius_ratio(np.array([corners]))[0] == 0.0


def test_the_ratio_does_not_depend_on_size():
    assert radius_ratio(1e-5 * RIGHT)[0] == pytest.approx(radius_ratio(RIGHT)[0])


def test_the_area_vector_is_the_normal_times_the_area():
    assert area_vectors(RIGHT)[0].tolist() == [0.0, 0.0, 6.0]
    assert areas(RIGHT)[0] == 6.0


def test_sides_run_from_corner_k_to_the_next():
    assert side_lengths(RIGHT)[0].tolist() == [3.0, 5.0, 4.0]
