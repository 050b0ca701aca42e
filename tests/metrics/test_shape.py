"""Shape metrics of polyhedra of revolution, whose measures are closed forms."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.spatial.transform import Rotation

from jaxgrow.metrics import shape_metrics, ShapeMetrics
from jaxgrow.state import State


SEGMENTS = 24
SECTOR = SEGMENTS / 2 * np.sin(2 * np.pi / SEGMENTS)  # area of the polygon of radius 1

# radius and height of the rings from the rim inwards, and height of the tip
PROFILES = {
    "dome": ([(6, 0), (3, 0.0), (2.9, 0.6), (2.4, 1.6), (1.3, 2.6)], 3.0),
    "cylinder": ([(6, 0), (1.5, 0), (1.5, 0.6), (1.5, 5.0), (1.0, 5.8)], 6.2),
    "mushroom": (
        [(6, 0), (1.3, 0), (1.3, 0.6), (1, 1.4), (1, 2.4), (2.5, 3.5), (1.5, 4.5)],
        5.0,
    ),
}

LENGTHS = {"height_mm", "width_mm", "neck_width_mm"}
RATIOS = {"height_to_width", "neck_to_width"}
NAMES = tuple(ShapeMetrics.__dataclass_fields__)


def revolve(rings, tip):
    """Vertices and faces, normals away from the axis' inside, and the rim."""
    angle = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = [np.column_stack([r * circle, np.full(SEGMENTS, z)]) for r, z in rings]
    vertices = np.concatenate([*points, [[0.0, 0.0, tip]]])
    index = np.arange(len(rings) * SEGMENTS).reshape(len(rings), SEGMENTS)
    after = np.roll(index, -1, axis=1)
    faces = []
    for k in range(len(rings) - 1):
        a, b, c, d = index[k], after[k], after[k + 1], index[k + 1]
        faces += [np.stack([a, b, c], 1), np.stack([a, c, d], 1)]
    last = np.full(SEGMENTS, len(vertices) - 1)
    faces.append(np.stack([index[-1], after[-1], last], 1))
    rim = np.arange(len(vertices)) < SEGMENTS
    return vertices, np.concatenate(faces), rim


@pytest.fixture(scope="session")
def lesion(make_state):
    """The state of a lesion with a profile; all have the same shapes of arrays."""

    def of(name, **where):
        rings, tip = PROFILES[name]
        return make_state(revolve(rings, tip), revolve(rings[:1], 0.0)[:2], **where)

    return of


def bands(name, lowest):
    """Pairs of neighbouring rings from the given height up, the tip with radius 0."""
    rings, tip = PROFILES[name]
    above = [(r, z) for r, z in (*rings, (0.0, tip)) if z >= lowest]
    if above[0][1] > lowest:
        above.insert(0, (radius_at(name, lowest), lowest))
    return list(itertools.pairwise(above))


def radius_at(name, height):
    """Radius of the profile at a height between its flat surroundings and a ring."""
    (r, z), (s, t) = next(
        pair
        for pair in itertools.pairwise(PROFILES[name][0])
        if pair[0][1] <= height < pair[1][1]
    )
    return r + (s - r) * (height - z) / (t - z)


def exact_volume(name, lowest=0.0):
    return SECTOR * sum(
        (b[1] - a[1]) / 3 * (a[0] ** 2 + a[0] * b[0] + b[0] ** 2)
        for a, b in bands(name, lowest)
    )


def exact_area(name):
    """Of the trapezoids above half an r0."""
    side, apothem = 2 * np.sin(np.pi / SEGMENTS), np.cos(np.pi / SEGMENTS)
    return SEGMENTS * sum(
        side * (a[0] + b[0]) / 2 * np.hypot(b[1] - a[1], apothem * (a[0] - b[0]))
        for a, b in bands(name, 0.5)
    )


@pytest.fixture(scope="module", params=list(PROFILES))
def shape(request, lesion):
    return request.param, shape_metrics(lesion(request.param))


def test_height_is_that_of_the_tip(shape):
    name, metrics = shape
    np.testing.assert_allclose(metrics.height_mm, PROFILES[name][1], rtol=1e-14)


