"""Operations that would make the surface cross itself or a wall are refused."""

import numpy as np
import pytest

from jaxgrow.mesh.collapse import collapse
from jaxgrow.mesh.fairing import fair
from jaxgrow.mesh.intersection import intersecting_pairs
from jaxgrow.mesh.intersection_guard import Crossing
from jaxgrow.mesh.particle_guard import Guard, Patches
from jaxgrow.mesh.repair import repair
from jaxgrow.mesh.subdivide import split_edges
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.swap import swap
from jaxgrow.mesh.topology import build_topology
from jaxgrow.mesh.triangle_pair import distances, facing


# The edge a-b at the bottom of a valley: flipping it to c-d makes a ridge 0.4 above.
A, B = np.array([-1.0, 0, 0]), np.array([1.0, 0, 0])
C, D = np.array([0.0, 1, 0.4]), np.array([0.0, -1, 0.4])
OLD = np.array([[A, B, C], [B, A, D]])
NEW = np.array([[A, D, C], [D, B, C]])
NOTHING = np.zeros((0, 3, 3))
UPRIGHT = np.eye(3)

# Enters the swept volume through one new triangle and leaves it through the other, with
# no corner inside.
BLADE = np.array([[-5.0, 0, 0.3], [5, 0, 0.3], [0, 0, 5]])


def _flip(turn=UPRIGHT, shift=(0.0, 0, 0), face=0):
    owner = np.zeros(2, dtype=np.int64)
    old, new = OLD @ turn + shift, NEW @ turn + shift
    return Patches(
        old, owner, face + np.arange(2), new, owner, (C @ turn + shift)[None]
    )


def _together(*flips):
    owner = np.repeat(np.arange(len(flips)), 2)
    return Patches(
        np.concatenate([flip.old for flip in flips]),
        owner,
        np.concatenate([flip.old_face for flip in flips]),
        np.concatenate([flip.new for flip in flips]),
        owner,
        np.concatenate([flip.apex for flip in flips]),
    )


def _admitted(*obstacles, gap=0.0, walls=False):
    other = np.array(obstacles).reshape(-1, 3, 3)
    surface = OLD if walls else np.concatenate([OLD, other])
    return bool(Crossing(surface, other if walls else NOTHING, gap).admits(_flip())[0])


@pytest.mark.parametrize("walls", [False, True], ids=["surface", "wall"])
@pytest.mark.parametrize(
    "obstacle, admitted",
    [
        (BLADE, False),
        ([[0.1, 0.1, 0.2], [0.1, 0.2, 3], [-0.2, 0.1, 3]], False),
        (BLADE + np.array([0, 0, 0.2]), True),
        (BLADE + np.array([0, 9, 0]), True),
        (BLADE * [1, 1, -1], True),
        (BLADE * [1, 1, -1] + [0, 0, 0.29], True),
    ],
    ids=["blade", "spike", "above", "beside", "below", "just below"],
)
def test_a_triangle_through_the_new_ones_refuses_the_operation(
    obstacle, admitted, walls
):
    assert _admitted(obstacle, walls=walls) == admitted


def test_the_particles_guard_does_not_see_an_edge_through_edges():
    nobody = np.zeros((0, 3))
    corners = np.concatenate([BLADE, OLD.reshape(-1, 3)])
    assert Guard(nobody, corners, 0.1).admits(_flip()).all()
    assert not _admitted(BLADE)


@pytest.mark.parametrize(
    "third, admitted",
    [([0.0, 0.5, 0.3], False), ([-0.5, 0.9, 0.4], True), ([0.0, 2, 0.4], True)],
    ids=["inwards", "aside", "away"],
)
def test_a_triangle_at_a_corner_may_not_go_through_the_new_ones(third, admitted):
    # Its second corner is above the ridge, the third one under it or elsewhere.
    assert _admitted([C, [0.1, -0.3, 0.8], third]) == admitted


@pytest.mark.parametrize("weights, admitted", [((0, 0, 1), False), ((2, 0, -1), True)])
def test_a_triangle_at_a_side_may_not_be_folded_onto_the_new_one(weights, admitted):
    inside = np.array([0.3, 0.3, 0.4]) @ NEW[0]
    a, d = NEW[0, 0], NEW[0, 1]
    tip = weights[0] * (a + d) / 2 + weights[2] * inside
    assert _admitted([d, a, tip], walls=True) == admitted


def test_the_same_three_corners_twice_are_refused():
    assert not _admitted(NEW[0][::-1])


