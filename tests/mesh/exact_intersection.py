"""Which faces of a surface intersect, by exact integer arithmetic.

The oracle for what the operations promise: it shares no code with
`jaxgrow.mesh.intersection`. A float is an integer times a power of two, so the
coordinates become integers of any size, and every predicate is the sign of a
determinant of those; floats only decide where their rounding cannot matter.
"""

import numpy as np


NO_WALLS = np.zeros((0, 3, 3))


def _orientation(a, b, c, d):
    """Sign of det(b - a, c - a, d - a); rows of integers of any size."""
    u, v, w = b - a, c - a, d - a
    x = v[:, 1] * w[:, 2] - v[:, 2] * w[:, 1]
    y = v[:, 2] * w[:, 0] - v[:, 0] * w[:, 2]
    z = v[:, 0] * w[:, 1] - v[:, 1] * w[:, 0]
    return np.sign((u[:, 0] * x + u[:, 1] * y + u[:, 2] * z).astype(object))


def _signs(points, index):
    """Orientation of quadruples of points: in floats where that is certain."""
    real, whole = points
    a, b, c, d = (real[column] for column in index.T)
    u, v, w = b - a, c - a, d - a
    size = np.abs(np.stack([u, v, w])).max(axis=(0, 2), initial=0.0)
    value = np.einsum("ni,ni->n", u, np.cross(v, w))
    result = np.sign(value).astype(int)
    unsure = np.abs(value) <= 1e-13 * size**3
    rows = index[unsure]
    if len(rows):
        exact = _orientation(*(whole[column] for column in rows.T))
        result[unsure] = exact.astype(int)
    return result


def _flat_sign(p, q, r, axes):
    """Orientation of three integer points seen along an axis."""
    i, j = axes
    value = (q[i] - p[i]) * (r[j] - p[j]) - (q[j] - p[j]) * (r[i] - p[i])
    return (value > 0) - (value < 0)


def _flat_meeting(segment, triangle):
    """Whether a segment meets a triangle in its plane (integer points)."""
    p, q, (a, b, c) = *segment, triangle
    normal = [
        (b[i] - a[i]) * (c[j] - a[j]) - (b[j] - a[j]) * (c[i] - a[i])
        for i, j in ((1, 2), (2, 0), (0, 1))
    ]
    largest = max(range(3), key=lambda k: abs(normal[k]))
    axes = [(1, 2), (2, 0), (0, 1)][largest]
    turn = _flat_sign(a, b, c, axes)
    sides = ((a, b), (b, c), (c, a))
    if all(turn * _flat_sign(*side, p, axes) >= 0 for side in sides):
        return True
    for r, s in sides:
        one = _flat_sign(r, s, p, axes), _flat_sign(r, s, q, axes)
        two = _flat_sign(p, q, r, axes), _flat_sign(p, q, s, axes)
        if one == (0, 0):
            i = max(axes, key=lambda k: abs(s[k] - r[k]))
            low, high = sorted((p[i], q[i]))
            first, last = sorted((r[i], s[i]))
            if low <= last and first <= high:
                return True
        elif one[0] * one[1] <= 0 and two[0] * two[1] <= 0:
            return True
    return False


def _pierced(points, segments, triangles):
    """Whether each (closed) segment meets each (closed) triangle; indices of points."""
    result = np.zeros(len(segments), dtype=bool)
    ends, corners = points[0][segments], points[0][triangles]
    near = (ends.min(axis=1) <= corners.max(axis=1)).all(axis=1)
    near &= (corners.min(axis=1) <= ends.max(axis=1)).all(axis=1)
    p, q = segments[near].T
    a, b, c = triangles[near].T
    above = _signs(points, np.stack([a, b, c, p], axis=1))
    below = _signs(points, np.stack([a, b, c, q], axis=1))
    met = np.zeros(len(p), dtype=bool)
    through = np.flatnonzero((above * below <= 0) & ((above != 0) | (below != 0)))
    around = [
        _signs(points, np.stack([p, q, *side], axis=1)[through])
        for side in ((a, b), (b, c), (c, a))
    ]
    met[through] = (np.min(around, axis=0) >= 0) | (np.max(around, axis=0) <= 0)
    whole = points[1]
    for row in np.flatnonzero((above == 0) & (below == 0)).tolist():
        segment, triangle = [p[row], q[row]], [a[row], b[row], c[row]]
        met[row] = _flat_meeting(whole[segment], whole[triangle])
    result[near] = met
    return result


def exact_crossings(surface, walls=NO_WALLS):
    """Pairs of faces that meet elsewhere than in common corners; walls but not two."""
    corners = np.concatenate([surface.vertices, walls.reshape(-1, 3)])
    unique, index = np.unique(corners, axis=0, return_inverse=True)
    index = index.reshape(-1)
    used = np.unique(surface.faces)
    assert len(np.unique(index[used])) == len(used)
    own = len(surface.faces)
    more = len(surface.vertices) + np.arange(3 * len(walls)).reshape(-1, 3)
    faces = index[np.concatenate([surface.faces, more])]
    mantissa, exponent = np.frexp(unique)
    shift = exponent - exponent.min()
    whole = (2.0**53 * mantissa).astype(np.int64).astype(object)
    whole = whole << shift.astype(object)
    points = unique, whole

    low, high = unique[faces].min(axis=1), unique[faces].max(axis=1)
    near = np.all((low[:own, None] <= high) & (low <= high[:own, None]), axis=2)
    one, other = np.nonzero(near)
    one, other = one[one < other], other[one < other]
    same = faces[one][:, :, None] == faces[other][:, None, :]
    shared = same.sum(axis=(1, 2))
    rows, segments, triangles = [], [], []
    for first, second, alike in (
        (one, other, same.any(axis=2)),
        (other, one, same.any(axis=1)),
    ):
        for k in range(3):
            # All sides if nothing is shared, else the one opposite to the corner.
            asked = (shared == 0) | ((shared == 1) & alike[:, (k + 2) % 3])
            rows.append(np.flatnonzero(asked))
            segments.append(faces[first[asked]][:, [k, (k + 1) % 3]])
            triangles.append(faces[second[asked]])
    met = _pierced(points, np.concatenate(segments), np.concatenate(triangles))
    bad = np.zeros(len(one), dtype=bool)
    bad[np.concatenate(rows)[met]] = True

    # Two with a common side overlap if they are in one plane, on the same side of it.
    hinge = np.flatnonzero(shared == 2)
    alone, tip = ~same[hinge].any(axis=2), ~same[hinge].any(axis=1)
    its = faces[other[hinge]][tip]
    flat = _signs(points, np.column_stack([faces[one[hinge]], its])) == 0
    for row, corner, far in zip(
        hinge[flat], alone[flat].argmax(axis=1), its[flat], strict=True
    ):
        near, start, end = np.roll(faces[one[row]], -corner)
        along = unique[end] - unique[start]
        arms = [np.cross(along, unique[k] - unique[start]) for k in (near, far)]
        bad[row] = arms[0] @ arms[1] > 0
    bad |= shared == 3
    return int(np.count_nonzero(bad))