def test_width_is_that_of_the_widest_place_above_half_an_r0(shape):
    name, metrics = shape
    widest = 2 * max(r for band in bands(name, 0.5) for r, _ in band)
    # 32 directions miss the largest extent by up to 1 - cos(180°/64)
    assert widest * np.cos(np.pi / 64) <= metrics.width_mm <= widest * (1 + 1e-12)


def test_volume_is_exact(shape):
    name, metrics = shape
    np.testing.assert_allclose(metrics.volume_mm3, exact_volume(name), rtol=1e-13)


def test_area_is_exact(shape):
    name, metrics = shape
    np.testing.assert_allclose(metrics.area_mm2, exact_area(name), rtol=1e-13)


@pytest.mark.parametrize("name, radius", [("mushroom", 1.0), ("cylinder", 1.5)])
def test_neck_has_the_area_of_the_narrowest_section_below_the_widest(
    lesion, name, radius
):
    metrics = shape_metrics(lesion(name))
    wanted = 2 * np.sqrt(SECTOR * radius**2 / np.pi)
    np.testing.assert_allclose(metrics.neck_width_mm, wanted, rtol=1e-12)


def test_neck_of_a_dome_is_its_base(lesion):
    metrics = shape_metrics(lesion("dome"))
    wanted = 2 * np.sqrt(SECTOR * radius_at("dome", 0.5) ** 2 / np.pi)
    np.testing.assert_allclose(metrics.neck_width_mm, wanted, rtol=1e-12)


def test_ratios_are_those_of_the_lengths(shape):
    _, metrics = shape
    np.testing.assert_allclose(
        [metrics.height_to_width, metrics.neck_to_width],
        [
            metrics.height_mm / metrics.width_mm,
            metrics.neck_width_mm / metrics.width_mm,
        ],
        rtol=1e-15,
    )
    assert metrics.neck_to_width <= 1


def test_sphericity_is_that_of_the_raised_part(shape):
    name, metrics = shape
    surface = exact_area(name) + SECTOR * radius_at(name, 0.5) ** 2
    wanted = np.pi ** (1 / 3) * (6 * exact_volume(name, 0.5)) ** (2 / 3) / surface
    np.testing.assert_allclose(metrics.sphericity, wanted, rtol=1e-12)


def test_fraction_counts_the_segments_of_balls_above(shape):
    _, metrics = shape
    # the first tumour particle is below; a plane cuts two; one is above
    segments = sum(np.pi * h**2 * (1.5 - h) / 3 for h in (0.25, 0.9))
    wanted = (0 + segments / (np.pi / 6) + 1) / 4
    np.testing.assert_allclose(metrics.intracavitary_fraction, wanted, rtol=1e-13)


def test_tumour_diameter_is_that_of_a_ball_with_its_radius_of_gyration(shape, lesion):
    name, metrics = shape
    tumour = np.asarray(lesion(name).particles.position)[:4]
    gyration = np.sqrt(((tumour - tumour.mean(axis=0)) ** 2).sum(axis=1).mean())
    wanted = 2 * np.sqrt(5 / 3) * gyration + 1
    np.testing.assert_allclose(metrics.tumour_diameter_mm, wanted, rtol=1e-13)


def values(metrics):
    return np.array(jax.tree.leaves(metrics))


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_orientation_in_space_is_irrelevant(lesion, smoothing):
    turn = Rotation.from_rotvec([0.4, 1.0, -0.3]).as_matrix()
    turned = shape_metrics(lesion("mushroom", turn=turn), smoothing=smoothing)
    upright = shape_metrics(lesion("mushroom"), smoothing=smoothing)
    for name in NAMES:
        # the directions of the width turn, up to half of 180°/32
        rtol = 2e-3 if "width" in name and name != "neck_width_mm" else 1e-9
        np.testing.assert_allclose(
            getattr(turned, name), getattr(upright, name), rtol=rtol, err_msg=name
        )


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_a_shift_along_the_former_surface_is_irrelevant(lesion, smoothing):
    there = shape_metrics(
        lesion("mushroom", shift=np.array([3.0, -2, 0])), smoothing=smoothing
    )
    here = shape_metrics(lesion("mushroom"), smoothing=smoothing)
    np.testing.assert_allclose(values(there), values(here), rtol=1e-11)


