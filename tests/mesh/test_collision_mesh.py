"""Sheets: what is near, what is one sheet, and how walls join a surface."""

import numpy as np
import pytest

from jaxgrow.mesh.collision_mesh import encounters, join, nearest_apart, Walls
from jaxgrow.mesh.proximity import closest_on_segments, closest_on_triangles
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.topology import build_topology


def strip(length, *, width=3, spacing=1.0, bend=None):
    """A strip of squares cut into triangles, along x, bent by a map of its vertices."""
    x, y = np.meshgrid(np.arange(length), np.arange(width), indexing="ij")
    vertices = spacing * np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(float)
    index = np.arange(length * width).reshape(length, width)
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    if bend is not None:
        vertices = bend(vertices)
    return Surface(vertices, faces, np.zeros(len(vertices), bool))


def folded(gap):
    """A strip turned back over itself at a distance."""

    def bend(v):
        over = v[:, 0] > 5
        x = np.where(over, 10 - v[:, 0] + 0.3, v[:, 0])
        return np.stack([x, v[:, 1], np.where(over, gap, 0.0)], axis=1)

    return strip(11, bend=bend)


def sheet_of(surface):
    return join(surface, np.full(len(surface.vertices), -1), None, 0.0)


def test_flat_strip_is_apart_from_nothing():
    sheet = sheet_of(strip(12, spacing=0.6))
    assert nearest_apart(sheet, within=1.0, along=1.5) == np.inf
    found = encounters(sheet, apart=1.0, local=0.7, along=1.5)
    assert not found.vertex_apart.any()
    assert not found.edge_apart.any()
    assert len(found.vertex) > 0


def test_folded_strip_is_apart_from_itself_by_its_gap():
    sheet = sheet_of(folded(0.4))
    np.testing.assert_allclose(nearest_apart(sheet, within=0.5, along=1.5), 0.4)


def test_gap_beyond_what_is_asked_for_is_infinite():
    assert nearest_apart(sheet_of(folded(0.4)), within=0.39, along=1.5) == np.inf


def brute(sheet, apart, local, along):
    """All pairs by loops over everything."""
    edges = build_topology(sheet.faces, len(sheet.vertices)).edges
    n = len(sheet.vertices)
    path = np.full((n, n), np.inf)
    np.fill_diagonal(path, 0)
    for a, b in edges:
        path[a, b] = path[b, a] = np.linalg.norm(sheet.vertices[a] - sheet.vertices[b])
    for k in range(n):
        path = np.minimum(path, path[:, k : k + 1] + path[k : k + 1])
    joined = path <= along
    points, lines = set(), set()
    for v in range(n):
        for face in sheet.faces:
            if v in face or not sheet.moving[[v, *face]].any():
                continue
            corner = sheet.vertices[face][None]
            gap = closest_on_triangles(sheet.vertices[v][None], corner)[0][0]
            far = not joined[v, face].any()
            if gap < (apart if far else local):
                points.add((v, *face.tolist(), far))
    for i, one in enumerate(edges):
        for other in edges[:i]:
            four = [*one.tolist(), *other.tolist()]
            if len(set(four)) < 4 or not sheet.moving[four].any():
                continue
            ends = sheet.vertices[one][None], sheet.vertices[other][None]
            gap = closest_on_segments(*ends)[0][0]
            far = not joined[np.ix_(one, other)].any()
            if gap < (apart if far else local):
                lines.add((frozenset(map(frozenset, (one, other))), far))
    return points, lines


@pytest.mark.parametrize("seed", [0, 1])
def test_encounters_are_all_pairs_of_a_brute_force_search(seed):
    rng = np.random.default_rng(seed)
    surface = folded(0.5)
    vertices = surface.vertices + 0.1 * rng.normal(size=surface.vertices.shape)
    surface = Surface(vertices, surface.faces, np.arange(len(vertices)) < 6)
    sheet = sheet_of(surface)
    found = encounters(sheet, apart=0.9, local=0.6, along=1.5)
    points, lines = brute(sheet, 0.9, 0.6, 1.5)
    assert any(far for *_, far in points)
    assert not all(far for *_, far in points)
    rows = zip(found.vertex, found.corners, found.vertex_apart, strict=True)
    assert {(int(v), *c.tolist(), bool(far)) for v, c, far in rows} == points
    assert len(found.vertex) == len(points)
    rows = zip(found.edges, found.edge_apart, strict=True)
    got = {
        (frozenset((frozenset(e[:2]), frozenset(e[2:]))), bool(far)) for e, far in rows
    }
    assert got == lines
    assert len(found.edges) == len(lines)
    assert np.all(np.diff(found.vertex) >= 0)


