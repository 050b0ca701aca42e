"""Random operations on random surfaces under random particles break nothing.

What is checked shares no code with what is tested: intersections are found with exact
integer arithmetic, sides of particles by winding numbers.
"""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, Phase, settings, strategies as st

from jaxgrow.mesh.audit import audit_surface
from jaxgrow.mesh.collapse import collapse
from jaxgrow.mesh.fairing import fair
from jaxgrow.mesh.intersection_guard import Crossing
from jaxgrow.mesh.particle_guard import Guard
from jaxgrow.mesh.repair import repair
from jaxgrow.mesh.subdivide import split_edges, subdivide
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.swap import swap
from jaxgrow.mesh.topology import build_topology, euler_number, is_manifold
from jaxgrow.mesh.winding import winding_number

from .exact_intersection import exact_crossings


DEFECTS = ("non_manifold_edges", "non_manifold_vertices", "misoriented_edges")
DEFECTS += ("degenerate_faces", "duplicate_faces", "folded_edges", "invalid_faces")


# --- The exact check ----------------------------------------------------------


TRIANGLE = [[0.0, 0, 0], [4, 0, 0], [0, 4, 0]]


@pytest.mark.parametrize(
    "other, expected",
    [
        ([[1.0, 1, -1], [1, 1, 1], [9, 9, 1]], 1),
        ([[1.0, 1, 0], [1, 1, 1], [9, 9, 1]], 1),
        ([[1.0, 1, 1e-300], [1, 1, 1], [9, 9, 1]], 0),
        ([[1.0, 1, 0], [2, 1, 0], [1, 2, 0]], 1),
        ([[-1.0, 1, 0], [9, 1, 0], [9, 2, 0]], 1),
        ([[4.0, 4, 0], [5, 4, 0], [4, 5, 0]], 0),
        ([[0.0, 0, 0], [1, 1, -1], [1, 1, 1]], 1),
        ([[0.0, 0, 0], [-1, 1, -1], [-1, 1, 1]], 0),
        ([[0.0, 0, 0], [-4, 0, 0], [0, -4, 0]], 0),
        ([[0.0, 0, 0], [4, 0, 0], [1, 1, 0]], 1),
        ([[0.0, 0, 0], [4, 0, 0], [1, -1, 0]], 0),
        ([[0.0, 0, 0], [4, 0, 0], [1, 1, 1e-9]], 0),
        (TRIANGLE, 1),
    ],
)
def test_the_exact_check_knows_what_meets(other, expected):
    surface = Surface(
        np.array(TRIANGLE), np.array([[0, 1, 2]]), np.zeros(3, dtype=bool)
    )
    assert exact_crossings(surface, np.array([other])) == expected


# --- Surfaces -----------------------------------------------------------------


def _lattice(n, m):
    """Vertices of a lattice in [0, 1]² and its faces."""
    y, x = np.mgrid[: n + 1, : m + 1]
    index = np.arange(x.size).reshape(x.shape)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([x.ravel() / m, y.ravel() / n], axis=1), faces


def _dome(rng):
    """A noisy dome on a square, with its base around it as walls."""
    n = int(rng.integers(6, 10))
    plane, faces = _lattice(n, n)
    radius = np.linalg.norm(2 * plane - 1, axis=1)
    height = rng.uniform(0.5, 4.0) * np.exp(-((radius / 0.45) ** 2))
    vertices = np.column_stack([n * 0.9 * plane, height])
    return vertices, faces, np.all(np.abs(2 * plane - 1) < 0.9, axis=1)


def _mushroom(rng):
    """A cap over a narrow stalk: its lower sheet is close to the surface around."""
    n = int(rng.integers(8, 11))
    plane, faces = _lattice(n, n)
    square = 2 * plane - 1
    radius = np.abs(square).max(axis=1)
    angle = np.arctan2(square[:, 1], square[:, 0])
    gap, cap = rng.uniform(0.1, 0.4), rng.uniform(1.6, 2.4)
    # Radius and height along the profile, from the pole to the rim.
    along = np.array([0, 0.3, 0.45, 0.6, 0.7, 1.0])
    r = np.interp(radius, along, [0, cap, cap, 0.8, 0.8, 4.5])
    z = np.interp(radius, along, [gap + 1.5, gap + 1.0, gap, gap, 0.0, 0.0])
    vertices = np.column_stack([r * np.cos(angle), r * np.sin(angle), z])
    return vertices, faces, radius < 0.95