def test_lengths_are_in_millimetres(lesion):
    one = shape_metrics(lesion("mushroom"))
    three = shape_metrics(lesion("mushroom", mm=3.0))
    power = {"mm": 1, "mm2": 2, "mm3": 3}
    for name in NAMES:
        unit = -1 if "per_mm" in name else power.get(name.rsplit("_")[-1], 0)
        np.testing.assert_allclose(
            getattr(three, name), getattr(one, name) * 3.0**unit, rtol=1e-14
        )


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_padding_is_inert(lesion, smoothing):
    state = lesion("dome")
    live = np.asarray(state.membrane.vertex_alive)
    noise = 50 * np.random.default_rng(0).normal(size=(256, 3)) * ~live[:, None]
    filled = eqx.tree_at(
        lambda s: s.membrane.vertices, state, state.membrane.vertices + noise
    )
    np.testing.assert_array_equal(
        values(shape_metrics(filled, smoothing=smoothing)),
        values(shape_metrics(state, smoothing=smoothing)),
    )


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_capacity_is_irrelevant(lesion, smoothing):
    state = lesion("mushroom")

    def longer(array):
        rows = array.shape[0] // 2
        return jnp.concatenate([array, jnp.zeros_like(array[:rows])])

    of_arrays = eqx.filter(state.membrane, lambda x: x.ndim > 0)
    rest = eqx.filter(state.membrane, lambda x: x.ndim == 0)
    roomy = eqx.combine(jax.tree.map(longer, of_arrays), rest)
    np.testing.assert_allclose(
        values(
            shape_metrics(
                State(state.particles, roomy, state.frame), smoothing=smoothing
            )
        ),
        values(shape_metrics(state, smoothing=smoothing)),
        rtol=1e-12,
    )


def flattened(state, share=0.0):
    """The state with all heights of the membrane scaled."""
    return eqx.tree_at(
        lambda s: s.membrane.vertices,
        state,
        state.membrane.vertices * jnp.array([[1, 1, share]]),
    )


def test_flat_patch_has_no_lesion(lesion):
    metrics = shape_metrics(flattened(lesion("dome")))
    for name in set(NAMES) - {
        "volume_mm3",
        "intracavitary_fraction",
        "tumour_diameter_mm",
    }:
        assert getattr(metrics, name) == 0, name
    np.testing.assert_allclose(metrics.volume_mm3, 0, atol=1e-13)


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_free_cluster_has_a_diameter_only(lesion, smoothing):
    state = lesion("dome")
    free = State(
        state.particles,
        None,
        eqx.tree_at(lambda f: f.former, state.frame, None, is_leaf=lambda x: x is None),
    )
    metrics = shape_metrics(free, smoothing=smoothing)
    assert metrics.tumour_diameter_mm > 1
    others = [name for name in NAMES if "tumour" not in name]
    assert all(np.isnan(getattr(metrics, name)) for name in others)


@pytest.mark.parametrize("smoothing", [-0.1, float("nan"), float("inf")])
def test_smoothing_is_a_length(lesion, smoothing):
    with pytest.raises(ValueError, match=r"smoothing is .* give a length in r0"):
        shape_metrics(lesion("dome"), smoothing=smoothing)


def bumpy(state, seed, size=0.02):
    """The state with noise on the free vertices of the membrane."""
    noise = size * np.random.default_rng(seed).normal(size=(256, 3))
    free = np.asarray(state.membrane.free)[:, None]
    return eqx.tree_at(
        lambda s: s.membrane.vertices, state, state.membrane.vertices + noise * free
    )