def test_distances_are_those_of_the_pairs():
    sheet = sheet_of(folded(0.4))
    found = encounters(sheet, apart=0.9, local=0.6, along=1.5)
    corners = sheet.vertices[found.corners]
    wanted, _ = closest_on_triangles(sheet.vertices[found.vertex], corners)
    np.testing.assert_allclose(found.vertex_distance, wanted, rtol=1e-12)
    ends = sheet.vertices[found.edges]
    wanted, _, _ = closest_on_segments(ends[:, :2], ends[:, 2:])
    np.testing.assert_allclose(found.edge_distance, wanted, rtol=1e-12)


def patch_and_walls():
    """The middle of a strip as a surface, and its two ends as walls."""
    whole = strip(12)
    middle = np.all((whole.faces >= 9) & (whole.faces < 27), axis=1)
    names, flat = np.unique(whole.faces[middle], return_inverse=True)
    inner = Surface(whole.vertices[names], flat.reshape(-1, 3), np.isin(names, [9, 26]))
    rest = whole.faces[~middle]
    wall_names, flat = np.unique(rest, return_inverse=True)
    walls = Walls(whole.vertices[wall_names], flat.reshape(-1, 3), wall_names)
    return whole, inner, names, walls


def test_walls_share_the_rim_with_the_surface():
    whole, inner, names, walls = patch_and_walls()
    sheet = join(inner, names, walls, 100.0)
    assert len(sheet.vertices) == len(whole.vertices)
    assert len(sheet.faces) == len(whole.faces)
    topology = build_topology(sheet.faces, len(sheet.vertices))
    before = build_topology(whole.faces, len(whole.vertices))
    assert topology.interior.sum() == before.interior.sum()


def test_walls_do_not_move():
    _, inner, names, walls = patch_and_walls()
    sheet = join(inner, names, walls, 100.0)
    np.testing.assert_array_equal(sheet.moving[: sheet.n_surface], ~inner.fixed)
    assert not sheet.moving[sheet.n_surface :].any()


def test_walls_far_away_are_left_out():
    _, inner, names, walls = patch_and_walls()
    sheet = join(inner, names, walls, 0.5)
    far = (walls.vertices[:, 0] < 2) | (walls.vertices[:, 0] > 9)
    assert far.any()
    kept = {tuple(v) for v in sheet.vertices}
    assert not kept & {tuple(v) for v in walls.vertices[far]}
    np.testing.assert_array_equal(sheet.vertices[: sheet.n_surface], inner.vertices)


def test_surface_that_goes_through_a_wall_intersects():
    spike = np.array([[0.5, 0.5, -1.0], [0.6, 0.5, 1.0], [0.5, 0.6, 1.0]])
    surface = Surface(spike, np.array([[0, 1, 2]]), np.zeros(3, bool))
    plate = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]])
    walls = Walls(plate, np.array([[0, 1, 2]]), np.arange(3))
    sheet = join(surface, np.full(3, -1), walls, 1.0)
    assert len(sheet.self_intersections()) == 1


def test_walls_that_intersect_themselves_are_not_the_surface_s_fault():
    plate = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]])
    spike = np.array([[0.5, 0.5, -1.0], [0.6, 0.5, 1.0], [0.5, 0.6, 1.0]])
    walls = Walls(
        np.concatenate([plate, spike]), np.array([[0, 1, 2], [3, 4, 5]]), np.arange(6)
    )
    apart = np.array([[0.1, 0.1, 0.2], [0.3, 0.1, 0.2], [0.1, 0.3, 0.2]])
    surface = Surface(apart, np.array([[0, 1, 2]]), np.zeros(3, bool))
    sheet = join(surface, np.full(3, -1), walls, 5.0)
    assert len(sheet.faces) == 3
    assert len(sheet.self_intersections()) == 0


def test_segments_are_as_far_apart_as_a_search_says():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 30, 2, 3))
    second[:4, 1] = second[:4, 0] + 0.5 * (first[:4, 1] - first[:4, 0])
    second[4] = second[4, :1]
    distance, s, t = closest_on_segments(first, second)
    grid = np.linspace(0, 1, 201)
    p = first[:, None, 0] + grid[:, None] * (first[:, None, 1] - first[:, None, 0])
    q = second[:, None, 0] + grid[:, None] * (second[:, None, 1] - second[:, None, 0])
    search = np.linalg.norm(p[:, :, None] - q[:, None], axis=-1).min(axis=(1, 2))
    assert np.all(distance <= search + 1e-12)
    np.testing.assert_allclose(distance, search, atol=0.02)
    foot = first[:, 0] + s[:, None] * (first[:, 1] - first[:, 0])
    other = second[:, 0] + t[:, None] * (second[:, 1] - second[:, 0])
    np.testing.assert_allclose(np.linalg.norm(foot - other, axis=1), distance)
