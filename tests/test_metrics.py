"""Shape metrics against polyhedra of revolution, whose measures are closed forms."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrow.mesh.surface import Surface
from jaxgrow.metrics import height_above, shape_metrics, ShapeMetrics
from jaxgrow.state import FormerSurface, Frame, State
from jaxgrow.transfer import put_membrane, put_particles


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


PARTICLES = np.array(
    [[0, 0, -2.0], [0, 0, -0.25], [1, 0, 0.25], [0, 1, 1.0], [0, 0, 9.0]]
)


def make_state(name, turn=None, mm=1.0):
    rings, tip = PROFILES[name]
    turn = np.eye(3) if turn is None else turn
    vertices, faces, rim = revolve(rings, tip)
    membrane = put_membrane(Surface(vertices @ turn.T, faces, rim, len(vertices) - 1))
    flat, flat_faces, _ = revolve(rings[:1], 0.0)
    particles = put_particles(
        PARTICLES @ turn.T, np.array([1, 1, 1, 1, 0]), np.zeros(5, bool), 8
    )
    frame = Frame(
        jnp.zeros(3),
        jnp.asarray(turn[:, 2]),
        jnp.asarray(mm),
        FormerSurface(jnp.asarray(flat @ turn.T), jnp.asarray(flat_faces)),
    )
    return State(particles, membrane, frame)


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
def shape(request):
    return request.param, shape_metrics(make_state(request.param))


def test_height_is_that_of_the_tip(shape):
    name, metrics = shape
    np.testing.assert_allclose(metrics.height_mm, PROFILES[name][1], rtol=1e-14)


def test_width_is_the_widest_raised_ring(shape):
    name, metrics = shape
    widest = max(2 * r for r, z in PROFILES[name][0] if z > 0.5)
    # 32 directions miss the largest extent by up to 1 - cos(180°/64)
    assert widest * np.cos(np.pi / 64) <= metrics.width_mm <= widest * (1 + 1e-14)


def test_volume_is_exact(shape):
    name, metrics = shape
    np.testing.assert_allclose(metrics.volume_mm3, exact_volume(name), rtol=1e-13)


def test_area_is_exact(shape):
    name, metrics = shape
    np.testing.assert_allclose(metrics.area_mm2, exact_area(name), rtol=1e-13)


@pytest.mark.parametrize("name, radius", [("mushroom", 1.0), ("cylinder", 1.5)])
def test_neck_has_the_area_of_the_narrowest_section_below_the_widest(name, radius):
    metrics = shape_metrics(make_state(name))
    wanted = 2 * np.sqrt(SECTOR * radius**2 / np.pi)
    np.testing.assert_allclose(metrics.neck_width_mm, wanted, rtol=1e-12)


def test_neck_of_a_dome_is_its_base():
    metrics = shape_metrics(make_state("dome"))
    wanted = 2 * np.sqrt(SECTOR * radius_at("dome", 0.5) ** 2 / np.pi)
    np.testing.assert_allclose(metrics.neck_width_mm, wanted, rtol=1e-12)


def test_sphericity_is_that_of_the_raised_part(shape):
    name, metrics = shape
    surface = exact_area(name) + SECTOR * radius_at(name, 0.5) ** 2
    wanted = np.pi ** (1 / 3) * (6 * exact_volume(name, 0.5)) ** (2 / 3) / surface
    # the volume is summed over 48 sections
    np.testing.assert_allclose(metrics.sphericity, wanted, rtol=0.03)
    assert metrics.sphericity < 1


def test_fraction_counts_a_particle_by_its_part_above(shape):
    _, metrics = shape
    # tumour particles at -2, -1/4, 1/4 and 1: 0, 1/4, 3/4 and 1; the last is tissue
    np.testing.assert_allclose(metrics.intracavitary_fraction, 0.5, rtol=1e-13)


def test_tumour_diameter_is_that_of_a_ball_with_its_radius_of_gyration(shape):
    _, metrics = shape
    tumour = PARTICLES[:4]
    gyration = np.sqrt(((tumour - tumour.mean(axis=0)) ** 2).sum(axis=1).mean())
    wanted = 2 * np.sqrt(5 / 3) * gyration + 1
    np.testing.assert_allclose(metrics.tumour_diameter_mm, wanted, rtol=1e-13)


def values(metrics):
    return np.array(jax.tree.leaves(metrics))


def test_orientation_in_space_is_irrelevant():
    turn = Rotation.from_rotvec([0.4, 1.0, -0.3]).as_matrix()
    turned = values(shape_metrics(make_state("mushroom", turn)))
    upright = values(shape_metrics(make_state("mushroom")))
    exact = np.arange(len(upright)) != 1  # but the width, whose directions turn
    np.testing.assert_allclose(turned[exact], upright[exact], rtol=1e-9)
    np.testing.assert_allclose(turned[1], upright[1], rtol=2e-3)


def test_lengths_are_in_millimetres():
    one = values(shape_metrics(make_state("mushroom")))
    three = values(shape_metrics(make_state("mushroom", mm=3.0)))
    np.testing.assert_allclose(
        three, one * np.array([3, 3, 3, 27, 9, 1, 1, 3]), rtol=1e-14
    )


def test_padding_is_inert():
    state = make_state("dome")
    live = np.asarray(state.membrane.vertex_alive)
    noise = 50 * np.random.default_rng(0).normal(size=(256, 3)) * ~live[:, None]
    filled = eqx.tree_at(
        lambda s: s.membrane.vertices, state, state.membrane.vertices + noise
    )
    np.testing.assert_array_equal(
        values(shape_metrics(filled)), values(shape_metrics(state))
    )


def test_flat_patch_has_no_lesion():
    state = make_state("dome")
    flat = eqx.tree_at(
        lambda s: s.membrane.vertices, state, state.membrane.vertices.at[:, 2].set(0.0)
    )
    metrics = shape_metrics(flat)
    for name in ("height_mm", "width_mm", "neck_width_mm", "area_mm2", "sphericity"):
        assert getattr(metrics, name) == 0
    np.testing.assert_allclose(metrics.volume_mm3, 0, atol=1e-13)


def test_free_cluster_has_a_diameter_only():
    state = make_state("dome")
    free = State(
        state.particles,
        None,
        eqx.tree_at(lambda f: f.former, state.frame, None, is_leaf=lambda x: x is None),
    )
    metrics = shape_metrics(free)
    assert metrics.tumour_diameter_mm > 1
    others = [
        name for name in ShapeMetrics.__dataclass_fields__ if "tumour" not in name
    ]
    assert all(np.isnan(getattr(metrics, name)) for name in others)


@pytest.fixture(scope="module")
def jacobian():
    """Derivative of all metrics of a bumpy mushroom, with the state it is taken at."""
    state = make_state("mushroom")
    noise = 0.02 * np.random.default_rng(1).normal(size=(256, 3))
    free = np.asarray(state.membrane.free)[:, None]
    state = eqx.tree_at(
        lambda s: s.membrane.vertices, state, state.membrane.vertices + noise * free
    )

    def measure(vertices, position):
        at = eqx.tree_at(
            lambda s: (s.membrane.vertices, s.particles.position),
            state,
            (vertices, position),
        )
        return jnp.stack(jax.tree.leaves(shape_metrics(at)))

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


def test_height_above_a_plane_has_the_sign_of_the_side():
    former = make_state("dome").frame.former
    points = jnp.asarray([[0.3, 0.2, 1.5], [1, 1, -0.7], [0.1, 0, 0]])
    found = jax.jit(height_above)(points, former)
    np.testing.assert_allclose(found, [1.5, -0.7, 0], atol=1e-14)
