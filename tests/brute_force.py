"""What host loops find, by NumPy over all pairs: slow, simple, and no code in common.

`TOUCH` apart, nothing here is the package's; what the package tells in a stated order
is told in that order here.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from jaxgrow.mesh.intersection import TOUCH


def dot(a, b):
    return np.einsum("...i,...i->...", a, b)


def shares(points, start, end):
    """Where on segments, from 0 to 1, points are nearest."""
    side = end - start
    square = dot(side, side)
    along = dot(points - start, side) / np.where(square > 0, square, 1.0)
    return np.clip(along, 0.0, 1.0)


def to_triangles(points, triangles):
    """Distance of point i to triangle i, and the weights of its corners at the foot."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    rows = np.arange(len(points))
    best, weights = np.full(len(points), np.inf), np.zeros((len(points), 3))
    for i, (p, q) in enumerate(((a, b), (b, c), (c, a))):
        t = shares(points, p, q)
        gap = points - p - t[:, None] * (q - p)
        hit = rows[dot(gap, gap) < best]
        best[hit] = dot(gap, gap)[hit]
        weights[hit] = 0.0
        weights[hit, i], weights[hit, (i + 1) % 3] = 1.0 - t[hit], t[hit]
    normal = np.cross(b - a, c - a)
    square = dot(normal, normal)
    area = np.where(square > 0, square, 1.0)
    sides = ((b, c), (c, a), (a, b))
    inner = [dot(np.cross(p - points, q - points), normal) / area for p, q in sides]
    inner = np.stack(inner, axis=1)
    height = dot(points - a, normal) / np.sqrt(area)
    inside = (square > 0) & (inner > 0).all(axis=1) & (height**2 <= best)
    inner = inner / np.where(inside, inner.sum(axis=1), 1.0)[:, None]
    distance = np.where(inside, np.abs(height), np.sqrt(best))
    return distance, np.where(inside[:, None], inner, weights)


def of_segments(first, second):
    """Distance of segment i of one list to segment i of the other, and the shares."""
    (a, b), (c, d) = first.transpose(1, 0, 2), second.transpose(1, 0, 2)
    one, other, gap = b - a, d - c, c - a
    square, along, square_other = dot(one, one), dot(one, other), dot(other, other)
    determinant = square * square_other - along**2
    skew = determinant > 64 * np.finfo(float).eps * square * square_other
    scale = np.where(skew, determinant, 1.0)
    s = (dot(one, gap) * square_other - dot(other, gap) * along) / scale
    t = (dot(one, gap) * along - dot(other, gap) * square) / scale
    inside = skew & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    zero = np.zeros(len(a))
    tries = [
        (np.where(inside, s, 0.0), np.where(inside, t, shares(a, c, d))),
        (zero, shares(a, c, d)),
        (zero + 1, shares(b, c, d)),
        (shares(c, a, b), zero),
        (shares(d, a, b), zero + 1),
    ]
    gaps = [gap + t[:, None] * other - s[:, None] * one for s, t in tries]
    best = np.argmin([dot(g, g) for g in gaps], axis=0)
    s, t, square = (
        np.choose(best, x)
        for x in (*zip(*tries, strict=True), [dot(g, g) for g in gaps])
    )
    return np.sqrt(square), s, t


def nearest(points, vertices, faces):
    """Distances of all points (rows) to all faces (columns)."""
    triangles = np.tile(vertices[faces], (len(points), 1, 1))
    pairs = np.repeat(points, len(faces), axis=0)
    return to_triangles(pairs, triangles)[0].reshape(len(points), len(faces))


def meet(one, other):
    """Whether triangle i of one list meets triangle i of the other.

    They do not if a direction separates them: a normal, a cross product of two sides,
    or one of a side and a normal.
    """
    origin = one[:, :1]
    one, other = one - origin, other - origin
    size = np.maximum(np.abs(one), np.abs(other)).max(axis=(1, 2), initial=0.0)
    size = np.where(size > 0, size, 1.0)[:, None, None]
    one, other = one / size, other / size
    sides = [np.roll(triangle, -1, axis=1) - triangle for triangle in (one, other)]
    normals = [np.cross(side[:, 0], side[:, 1]) for side in sides]
    flat = [(np.abs(n).max(axis=1, initial=0.0) == 0)[:, None] for n in normals]
    # a segment has no normal: in the plane of the other triangle it needs that one
    planes = [np.where(flat[k], normals[1 - k], normals[k]) for k in range(2)]
    axes = [*normals]
    for k in range(3):
        axes += [np.cross(planes[i], sides[i][:, k]) for i in range(2)]
        axes += [np.cross(sides[0][:, k], sides[1][:, j]) for j in range(3)]
    apart = np.zeros(len(one), bool)
    for axis in axes:
        length = np.linalg.norm(axis, axis=1)
        axis = axis / np.where(length > 1e-12, length, 1.0)[:, None]
        left, right = (dot(t, axis[:, None]) for t in (one, other))
        below, above = left.max(axis=1), right.max(axis=1)
        gap = np.maximum(left.min(axis=1) - above, right.min(axis=1) - below)
        apart |= (length > 1e-12) & (gap > TOUCH)
    return ~apart


