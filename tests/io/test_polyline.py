"""A closed line in an OBJ file."""

import numpy as np
import pytest

from jaxgrow.io.polyline import write_polyline


def test_points_come_back_bit_for_bit_in_order(tmp_path):
    points = np.random.default_rng(0).normal(size=(7, 3))
    write_polyline(tmp_path / "a.obj", points)
    lines = [line.split() for line in (tmp_path / "a.obj").read_text().splitlines()]
    read = np.array([line[1:] for line in lines if line[0] == "v"], float)
    assert read.tobytes() == points.tobytes()
    assert lines[-1] == ["l", "1", "2", "3", "4", "5", "6", "7", "1"]


@pytest.mark.parametrize("points", [np.zeros((2, 3)), np.full((4, 3), np.inf)])
def test_what_is_no_closed_line_is_refused(tmp_path, points):
    with pytest.raises(ValueError, match="a closed line needs three or more"):
        write_polyline(tmp_path / "a.obj", points)
    assert list(tmp_path.iterdir()) == []
