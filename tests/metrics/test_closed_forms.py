"""Shape metrics of smooth surfaces of revolution, meshed as finely as membranes are.

A mesh of triangles with sides of 0.8 r0, as the membrane's are, is within a few per
cent of the sphere caps, cylinders and tori below, and one of half that size within a
few tenths of the error.
"""

import numpy as np
import pytest

from jaxgrow.metrics import shape_metrics

from .surfaces import arc, cap, cylinder, disc_of, mesh, mushroom


@pytest.fixture(scope="module")
def measure(make_state):
    """Metrics of a profile, on a flat disc."""

    def metrics(profile, spacing):
        vertices, faces, rim = mesh(profile, spacing)
        return shape_metrics(make_state((vertices, faces, rim), disc_of(vertices, rim)))

    return metrics


# spacing and error; of curvature at places that are not all alike
FINE = [(0.8, 0.03), (0.4, 0.01)]


@pytest.mark.parametrize("spacing, rtol", FINE)
@pytest.mark.parametrize("radius, height", [(4.0, 3.0), (3.0, 4.0), (4.0, 1.5)])
def test_sphere_cap(measure, radius, height, spacing, rtol):
    found = measure(cap(radius, height), spacing)
    base = np.sqrt(radius**2 - (radius - height + 0.5) ** 2)  # half an r0 up
    width = 2 * (radius if height > 1.2 * radius else base)
    raised = height - 0.5
    volume = np.pi * raised**2 * (3 * radius - raised) / 3
    surface = 2 * np.pi * radius * raised + np.pi * base**2
    wanted = {
        "height_mm": height,
        "length_mm": height,
        "width_mm": width,
        "neck_width_mm": 2 * base,
        "base_width_mm": 2 * base,
        "height_to_width": height / width,
        "neck_to_width": 2 * base / width,
        "volume_mm3": np.pi * height**2 * (3 * radius - height) / 3,
        "area_mm2": 2 * np.pi * radius * raised,
        "sphericity": np.pi ** (1 / 3) * (6 * volume) ** (2 / 3) / surface,
        "tip_curvature_per_mm": 1 / radius,
    }
    for name, value in wanted.items():
        np.testing.assert_allclose(getattr(found, name), value, rtol=rtol, err_msg=name)
    assert found.tip_curvature_spread_per_mm < rtol / radius


@pytest.mark.parametrize("spacing, rtol", FINE)
def test_cylinder_with_a_dome(measure, spacing, rtol):
    radius, length = 2.0, 8.0
    found = measure(cylinder(radius, length), spacing)
    wanted = {
        "height_mm": length + radius,
        "width_mm": 2 * radius,
        "neck_width_mm": 2 * radius,
        "height_to_width": (length + radius) / (2 * radius),
        "neck_to_width": 1.0,
        "volume_mm3": np.pi * radius**2 * (length + 2 / 3 * radius),
        "area_mm2": 2 * np.pi * radius * (length + radius - 0.5),
        "tip_curvature_per_mm": 1 / radius,
    }
    for name, value in wanted.items():
        np.testing.assert_allclose(getattr(found, name), value, rtol=rtol, err_msg=name)
    # the neck reaches a little into the dome, and to the crease at the base
    np.testing.assert_allclose(
        found.neck_curvature_per_mm, 1 / (2 * radius), rtol=4 * rtol
    )


@pytest.mark.parametrize("spacing, rtol", FINE)
@pytest.mark.parametrize("neck, tube", [(1.5, 3.0), (2.0, 2.0), (2.0, 1.5)])
def test_neck_of_a_torus(measure, neck, tube, spacing, rtol):
    profile, radius, top = mushroom(neck, tube)
    found = measure(profile, spacing)
    wanted = {
        "height_mm": top,
        "width_mm": 2 * radius,
        "neck_width_mm": 2 * neck,
        "height_to_width": top / (2 * radius),
        "neck_to_width": neck / radius,
        "tip_curvature_per_mm": 1 / radius,
    }
    for name, value in wanted.items():
        np.testing.assert_allclose(getattr(found, name), value, rtol=rtol, err_msg=name)
    # one principal curvature is the neck's, the other one is the tube's, hollow
    curvature = (1 / neck - 1 / tube) / 2
    # half an r0 beside the neck the mean curvature is less by some 0.02
    np.testing.assert_allclose(found.neck_curvature_per_mm, curvature, atol=0.025)
    assert found.neck_curvature_spread_per_mm < 0.05


@pytest.fixture(scope="module")
def on_a_bowl(make_state):
    """Metrics of a lesion on the wall of a round cavity, with a height by radius."""
    bowl = mesh([arc((0, 8), 8.0, 0.0, -np.pi / 2)], 0.8)

    def metrics(height):
        vertices, faces, rim = bowl
        out = np.linalg.norm(vertices[:, :2], axis=1)
        low = vertices[:, 2] < 8
        raised = vertices + np.outer(height(out) * low, [0, 0, 1])
        return shape_metrics(make_state((raised, faces, rim), (vertices, faces)))

    return metrics


def test_the_rising_wall_of_a_cavity_is_no_lesion(on_a_bowl):
    found = on_a_bowl(lambda out: 0 * out)
    for name in ("height_mm", "width_mm", "neck_width_mm", "area_mm2", "sphericity"):
        assert getattr(found, name) == 0


def test_a_dome_in_a_cavity_is_as_wide_as_itself(on_a_bowl):
    radius, height = 3.0, 3.0
    found = on_a_bowl(lambda out: height * np.maximum(1 - (out / radius) ** 2, 0))
    np.testing.assert_allclose(found.height_mm, height, rtol=1e-12)
    # where it is half an r0 high over the wall
    base = 2 * radius * np.sqrt(1 - 0.5 / height)
    np.testing.assert_allclose(found.width_mm, base, rtol=0.1)
    np.testing.assert_allclose(found.neck_width_mm, base, rtol=0.1)
    volume = np.pi * radius**2 * height / 2
    np.testing.assert_allclose(found.volume_mm3, volume, rtol=0.05)


def test_a_ball_on_a_thin_neck_is_nearly_a_sphere_and_a_stalk_is_none(measure):
    ball, _, _ = mushroom(1.5, 0.8, above=1.2)
    assert measure(ball, 0.8).sphericity > 0.95
    assert measure(cylinder(2.0, 8.0), 0.8).sphericity < 0.85


@pytest.mark.parametrize("seed", range(3))
def test_what_has_hardly_risen_has_no_neck_however_ragged_it_is(make_state, seed):
    vertices, faces, rim = mesh(cap(6.0, 0.7), 0.8)
    noise = np.random.default_rng(seed).normal(0, 0.15, len(vertices))
    vertices[:, 2] += np.where(rim, 0, np.clip(noise, -0.25, 0.25))
    assert vertices[:, 2].max() < 1
    found = shape_metrics(make_state((vertices, faces, rim), disc_of(vertices, rim)))
    assert found.width_mm > 0
    assert found.neck_to_width == 1