def _folded(rng):
    """A strip that lies back and forth over itself, its sheets equally rough."""
    n, sheets = int(rng.integers(4, 6)), int(rng.integers(2, 4))
    last = (n + 1) * sheets - 1
    plane, faces = _lattice(n, last)
    step, row = np.round(plane * [last, n]).astype(int).T
    sheet, column = step // (n + 1), step % (n + 1)
    back = sheet % 2 == 1
    column = np.where(back, n - column, column)
    # The diagonals of a sheet mirror those of the one below, so they are parallel.
    turned = back[faces].any(axis=1)
    for one, two in zip(*np.split(np.flatnonzero(turned), 2), strict=True):
        a, b, c, d = *faces[one], faces[two][2]
        faces[one], faces[two] = (a, b, d), (b, c, d)
    inside = (column > 0) & (column < n) & (row > 0) & (row < n)
    move = rng.normal(size=(n + 1, n + 1, 3)) * [0.15, 0.15, rng.uniform(0.0, 1.0)]
    flat = np.column_stack([column, row, rng.uniform(0.1, 0.5) * sheet])
    vertices = flat + inside[:, None] * move[row, column]
    inner = (step > 0) & (step < last) & (row > 0) & (row < n)
    return 0.9 * vertices, faces, inner


def _ball(rng):
    """A closed box lattice blown up to a ball, and dented from both sides."""
    n = int(rng.integers(3, 5))
    plane, quads = _lattice(n, n)
    square = 2 * plane - 1
    turns = [(0, 1, 2), (1, 2, 0), (2, 0, 1)]
    parts, faces = [], []
    for axis, turn in enumerate(turns):
        for side in (-1.0, 1.0):
            face = np.column_stack([square, np.full(len(square), side)])
            faces.append(quads[:, :: int(side)] + len(square) * len(parts))
            parts.append(face[:, np.argsort(turn)])
            assert (parts[-1][:, turns[axis][2]] == side).all()
    vertices, index = np.unique(
        np.round(np.concatenate(parts), 9), axis=0, return_inverse=True
    )
    faces = index.reshape(-1)[np.concatenate(faces)]
    vertices = vertices / np.linalg.norm(vertices, axis=1)[:, None]
    wide = np.linalg.norm(vertices[:, :2], axis=1)
    dent = 1.0 - rng.uniform(0.5, 0.95) * np.exp(-((wide / 0.6) ** 2))
    vertices = vertices * np.stack([1 + 0 * wide, 1 + 0 * wide, dent], axis=1)
    return 2.0 * vertices, faces, np.ones(len(vertices), dtype=bool)


SHAPES = {"dome": _dome, "mushroom": _mushroom, "folded": _folded, "ball": _ball}


def _roughened(surface, walls, amount, rng):
    """The surface with moved vertices, as much as it can be without a crossing."""
    move = rng.normal(size=surface.vertices.shape) * ~surface.fixed[:, None]
    for _ in range(4):
        rough = Surface(
            surface.vertices + amount * move,
            surface.faces,
            surface.fixed,
            surface.source,
        )
        if not exact_crossings(rough, walls):
            return rough
        amount *= 0.4
    return surface


def _scene(shape, rng):
    """A patch, walls around it that share its rim, and how it is closed."""
    vertices, faces, inner = SHAPES[shape](rng)
    live = inner[faces].any(axis=1)
    used, index = np.unique(faces[live], return_inverse=True)
    patch = index.reshape(-1, 3)
    topology = build_topology(patch, len(used))
    fixed = topology.rim_vertices | (rng.random(len(used)) < 0.05)
    free = np.flatnonzero(~fixed)
    source = int(rng.choice(free)) if rng.random() < 0.5 else -1
    return Surface(vertices[used], patch, fixed, source), vertices[faces[~live]]


def _refined(surface, rng):
    """The same surface in other triangles: some edges are split."""
    topology = build_topology(surface.faces, len(surface.vertices))
    marked = topology.interior & (rng.random(len(topology.edges)) < 0.5)
    return split_edges(surface, topology, marked)[0]


def _lid(surface, rng):
    """A wall just over a dome, parallel to it, face down."""
    lid = _refined(surface, rng)
    return lid.vertices[lid.faces[:, ::-1]] + [0, 0, rng.uniform(0.05, 0.3)]


def _closed(surface):
    """Faces of the surface and of a fan from a far point over its rim."""
    topology = build_topology(surface.faces, len(surface.vertices))
    rim = ~topology.interior
    forward = topology.edge_faces[rim, 0] >= 0
    edges = topology.edges[rim]
    edges = np.where(forward[:, None], edges[:, ::-1], edges)
    apex = np.full((len(edges), 1), len(surface.vertices))
    vertices = np.concatenate([surface.vertices, [[0.3, -0.2, -50.0]]])
    return vertices, np.concatenate([surface.faces, np.hstack([edges, apex])])


def _cloud(surface, rng):
    """Particles around the surface, many of them very near to it."""
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    far = rng.uniform(low - 0.5, high + 0.5, (60, 3))
    face = surface.faces[rng.integers(len(surface.faces), size=60)]
    weights = rng.dirichlet([1.0, 1.0, 1.0], 60)
    near = np.einsum("nk,nki->ni", weights, surface.vertices[face])
    width = rng.choice([0.02, 0.1, 0.4], (60, 1))
    return np.concatenate([far, near + width * rng.normal(size=near.shape)])