@pytest.mark.parametrize("smoothing", [0.01, 0.1, 1.0])
@pytest.mark.parametrize("name", list(PROFILES))
def test_smooth_lengths_are_as_near_as_stated(lesion, name, smoothing):
    mm = 2.0
    for seed in range(5):
        state = bumpy(lesion(name, mm=mm), seed, size=0.2)
        exact, smooth = shape_metrics(state), shape_metrics(state, smoothing=smoothing)
        error = {n: (getattr(smooth, n) - getattr(exact, n)) / mm for n in LENGTHS}
        assert -1e-12 <= error["height_mm"] <= smoothing
        assert -1e-12 <= error["width_mm"] <= smoothing
        assert -2 / 3 * smoothing <= error["neck_width_mm"] <= smoothing
        for other in set(NAMES) - LENGTHS - RATIOS:
            assert getattr(smooth, other) == getattr(exact, other), other


def jumps(start, end, smoothing):
    """Metrics that jump on the straight way between two membranes' vertices.

    Where nothing does, steps of a quarter have a quarter of the largest change.
    """

    @jax.jit
    def at(t):
        vertices = (1 - t) * start.membrane.vertices + t * end
        state = eqx.tree_at(lambda s: s.membrane.vertices, start, vertices)
        return jnp.stack(jax.tree.leaves(shape_metrics(state, smoothing=smoothing)))

    path = np.stack([at(t) for t in np.linspace(0, 1, 801)])
    fine = np.abs(np.diff(path, axis=0)).max(axis=0)
    coarse = np.abs(np.diff(path[::4], axis=0)).max(axis=0)
    still = {"intracavitary_fraction", "tumour_diameter_mm"}
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
    assert jumps(start, slimmer, smoothing) == set()


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_only_what_has_no_value_without_a_lesion_jumps_where_one_begins(
    lesion, smoothing
):
    grown = bumpy(lesion("dome"), 5, size=0.1)
    found = jumps(flattened(grown), grown.membrane.vertices, smoothing)
    assert found <= RATIOS | {name for name in NAMES if "curvature" in name} | {
        "sphericity"
    }


@pytest.fixture(scope="module", params=[0.0, 0.1], ids=["exact", "smooth"])
def jacobian(request, lesion):
    """All metrics of a bumpy mushroom, the state, and their derivative there."""
    state = bumpy(lesion("mushroom"), 1)

    def measure(vertices, position):
        at = eqx.tree_at(
            lambda s: (s.membrane.vertices, s.particles.position),
            state,
            (vertices, position),
        )
        metrics = shape_metrics(at, smoothing=request.param)
        return jnp.stack(jax.tree.leaves(metrics))

    measure = jax.jit(measure)
    where = state.membrane.vertices, state.particles.position
    return measure, where, jax.jit(jax.jacrev(measure, (0, 1)))(*where)


def test_all_derivatives_are_finite(jacobian):
    assert all(np.isfinite(part).all() for part in jacobian[2])


def test_derivatives_are_those_of_differences(jacobian):
    measure, where, slope = jacobian
    rng = np.random.default_rng(2)
    along = [rng.normal(size=x.shape) for x in where]
    h = 1e-6
    up, down = (
        measure(*(x + s * h * a for x, a in zip(where, along, strict=True)))
        for s in (1, -1)
    )
    found = sum(np.einsum("mij,ij->m", s, a) for s, a in zip(slope, along, strict=True))
    np.testing.assert_allclose(found, (up - down) / (2 * h), rtol=1e-5, atol=1e-7)
    assert np.abs(found).min() > 1e-3


def test_derivatives_of_a_flat_patch_are_finite(jacobian):
    measure, where, _ = jacobian
    flat = where[0].at[:, 2].set(0.0), where[1]
    assert all(
        np.isfinite(part).all() for part in jax.jit(jax.jacrev(measure, (0, 1)))(*flat)
    )


def test_derivatives_of_symmetric_shapes_exist_if_smooth(lesion):
    """Where directions, vertices and sections tie, the exact ones have kinks."""
    state = lesion("cylinder")

    @jax.jit
    def lengths(vertices):
        at = eqx.tree_at(lambda s: s.membrane.vertices, state, vertices)
        metrics = shape_metrics(at, smoothing=0.2)
        return metrics.height_mm, metrics.width_mm

    where = (state.membrane.vertices,)
    check_grads(lengths, where, 1, ("rev",), atol=1e-5, rtol=1e-5, eps=1e-6)