def intersecting(vertices, faces, first=None):
    """Pairs of faces that meet; those that share no vertex, those that share one.

    Their boxes, and spheres around these, meet too: no direction of `meet` parts two
    segments on parallel lines.
    """
    i, j = np.triu_indices(len(faces), 1)
    corners = vertices[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    middle = 0.5 * (low + high)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1, initial=0.0)
    slack = TOUCH * (high - low)[i].max(axis=1)
    kept = i < (len(faces) if first is None else first)
    kept &= np.maximum(low[i] - high[j], low[j] - high[i]).max(axis=1) <= slack
    away = np.linalg.norm(middle[i] - middle[j], axis=1)
    kept &= away <= (radius[i] + radius[j]) * (1 + TOUCH)
    pairs = np.stack([i, j], axis=1)[kept]
    same = faces[pairs[:, 0]][:, :, None] == faces[pairs[:, 1]][:, None, :]
    shared = same.sum(axis=(1, 2))
    free, hinged, same = pairs[shared == 0], pairs[shared == 1], same[shared == 1]
    met = np.zeros(len(hinged), bool)
    for mine, its, at in ((0, 1, same.any(axis=2)), (1, 0, same.any(axis=1))):
        corner, rows = at.argmax(axis=1), np.arange(len(hinged))
        triangle = vertices[faces[hinged[:, mine]]]
        p, q = triangle[rows, (corner + 1) % 3], triangle[rows, (corner + 2) % 3]
        met |= meet(np.stack([p, q, q], axis=1), vertices[faces[hinged[:, its]]])
    apart = meet(vertices[faces[free[:, 0]]], vertices[faces[free[:, 1]]])
    return free[apart], hinged[met]


def joined(edges, length, count, along):
    """Which vertices a path over edges joins that is not longer than a bound."""
    graph = coo_array((length, tuple(edges.T)), shape=(count, count)).tocsr()
    return np.isfinite(dijkstra(graph, directed=False, limit=along))


def edges_of(sheet):
    """All edges, ascending, and their lengths."""
    sides = np.sort(sheet.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges = np.unique(sides, axis=0)
    side = sheet.vertices[edges[:, 1]] - sheet.vertices[edges[:, 0]]
    return edges, np.sqrt(dot(side, side))


def vertices_near_faces(sheet, apart, local, along):
    """Vertex, face, distance, and whether apart, of all pairs that are near."""
    edges, length = edges_of(sheet)
    path = joined(edges, length, len(sheet.vertices), along)
    vertex = np.repeat(np.arange(len(sheet.vertices)), len(sheet.faces))
    face = np.tile(np.arange(len(sheet.faces)), len(sheet.vertices))
    corners = sheet.faces[face]
    distance = nearest(sheet.vertices, sheet.vertices, sheet.faces).ravel()
    far = ~path[vertex[:, None], corners].any(axis=1)
    near = distance < np.where(far, apart, local)
    near &= sheet.moving[vertex] | sheet.moving[corners].any(axis=1)
    near &= ~(corners == vertex[:, None]).any(axis=1)
    return vertex[near], corners[near], distance[near], far[near]


def edges_near_edges(sheet, apart, local, along):
    """Four ends, distance, and whether apart, of all pairs of edges that are near.

    The longer edge is first, and pairs ascend by length.
    """
    edges, length = edges_of(sheet)
    path = joined(edges, length, len(sheet.vertices), along)
    edges = edges[np.argsort(length, kind="stable")]
    first, second = np.tril_indices(len(edges), -1)
    four = np.concatenate([edges[first], edges[second]], axis=1)
    ends = sheet.vertices[four]
    distance, _, _ = of_segments(ends[:, :2], ends[:, 2:])
    far = ~path[four[:, :2, None], four[:, None, 2:]].any(axis=(1, 2))
    near = distance < np.where(far, apart, local)
    near &= sheet.moving[four].any(axis=1)
    near &= ~(four[:, :2, None] == four[:, None, 2:]).any(axis=(1, 2))
    return four[near], distance[near], far[near]


def walls_near(walls, points, distance):
    """Faces whose sphere is within a distance of some point, and box of all points."""
    corners = walls.vertices[walls.faces]
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    gap = np.linalg.norm(points[None] - centre[:, None], axis=2).min(axis=1)
    low, high = points.min(axis=0) - distance, points.max(axis=0) + distance
    near = (corners.max(axis=1) >= low).all(axis=1)
    near &= (corners.min(axis=1) <= high).all(axis=1)
    return np.flatnonzero(near & (gap <= distance + radius))


def winding(points, vertices, faces, on_surface):
    """Sum of solid angles over 4 pi; what is in a face has none."""
    rays = vertices[faces][None] - points[:, None, None]
    size = np.linalg.norm(rays, axis=3)
    a, b, c = rays.transpose(2, 0, 1, 3)
    p, q, r = size.transpose(2, 0, 1)
    top = dot(a, np.cross(b, c))
    bottom = p * q * r + dot(a, b) * r + dot(b, c) * p + dot(c, a) * q
    least = on_surface * p * q * r
    on = (np.abs(top) <= least) & (bottom <= least)
    return np.where(on, 0.0, np.arctan2(top, bottom)).sum(axis=1) / (2.0 * np.pi)


def alone(points, distance):
    """Number of points that no other one is closer to than a distance."""
    gap = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(gap, np.inf)
    return int((gap.min(axis=1) >= distance).sum())