# --- Operations ---------------------------------------------------------------


def _operate(name, surface, particles, walls, rng):
    """One operation with random thresholds."""
    bounds = {
        "walls": walls,
        "clearance": rng.uniform(0.0, 0.3),
        "gap": rng.choice([0.0, 0.05, 0.2]),
    }
    max_area = rng.uniform(0.4, 1.5)
    min_area = rng.uniform(0.0, 0.25) * max_area
    if name == "subdivide":
        return subdivide(surface, max_area, rng.choice([1.0, np.inf]))
    if name == "swap":
        angle = rng.uniform(0.3, 1.5)
        return swap(surface, particles, max_angle=angle, **bounds)
    if name == "collapse":
        angle, edge = rng.uniform(0.3, 1.5), rng.uniform(0.0, 1.0)
        return collapse(
            surface,
            particles,
            min_area=2 * min_area,
            min_edge=edge,
            max_angle=angle,
            **bounds,
        )
    if name == "repair":
        return repair(surface, particles, max_area=5.0, **bounds)
    return fair(surface, particles, max_area=max_area, min_area=min_area, **bounds)


def _check(before, after, particles, walls):
    """Nothing crosses, and the surface is what it was, topologically."""
    assert exact_crossings(after, walls) == 0, "triangles cross"
    sides = [winding_number(particles, *_closed(s)) for s in (before, after)]
    assert np.abs(sides[1] - sides[0]).max() < 1e-6, "a particle changed sides"
    assert is_manifold(after.faces, len(after.vertices))
    assert euler_number(after.faces) == euler_number(before.faces)
    audits = [audit_surface(s.vertices, s.faces) for s in (before, after)]
    flawed = [{name for name in DEFECTS if getattr(a, name)} for a in audits]
    assert flawed[1] <= flawed[0]
    rims = []
    for surface in (before, after):
        topology = build_topology(surface.faces, len(surface.vertices))
        ends = surface.vertices[topology.edges[~topology.interior]]
        rims.append({frozenset(map(tuple, pair)) for pair in ends.tolist()})
    assert rims[0] == rims[1]


def _explore(examples, phases=(Phase.explicit, Phase.reuse, Phase.generate)):
    """Run random sequences on random scenes; what was done and refused, in all."""
    counts = Counter()
    names = st.sampled_from(["subdivide", "swap", "collapse", "repair", "fair"])

    @settings(
        max_examples=examples,
        derandomize=True,
        deadline=None,
        phases=phases,
        report_multiple_bugs=False,
    )
    @given(
        shape=st.sampled_from(sorted(SHAPES)),
        seed=st.integers(0, 2**32 - 1),
        sequence=st.lists(names, min_size=2, max_size=5),
        noise=st.floats(0.0, 0.5),
        refined=st.booleans(),
    )
    def run(shape, seed, sequence, noise, refined):
        rng = np.random.default_rng(seed)
        surface, walls = _scene(shape, rng)
        surface = _roughened(surface, walls, noise, rng)
        if refined:
            surface = _refined(surface, rng)
        if shape == "dome":
            walls = np.concatenate([walls, _lid(surface, rng)])
        if exact_crossings(surface, walls):
            counts["skipped"] += 1
            return
        for name in sequence:
            particles = _cloud(surface, rng)
            after, done = _operate(name, surface, particles, walls, rng)
            counts.update(done.counts)
            counts["calls"] += 1
            _check(surface, after, particles, walls)
            surface = _roughened(after, walls, 0.1 * rng.random(), rng)

    run()
    return counts


def test_random_operations_never_cross_anything():
    counts = _explore(16)
    assert counts["skipped"] < 6
    for name in ("quaternary", "t_shape", "swapped", "collapsed", "repaired"):
        assert counts[name] > 20
    for name in ("swap", "collapse"):
        assert counts[f"{name}_refused_intersection"] > 0
        assert counts[f"{name}_refused_particle"] > 0


@pytest.mark.slow
def test_many_random_operations_never_cross_anything():
    counts = _explore(200)
    assert counts["swapped"] + counts["collapsed"] + counts["repaired"] > 4_000


def _anything(_, patches):
    return np.ones(len(patches.apex), dtype=bool)


@pytest.mark.parametrize(
    "guard, harm",
    [(Crossing, "triangles cross"), (Guard, "a particle changed sides")],
    ids=["crossing", "guard"],
)
def test_the_search_finds_what_happens_without_a_guard(guard, harm, monkeypatch):
    monkeypatch.setattr(guard, "admits", _anything)
    with pytest.raises(AssertionError, match=harm):
        _explore(60, phases=[Phase.generate])
