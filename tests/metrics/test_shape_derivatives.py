"""Derivatives of shape metrics, and where they jump."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.metrics import shape_metrics

from ..quick_jit import quick_jit
from .polyhedra import bumpy, flattened, NAMES, OF_TUMOUR


# that jump where another section becomes the neck
PARTS = {"head_length_mm", "stalk_length_mm"}

# that have no value where nothing is raised
UNDEFINED = {
    "height_to_width",
    "length_to_width",
    "neck_to_width",
    "sphericity",
    "lean_deg",
    "bend_deg",
    "contact_angle_deg",
}


def measure(vertices, position, state, smoothing):
    """All metrics of a state with these vertices and particles."""
    at = eqx.tree_at(
        lambda s: (s.membrane.vertices, s.particles.position),
        state,
        (vertices, position),
    )
    metrics = shape_metrics(at, smoothing=smoothing)
    return jnp.stack(jax.tree.leaves(metrics))


measured = quick_jit(measure)


def jumps(start, end, smoothing):
    """Metrics that jump on the straight way between two membranes' vertices.

    Where nothing does, steps of a quarter have a quarter of the largest change.
    """

    def at(t):
        vertices = (1 - t) * start.membrane.vertices + t * end
        return measured(vertices, start.particles.position, start, smoothing)

    path = np.stack([at(t) for t in np.linspace(0, 1, 801)])
    fine = np.abs(np.diff(path, axis=0)).max(axis=0)
    coarse = np.abs(np.diff(path[::4], axis=0)).max(axis=0)
    still = {n for n in NAMES if "intracavitary" in n} | OF_TUMOUR
    assert {n for n, c in zip(NAMES, coarse, strict=True) if c < 1e-12} == still
    return {n for n, f, c in zip(NAMES, fine, coarse, strict=True) if f > c / 2}


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_nothing_jumps_where_other_places_become_highest_widest_or_narrowest(
    lesion, smoothing
):
    start = bumpy(lesion("mushroom"), 3, size=0.2)
    head = np.asarray(start.membrane.vertices)[:, 2:] > 3
    end = bumpy(start, 4, size=0.4).membrane.vertices
    slimmer = end * np.where(head, [[0.35, 0.35, 1.1]], 1.0)
    assert jumps(start, slimmer, smoothing) <= PARTS


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_only_what_has_no_value_without_a_lesion_jumps_where_one_begins(
    lesion, smoothing
):
    grown = bumpy(lesion("dome"), 5, size=0.1)
    found = jumps(flattened(grown), grown.membrane.vertices, smoothing)
    lengths = {"length_mm", "width_mm", "neck_width_mm"}
    curvatures = {name for name in NAMES if "curvature" in name}
    assert found <= UNDEFINED | PARTS | lengths | curvatures


SMOOTHING = {"exact": 0.0, "smooth": 0.1}


@quick_jit
def slope_of(vertices, position, state, kind):
    """The derivative of all metrics in the vertices and in the particles."""
    return jax.jacrev(measure, (0, 1))(vertices, position, state, SMOOTHING[kind])


@pytest.fixture(scope="module", params=SMOOTHING)
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def mushroom(lesion):
    """Vertices and particles of a bumpy mushroom without ties, and its state."""
    state = bumpy(lesion("mushroom"), 1)
    rng = np.random.default_rng(7)
    position = state.particles.position
    position += 0.02 * rng.normal(size=position.shape)
    return state.membrane.vertices, position, state


def test_all_derivatives_are_finite(mushroom, kind):
    assert all(np.isfinite(part).all() for part in slope_of(*mushroom, kind))


def differences(where, along, h, state, kind):
    """Central differences of all metrics along a direction."""
    up, down = (
        measure(
            *(x + s * h * a for x, a in zip(where, along, strict=True)),
            *(state, SMOOTHING[kind]),
        )
        for s in (1, -1)
    )
    return np.asarray((up - down) / (2 * h))


def test_derivatives_are_those_of_differences(mushroom, kind):
    *where, state = mushroom
    slope = slope_of(*mushroom, kind)
    rng = np.random.default_rng(2)
    along = [rng.normal(size=x.shape) for x in where]
    # with smaller steps the rounding of the solved field shows
    wanted = differences(where, along, 1e-5, state, kind)
    found = sum(np.einsum("mij,ij->m", s, a) for s, a in zip(slope, along, strict=True))
    # the hull has kinks so near to each other that the differences cross some
    hull: np.ndarray = np.isin(
        NAMES, ["body_equivalent_diameter_mm", "body_sphericity"]
    )
    np.testing.assert_allclose(
        np.asarray(found)[~hull], wanted[~hull], rtol=1e-4, atol=1e-6
    )
    np.testing.assert_allclose(np.asarray(found)[hull], wanted[hull], rtol=0.02)
    # a mushroom with a neck, as this one, has its width from the head alone
    assert np.sum(np.abs(found) > 1e-3) > len(NAMES) / 2


def test_derivatives_of_a_flat_patch_are_finite(mushroom, kind):
    vertices, position, state = mushroom
    slope = slope_of(vertices.at[:, 2].set(0.0), position, state, kind)
    assert all(np.isfinite(part).all() for part in slope)


def test_derivatives_of_symmetric_shapes_exist_if_smooth(lesion):
    """Where directions, vertices and sections tie, the exact ones have kinks."""
    state = lesion("cylinder")
    where = state.membrane.vertices, state.particles.position
    smooth: np.ndarray = np.isin(NAMES, ["height_mm", "width_mm"])
    slope = np.asarray(slope_of(*where, state, "smooth")[0])[smooth]
    rng = np.random.default_rng(0)
    along = rng.normal(size=where[0].shape), np.zeros(where[1].shape)
    wanted = differences(where, along, 1e-6, state, "smooth")[smooth]
    found = np.einsum("mij,ij->m", slope, along[0])
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-5)