def test_the_new_triangles_are_put_to_each_other():
    flat = _flip()
    folded = Patches(
        flat.old,
        flat.old_owner,
        flat.old_face,
        np.array([[A, D, C], [D, C, 0.9 * A + 0.1 * D]]),
        flat.new_owner,
        flat.apex,
    )
    assert Crossing(OLD, NOTHING, 0.0).admits(flat).all()
    assert not Crossing(OLD, NOTHING, 0.0).admits(folded).any()


def test_what_crossed_the_old_triangles_may_cross_as_many_new_ones():
    # Through both old triangles and both new ones; and through one and both.
    deep = np.array([[-5.0, 0.2, -0.1], [5, 0.2, -0.1], [0, 0.2, 5]])
    both = np.array([[0.1, -9, 0.3], [0.1, 9, 0.3], [0.1, 0, 5]])
    assert _admitted(deep) is False
    assert _admitted(both) is True
    assert _admitted(BLADE, both) is False


@pytest.mark.parametrize("walls", [False, True], ids=["surface", "wall"])
@pytest.mark.parametrize(
    "height, gap, admitted",
    [(0.43, 0.05, False), (0.46, 0.05, True), (0.43, 0.02, True), (0.9, 0.6, False)],
)
def test_no_facing_triangle_comes_nearer_than_the_gap(height, gap, admitted, walls):
    above = [[-0.3, -0.3, height], [-0.3, 0.3, height], [0.5, 0, height]]
    assert _admitted(above, gap=gap, walls=walls) == admitted


def test_a_triangle_that_does_not_face_them_may_be_nearer():
    above = [[-0.3, -0.3, 0.43], [0.5, 0, 0.43], [-0.3, 0.3, 0.43]]
    assert _admitted(above, gap=0.3)


def test_a_facing_triangle_that_was_as_near_before_refuses_nothing():
    # Under the valley; a and b stay as near to it as they are.
    below = [[-4.0, -4, -0.02], [-4, 4, -0.02], [8, 0, -0.02]]
    assert _admitted(below, gap=0.3)


def test_the_old_triangles_of_the_operation_itself_do_not_refuse_it():
    assert Crossing(OLD, NOTHING, 1.0).admits(_flip()).all()


def test_only_the_operation_that_crosses_is_refused():
    far = _flip(shift=np.array([20.0, 0, 0]), face=2)
    surface = np.concatenate([OLD, far.old])
    crossing = Crossing(surface, BLADE[None] + [20, 0, 0], 0.05)
    assert crossing.admits(_together(_flip(), far)).tolist() == [True, False]


def test_no_operations_are_admitted_without_looking():
    none = np.zeros(0, dtype=np.int64)
    nothing = Patches(NOTHING, none, none, NOTHING, none, np.zeros((0, 3)))
    crossing = Crossing(OLD, BLADE[None], 0.1)
    assert crossing.admits(nothing).shape == (0,)
    assert crossing.compatible(nothing).shape == (0,)
    assert "obstacles" not in vars(crossing)


# A second valley hangs upside down over the first one, across it: each flip alone
# leaves 0.4 less between them than there is, both together 0.8 less.
HANGING = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])


@pytest.mark.parametrize(
    "height, together",
    [(0.6, False), (0.82, False), (0.9, True)],
    ids=["crossing", "too near", "far enough"],
)
def test_of_two_operations_that_bar_each_other_the_better_is_done(height, together):
    both = _together(_flip(), _flip(HANGING, np.array([0, 0, height]), face=2))
    crossing = Crossing(both.old, NOTHING, 0.05)
    assert crossing.admits(both).all()
    assert crossing.compatible(both).tolist() == [True, together]


def test_an_operation_barred_by_one_that_is_barred_is_done():
    # Two narrow valleys under the hanging one, which is in the way of both.
    narrow = np.diag([0.5, 1.0, 1.0])
    left, right = (
        _flip(narrow, np.array([x, 0, 0]), face) for x, face in ((-0.6, 0), (0.6, 4))
    )
    hanging = _flip(HANGING, np.array([0, 0, 0.75]), face=2)
    for order, done in (
        ((left, hanging, right), [True, False, True]),
        ((hanging, left, right), [True, False, False]),
    ):
        three = _together(*order)
        in_order = np.argsort(three.old_face)
        crossing = Crossing(three.old[in_order], NOTHING, 0.0)
        assert crossing.admits(three).all()
        assert crossing.compatible(three).tolist() == done


# --- The operations themselves ----------------------------------------------


