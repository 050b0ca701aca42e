"""Lesions as triangle meshes: surfaces of revolution on a plane, leaning and bent."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrow.state import Membrane, replaced


RIM = 8.0


def line(start, end):
    """Length of a straight piece of a profile, and its points (radius, height)."""
    start, end = np.array(start, float), np.array(end, float)
    length = np.linalg.norm(end - start)
    return length, lambda s: start + (end - start) * s / length


def arc(centre, radius, start, end):
    """The same of an arc between two angles."""
    length = radius * abs(end - start)

    def at(s):
        angle = start + (end - start) * s / length
        return np.array(centre) + radius * np.array([np.cos(angle), np.sin(angle)])

    return length, at


def stitch(one, other, angle_one, angle_other):
    """Triangles between two rings of vertices, each in the order of their angles."""
    m, n = len(one), len(other)
    i = j = 0
    faces = []
    while i < m or j < n:
        next_one = angle_one[(i + 1) % m] + 2 * np.pi * ((i + 1) // m)
        next_other = angle_other[(j + 1) % n] + 2 * np.pi * ((j + 1) // n)
        if j == n or (i < m and next_one <= next_other):
            faces.append([one[i % m], one[(i + 1) % m], other[j % n]])
            i += 1
        else:
            faces.append([one[i % m], other[(j + 1) % n], other[j % n]])
            j += 1
    return faces


def mesh(profile, spacing):
    """Vertices, faces and rim: rings of irregular points on the surface, and the tip.

    The rim is where the profile begins, the tip where it ends.
    """
    rng = np.random.default_rng(0)
    total = sum(length for length, _ in profile)
    count = round(total / spacing)

    def at(s):
        for length, point in profile[:-1]:
            if s < length:
                return point(s)
            s -= length
        return profile[-1][1](s)

    vertices, faces, before = [], [], None
    for k in range(count):
        s = k * total / count
        number = max(5, round(2 * np.pi * at(s)[0] / spacing))
        angle = 2 * np.pi * (np.arange(number) + k % 2 / 2) / number
        along = np.full(number, s)
        if k > 1:  # the first ring is the rim, and none may cross it
            angle += rng.uniform(-0.2, 0.2, number) * 2 * np.pi / number
            along += rng.uniform(-0.2, 0.2, number) * total / count
        index = len(vertices) + np.arange(number)
        for a, (radius, height) in zip(angle, map(at, along), strict=True):
            vertices.append([radius * np.cos(a), radius * np.sin(a), height])
        if before is not None:
            faces += stitch(before[0], index, before[1], angle)
        before = index, angle
    tip = np.full(len(before[0]), len(vertices))
    faces += np.stack([before[0], np.roll(before[0], -1), tip], axis=1).tolist()
    vertices.append([0.0, 0.0, at(total)[1]])
    rim = np.arange(len(vertices)) < round(2 * np.pi * at(0)[0] / spacing)
    return np.array(vertices), np.array(faces), rim


def cap(radius, height):
    """A part of a sphere on a plane."""
    centre = height - radius
    base = np.sqrt(radius**2 - centre**2)
    return [
        line((RIM, 0), (base, 0)),
        arc((0, centre), radius, np.arctan2(-centre, base), np.pi / 2),
    ]


def cylinder(radius, length):
    """A cylinder with half a sphere on it."""
    return [
        line((RIM, 0), (radius, 0)),
        line((radius, 0), (radius, length)),
        arc((0, length), radius, 0, np.pi / 2),
    ]


def mushroom(neck, tube, above=0.9):
    """The inner side of a torus, on a plane, with a sphere that goes on smoothly.

    Returns:
        The profile, and the radius and the top of the sphere.
    """
    meet = np.pi - above
    to_axis = (neck + tube) / np.cos(above)
    radius, centre = to_axis - tube, tube + to_axis * np.sin(above)
    profile = [
        line((RIM, 0), (neck + tube, 0)),
        arc((neck + tube, tube), tube, 1.5 * np.pi, meet),
        arc((0, centre), radius, -above, np.pi / 2),
    ]
    return profile, radius, centre + radius


def flared(neck, foot, stalk, head):
    """A stalk with a foot as the inner side of a torus, and a sphere on it.

    Returns:
        The profile, and the height of its top.
    """
    centre = foot + stalk + np.sqrt(head**2 - neck**2)
    profile = [
        line((RIM, 0), (neck + foot, 0)),
        arc((neck + foot, foot), foot, 1.5 * np.pi, np.pi),
        line((neck, foot), (neck, foot + stalk)),
        arc((0, centre), head, -np.arccos(neck / head), np.pi / 2),
    ]
    return profile, centre + head


def bent(vertices, angle, length):
    """Bend what is over a plane to an arc of this angle and length, and on straight.

    Sections across the axis keep their shapes.
    """
    x, y, z = vertices.T
    s = np.clip(z, 0, length)
    turn = angle * s / length
    sine, cosine, none = np.sin(turn), np.cos(turn), 0 * turn
    radius = length / angle
    centre = np.stack([radius * (1 - cosine), y, radius * sine], axis=1)
    along = np.stack([sine, none, cosine], axis=1)
    across = np.stack([cosine, none, -sine], axis=1)
    return centre + (z - s)[:, None] * along + x[:, None] * across


def leaning(vertices, angle, radius, length):
    """Lean a tube of a radius, and what is on it, in the plane of x and z.

    Its side is stretched so that it begins on the plane; up to ``length`` there must be
    nothing but the tube.
    """
    x, y, z = vertices.T
    out = np.hypot(x, y)
    sine, cosine = np.sin(angle), np.cos(angle)
    along = z + x * np.tan(angle) * np.clip(1 - z / length, 0, 1)
    body = np.stack([along * sine + x * cosine, y, along * cosine - x * sine], axis=1)
    share = np.clip((RIM - out) / (RIM - radius), 0, 1)
    around = np.stack([x * (1 + (1 / cosine - 1) * share), y, 0 * z], axis=1)
    outside = (z <= 1e-9) & (out > radius - 1e-9)
    return np.where(outside[:, None], around, body)


def disc_of(vertices, rim):
    """Vertices and faces of the flat disc with a mesh's rim."""
    number = int(rim.sum())
    around = np.arange(number)
    fan = np.stack([around, np.roll(around, -1), np.full(number, number)], axis=1)
    return np.concatenate([vertices[rim], [[0.0, 0, 0]]]), fan


ROOM = 864
"""Capacity of the vertices of all states, so that metrics are compiled once."""


def roomy(state, room=ROOM):
    """The state with a membrane of this capacity."""
    membrane: Membrane = state.membrane
    old = membrane.vertices.shape[0]

    def longer(array):
        more = array.shape[0] * room // old - array.shape[0]
        return jnp.concatenate(
            [array, jnp.zeros((more, *array.shape[1:]), array.dtype)]
        )

    names = [
        "vertices",
        "faces",
        "edges",
        "opposite",
        "vertex_alive",
        "face_alive",
        "edge_alive",
        "pinned",
    ]
    arrays = {name: longer(getattr(membrane, name)) for name in names}
    rest = {name: longer(value) for name, value in membrane.rest.items()}
    return eqx.tree_at(
        lambda s: s.membrane, state, replaced(membrane, rest=rest, **arrays)
    )
