"""The whole of fairing."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxgrow.mesh.fairing import equilateral_side, fair
from jaxgrow.mesh.proximity import nearest_on_mesh
from jaxgrow.mesh.quality import areas, radius_ratio
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.swap import swap
from jaxgrow.mesh.topology import build_topology, euler_number, is_manifold
from jaxgrow.mesh.winding import winding_number


def _deformed(surface, rng, amount=0.2):
    """The surface stretched, bent and roughened; fixed vertices go along."""
    vertices = surface.vertices * (1 + amount * rng.random(3))
    vertices = vertices + amount * np.sin(0.7 * vertices @ rng.normal(size=(3, 3)))
    vertices = vertices + 0.03 * rng.normal(size=vertices.shape)
    return Surface(vertices, surface.faces, surface.fixed, surface.source)


def _cloud(surface, rng, n_far=150, n_near=300):
    """Particles in and around a closed surface, many very near to it."""
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    far = rng.uniform(low - 0.3, high + 0.3, (n_far, 3))
    face = surface.faces[rng.integers(len(surface.faces), size=n_near)]
    weights = rng.dirichlet([1.0, 1.0, 1.0], n_near)
    near = np.einsum("nk,nki->ni", weights, surface.vertices[face])
    near = near + rng.normal(size=near.shape) * rng.choice(
        [0.02, 0.1, 0.4], (n_near, 1)
    )
    return np.concatenate([far, near])


def _check_record(before, after, done):
    assert np.array_equal(done.apply(before.vertices), after.vertices)
    origin = done.origin()
    old = origin >= 0
    assert np.array_equal(after.vertices[old], before.vertices[origin[old]])
    kept = np.flatnonzero(before.kept)
    assert np.isin(kept, origin).all()
    assert np.array_equal(after.fixed[old], before.fixed[origin[old]])
    assert not after.fixed[~old].any()
    if before.source >= 0:
        assert origin[after.source] == before.source


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), level=st.integers(1, 2))
def test_no_particle_changes_side_of_a_closed_surface(sphere, seed, level):
    rng = np.random.default_rng(seed)
    surface = sphere(level, rng.uniform(1.0, 2.5), rng)
    for _ in range(4):
        surface = _deformed(surface, rng)
        particles = _cloud(surface, rng)
        before = winding_number(particles, surface.vertices, surface.faces)
        faired, done = fair(surface, particles)
        after = winding_number(particles, faired.vertices, faired.faces)
        assert np.abs(after - before).max() < 1e-6
        _check_record(surface, faired, done)
        surface = faired


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), clearance=st.floats(0.0, 0.3))
def test_no_particle_loses_clearance(sphere, seed, clearance):
    rng = np.random.default_rng(seed)
    surface = _deformed(sphere(2, 2.0, rng), rng)
    particles = _cloud(surface, rng)
    faired, _ = fair(surface, particles, clearance=clearance)
    old, _, _ = nearest_on_mesh(particles, surface.vertices, surface.faces)
    new, _, _ = nearest_on_mesh(particles, faired.vertices, faired.faces)
    assert (new >= np.minimum(old, clearance) - 1e-9).all()


def test_a_closed_surface_stays_a_closed_sphere_through_many_operations(sphere, nobody):
    rng = np.random.default_rng(0)
    surface, operations = sphere(2, 2.0, rng), 0
    for _ in range(30):
        surface = _deformed(surface, rng)
        size = 5.0 / np.abs(surface.vertices).max()
        surface = Surface(
            size * surface.vertices, surface.faces, surface.fixed, surface.source
        )
        surface, done = fair(surface, nobody)
        operations += sum(n for k, n in done.counts.items() if "refused" not in k)
        assert is_manifold(surface.faces, len(surface.vertices))
        assert euler_number(surface.faces) == 2
        topology = build_topology(surface.faces, len(surface.vertices))
        assert topology.interior.all()
        assert topology.valence.min() >= 3
    assert operations > 1000


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_patch_keeps_its_rim_and_its_euler_number(grid, seed):
    rng = np.random.default_rng(seed)
    before = grid(8, 1.0, rng, 0.3)
    particles = rng.uniform([0, 0, -3], [8, 8, -1], (200, 3))
    after, done = fair(before, particles)
    _check_record(before, after, done)
    assert is_manifold(after.faces, len(after.vertices))
    assert euler_number(after.faces) == 1
    rims = []
    for surface, name in ((before, np.arange(81)), (after, done.origin())):
        topology = build_topology(surface.faces, len(surface.vertices))
        rim = np.sort(name[topology.edges[~topology.interior]], axis=1)
        rims.append(rim[np.lexsort(rim.T)])
    assert np.array_equal(*rims)


def test_an_unfolding_stalk_keeps_good_triangles(grid):
    # A ball of radius 1.6 under the source is lifted; the neck behind it is stretched.
    rng = np.random.default_rng(0)
    surface = grid(12)
    particles = rng.uniform([0, 0, -3], [12, 12, -0.3], (400, 3))
    for _ in range(100):
        centre = surface.vertices[surface.source] - [0, 0, 1.5]

        def lift(points, centre=centre):
            gap = np.maximum(np.linalg.norm(points - centre, axis=1) - 1.6, 0)
            return np.exp(-(gap**2) / 0.3)[:, None] * np.array([0.02, 0, 0.08])

        move = np.where(surface.fixed[:, None], 0.0, lift(surface.vertices))
        particles = particles + lift(particles)
        surface = Surface(
            surface.vertices + move, surface.faces, surface.fixed, surface.source
        )
        surface, _ = fair(surface, particles)
    triangles = surface.vertices[surface.faces]
    assert surface.vertices[:, 2].max() > 7.9
    assert radius_ratio(triangles).min() > 0.2
    assert areas(triangles).max() <= 0.75


def test_a_fair_surface_is_left_alone(grid, nobody):
    before = grid(5)
    after, done = fair(before, nobody)
    assert np.array_equal(after.faces, before.faces)
    assert not any(done.counts.values())


def test_a_recorded_fairing_replays_on_other_positions_of_any_kind(grid, nobody):
    before = grid(6, 1.0, np.random.default_rng(3), 0.3)
    _, done = fair(before, nobody)
    other = np.random.default_rng(4).normal(size=before.vertices.shape)
    replayed = done.apply(other)
    assert replayed.shape == (len(done.fixed), 3)
    on_device = done.apply(jnp.asarray(other.astype(np.float32)))
    assert np.array_equal(np.asarray(on_device), done.apply(other.astype(np.float32)))
    assert np.allclose(done.apply(2 * other), 2 * replayed, rtol=1e-15)


def test_the_phases_are_counted(grid, nobody):
    before = grid(8, 1.0, np.random.default_rng(3), 0.35)
    _, done = fair(before, nobody)
    for name in ("quaternary", "t_shape", "swapped", "collapsed"):
        assert done.counts[name] > 0
    assert "swap_refused_shape" in done.counts


def test_no_edge_is_left_to_swap_after_a_collapse(grid, nobody):
    after, done = fair(grid(8, 1.0, np.random.default_rng(3), 0.35), nobody)
    assert done.counts["collapsed"] > 0
    assert swap(after, nobody)[1].counts["swapped"] == 0


def test_bounds_without_room_between_them_are_refused(grid, nobody):
    with pytest.raises(ValueError, match="undo its own work"):
        fair(grid(2), nobody, max_area=0.3, min_area=0.1)


def test_a_surface_that_is_no_oriented_manifold_is_refused(grid, nobody):
    faces = grid(2).faces.copy()
    faces[0] = faces[0, ::-1]
    with pytest.raises(ValueError, match="oriented manifold"):
        fair(Surface(grid(2).vertices, faces, grid(2).fixed), nobody)


def test_the_equilateral_side_belongs_to_its_area():
    assert np.sqrt(3) / 4 * equilateral_side(0.7) ** 2 == pytest.approx(0.7)