def _folded(n, gap, noise, rng):
    """A rough strip folded back over itself: its sheets are parallel everywhere.

    The triangles of the upper sheet are halves and quarters of those of the lower one.
    """
    y, x = np.mgrid[: n + 1, : 2 * n + 2]
    upper = x > n
    column = np.where(upper, 2 * n + 1 - x, x)
    height = np.where(column < n, noise * rng.normal(size=(n + 1, n + 1))[y, column], 0)
    lateral = 0.3 * rng.uniform(-1, 1, size=(2, n + 1, n + 1))
    inner = (column % n > 0) & (y % n > 0)
    dx, dy = (np.where(inner, part[y, column], 0.0) for part in lateral)
    z = height + gap * upper
    vertices = np.stack([column + dx, y + dy, z], axis=-1).reshape(-1, 3)
    index = np.arange(y.size).reshape(y.shape)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    # The diagonals of the upper sheet mirror those of the lower one.
    ways = ((a, b, c), (a, b, d)), ((a, c, d), (b, c, d))
    back = (x[:-1, :-1] > n).ravel()[:, None]
    faces = np.concatenate(
        [np.where(back, np.stack(v, 1), np.stack(u, 1)) for u, v in ways]
    )
    topology = build_topology(faces, len(vertices))
    surface = Surface(vertices, faces, topology.rim_vertices)
    marked = topology.interior & (topology.edges % (2 * n + 2) > n).all(axis=1)
    fine, _ = split_edges(surface, topology, marked)
    # No four corners in one plane.
    rough = 1e-3 * rng.normal(size=fine.vertices.shape) * ~fine.fixed[:, None]
    return Surface(fine.vertices + rough, fine.faces, fine.fixed)


def _crossings(surface, walls=NOTHING):
    """Intersecting pairs; walls share the surface's vertices where they coincide."""
    corners = np.concatenate([surface.vertices, walls.reshape(-1, 3)])
    more = len(surface.vertices) + np.arange(3 * len(walls)).reshape(-1, 3)
    unique, index = np.unique(corners, axis=0, return_inverse=True)
    faces = index.reshape(-1)[np.concatenate([surface.faces, more])]
    return sum(map(len, intersecting_pairs(unique, faces)))


def _parts(surface, chosen):
    """The chosen faces as a surface, and the others as walls."""
    used, index = np.unique(surface.faces[chosen], return_inverse=True)
    faces = index.reshape(-1, 3)
    rim = build_topology(faces, len(used)).rim_vertices
    part = Surface(surface.vertices[used], faces, rim)
    return part, surface.vertices[surface.faces[~chosen]]


def _lower(surface, n):
    """Faces of the lower sheet of a folded strip."""
    original = surface.faces < (n + 1) * (2 * n + 2)
    return (original & (surface.faces % (2 * n + 2) <= n)).all(axis=1)


def _anything(_, patches):
    return np.ones(len(patches.apex), dtype=bool)


OPERATIONS = {
    "swap": lambda *of, **walls: swap(*of, max_angle=1.2, **walls),
    "collapse": lambda *of, **walls: collapse(
        *of, min_area=0.7, min_edge=0.9, max_angle=1.2, **walls
    ),
    "repair": lambda *of, **walls: repair(*of, max_area=6.0, **walls),
    "fair": lambda *of, **walls: fair(*of, max_area=1.5, **walls),
}
DONE = {"swap": ("swapped",), "collapse": ("collapsed",), "repair": ("repaired",)}
DONE["fair"] = tuple(name for names in DONE.values() for name in names)


def _run(name, surface, **walls):
    """The surface after, how much was done, and how much of it was refused."""
    after, done = OPERATIONS[name](surface, np.zeros((0, 3)), **walls)
    words = [key for key in done.counts if key.endswith("_refused_intersection")]
    return (
        after,
        sum(done.counts[key] for key in DONE[name]),
        sum(done.counts[key] for key in words),
    )


@pytest.mark.parametrize("checked", [True, False], ids=["checked", "unchecked"])
@pytest.mark.parametrize("name", OPERATIONS)
def test_two_sheets_of_one_surface_never_cross(name, checked, monkeypatch):
    if not checked:
        monkeypatch.setattr(Crossing, "admits", _anything)
    crossings = operations = refusals = 0
    for seed in range(2):
        before = _folded(6, 0.3, 1.0, np.random.default_rng(seed))
        assert _crossings(before) == 0
        after, done, refused = _run(name, before)
        crossings += _crossings(after)
        operations += done
        refusals += refused
    assert operations > 0
    assert (crossings == 0) == checked
    # Repairs are counted as refused if none is left that can be done.
    assert (refusals > 0) == checked or name == "repair"


@pytest.mark.parametrize("checked", [True, False], ids=["walls", "no walls"])
@pytest.mark.parametrize("name", OPERATIONS)
def test_a_wall_that_shares_the_rim_is_never_crossed(name, checked):
    crossings = operations = refusals = 0
    for seed in range(4):
        strip = _folded(6, 0.3, 1.0, np.random.default_rng(seed))
        before, walls = _parts(strip, _lower(strip, 6))
        assert _crossings(before, walls) == 0
        given = {"walls": walls} if checked else {}
        after, done, refused = _run(name, before, **given)
        crossings += _crossings(after, walls)
        operations += done
        refusals += refused
    assert operations > 0
    assert (crossings == 0) == checked
    assert (refusals > 0) == checked


def _facing_valleys(diamond, name, height):
    """A valley and one that hangs over it across; an edge of each is to become a ridge.

    For a collapse it has a vertex in the middle, which goes to the slope beside it.
    """
    low = diamond([-1, 0, 0], [1, 0, 0], [0, 0.6, 0.2], [0, -0.6, 0.2])
    vertices, faces, count = low.vertices, low.faces, 8
    if name == "collapse":
        vertices, count = np.concatenate([vertices, [[0.0, 0, 0]]]), 9
        halves = [[0, 8, 2], [8, 1, 2], [1, 8, 3], [8, 0, 3]]
        faces = np.concatenate([halves, faces[2:]])
    high = vertices @ HANGING + [0, 0, height]
    return Surface(
        np.concatenate([vertices, high]),
        np.concatenate([faces, faces + count]),
        np.tile((np.arange(count) < 8), 2),
    )


@pytest.mark.parametrize("checked", [True, False], ids=["checked", "unchecked"])
@pytest.mark.parametrize("name", ["swap", "collapse"])
def test_operations_of_one_round_do_not_cross_each_other(
    diamond, name, checked, monkeypatch
):
    if not checked:
        monkeypatch.setattr(Crossing, "compatible", _anything)
    before = _facing_valleys(diamond, name, 0.35)
    assert _crossings(before) == 0
    how = {"swap": {}, "collapse": {"min_area": 0.0, "min_edge": 0.7}}[name]
    operation = {"swap": swap, "collapse": collapse}[name]
    after, done = operation(before, np.zeros((0, 3)), **how)
    assert done.counts[DONE[name][0]] == (1 if checked else 2)
    assert (_crossings(after) == 0) == checked
    if checked:
        assert done.counts[f"{name}_refused_intersection"] > 0
    far = _facing_valleys(diamond, name, 0.5)
    assert operation(far, np.zeros((0, 3)), **how)[1].counts[DONE[name][0]] == 2


def _nearest(surface, walls, *, opposed):
    """Least distance between the surface and walls, of those that face it or of all."""
    triangles = surface.vertices[surface.faces]
    one = np.repeat(triangles, len(walls), axis=0)
    other = np.tile(walls, (len(triangles), 1, 1))
    asked = facing(one, other) if opposed else np.ones(len(one), dtype=bool)
    return distances(one[asked], other[asked]).min()


@pytest.mark.parametrize("checked", [True, False], ids=["gap", "no gap"])
@pytest.mark.parametrize("name", ["swap", "collapse", "fair"])
def test_facing_walls_come_no_nearer_than_the_gap_or_than_they_were(name, checked):
    floor, operations = [], 0
    for seed in range(3):
        strip = _folded(6, 0.4, 0.7, np.random.default_rng(seed))
        before, walls = _parts(strip, _lower(strip, 6))
        walls = walls[walls[:, :, 0].max(axis=1) < 5.0]
        after, done, _ = _run(name, before, walls=walls, gap=0.3 if checked else 0.0)
        was = _nearest(before, walls, opposed=False)
        floor.append(_nearest(after, walls, opposed=True) - min(0.3, was))
        operations += done
    assert operations > 0
    assert (min(floor) >= -1e-12) == checked


@pytest.mark.parametrize("name", ["swap", "collapse", "fair"])
def test_neighbours_in_the_plane_refuse_nothing_whatever_the_gap(grid, name):
    rng = np.random.default_rng(0)
    before = grid(10, 0.7)
    shift = 0.12 * rng.normal(size=before.vertices.shape) * [1, 1, 0]
    vertices = before.vertices + shift * ~before.fixed[:, None]
    flat = Surface(vertices, before.faces, before.fixed)
    _, done, refused = _run(name, flat, gap=100.0)
    assert done > 10
    assert refused == 0


@pytest.mark.parametrize("name", ["swap", "collapse", "fair"])
def test_neighbours_on_a_sphere_refuse_nothing(sphere, name):
    rng = np.random.default_rng(0)
    before = sphere(2, 3.0)
    moved = before.vertices + 0.15 * rng.normal(size=before.vertices.shape)
    round_ = 3.0 * moved / np.linalg.norm(moved, axis=1)[:, None]
    surface = Surface(round_, before.faces, before.fixed)
    assert _crossings(surface) == 0
    after, done, refused = _run(name, surface, gap=0.5)
    assert done > 5
    assert refused == 0
    assert _crossings(after) == 0
