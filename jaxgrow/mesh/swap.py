"""Edge swapping (paper section 4, "Surface fairing").

The common edge of two triangles is flipped if the sum of their radius ratios grows.

What the paper leaves open, and our choice:

- *Order*: the largest gain first. Flips that share no vertex with a better one are done
  together, then all gains are recomputed, until none is left. The sum over the mesh
  grows strictly with every flip, so the process terminates.
- *Equal sums*: a gain below a small margin is none.
- *Refused* are rim edges; an edge that exists already, on the surface or on a wall (the
  result would not be a manifold); an end that would be left with fewer than three
  edges; a flip that changes the shape; one that harms a particle (see
  `jaxgrow.mesh.particle_guard`); and one that makes the surface cross itself or a wall
  (see `jaxgrow.mesh.intersection_guard`). Of two flips of a round that would cross each
  other, the better one is done.
- *Shape*: a flip is refused for a dihedral turn of more than ``max_angle`` between the
  old triangles, unless one of them is a cap so flat that the surface moves by less than
  ``FLAT`` of the edge (its normal is meaningless then); a turn of more than
  ``max_angle`` between the new triangles (the sum of the area vectors stays, so none of
  them turns over either); and a crease of more than 90 degrees to a triangle next to
  the two, where there was none as sharp.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrow.mesh.intersection_guard import Crossing
from jaxgrow.mesh.particle_guard import Guard, Patches
from jaxgrow.mesh.quality import area_vectors, lengths, radius_ratio, unit
from jaxgrow.mesh.surface import Remeshing, Surface
from jaxgrow.mesh.topology import build_topology, greedy_independent, Topology


FLAT = 0.1
"""Height of a cap over its longest side, relative to the side, that counts as flat."""


def swap(
    surface: Surface,
    particles: Float[np.ndarray, "n 3"],
    *,
    walls: Float[np.ndarray, "w 3 3"] | None = None,
    clearance: float = 0.15,
    gap: float = 0.05,
    max_angle: float = np.pi / 3,
    margin: float = 1e-6,
    max_rounds: int = 50,
) -> tuple[Surface, Remeshing]:
    """Flip edges while that improves the triangles.

    Args:
        surface: An oriented manifold with or without rim.
        particles: Live particles, which must keep their side.
        walls: Static triangles that the surface must not cross, oriented as it is;
            None for none.
        clearance: See `Guard` (length).
        gap: See `Crossing` (length).
        max_angle: Largest turn between triangles that a flip may smooth away or
            leave behind (radians).
        margin: Relative gain below which nothing is flipped.
        max_rounds: Bound on the rounds; the remaining edges are left to the next call.

    Returns:
        The surface with other faces and the same vertices, and a remeshing with counts:
        "swapped", and of the last round's wanted edges those refused by reason,
        "swap_refused_edge_exists", "…_valence", "…_shape", "…_particle",
        "…_intersection".
    """
    guard = Guard(particles, surface.vertices, clearance)
    faces = surface.faces
    swapped, refused = 0, {}
    for _ in range(max_rounds):
        topology = build_topology(faces, len(surface.vertices))
        crossing = Crossing.of(surface.vertices, faces, walls, gap)
        edges, corners, refused = _wanted(
            Surface(surface.vertices, faces, surface.fixed),
            topology,
            (guard, crossing),
            max_angle,
            margin,
        )
        if not len(edges):
            break
        rank = np.repeat(np.arange(len(edges)), 4)
        chosen = greedy_independent(rank, corners.ravel(), len(edges))
        edges, corners = edges[chosen], corners[chosen]
        together = crossing.compatible(
            _patches(surface.vertices, topology, edges, corners)
        )
        a, b, c, d = corners[together].T
        near, far = topology.edge_faces[edges[together]].T
        faces = faces.copy()
        faces[near] = np.stack([a, d, c], axis=1)
        faces[far] = np.stack([d, b, c], axis=1)
        swapped += int(np.count_nonzero(together))
    counts = {"swapped": swapped, **refused}
    result = Surface(surface.vertices, faces, surface.fixed, surface.source)
    return result, Remeshing.unchanged(result, counts)


def _wanted(
    surface: Surface,
    topology: Topology,
    guards: tuple[Guard, Crossing],
    max_angle: float,
    margin: float,
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, "k 4"], dict[str, int]]:
    """Select the edges to flip, best first, with their corners and refusals.

    The corners are the ends a, b and the opposite vertices c, d.
    """
    vertices, faces = surface.vertices, surface.faces
    inner = np.flatnonzero(topology.interior)
    corners = np.concatenate([topology.edges, topology.opposite], axis=1)[inner]
    ratio = radius_ratio(vertices[faces])
    before = ratio[topology.edge_faces[inner]].sum(axis=1)
    after = radius_ratio(vertices[corners[:, [0, 3, 2]]]) + radius_ratio(
        vertices[corners[:, [3, 1, 2]]]
    )
    better = after > before * (1 + margin) + margin
    inner, corners = inner[better], corners[better]
    gain = (after - before)[better]
    refused: dict[str, int] = {}

    def keep(good: Bool[np.ndarray, " k"], reason: str) -> None:
        """Keep the good ones and count the others."""
        nonlocal inner, corners, gain
        refused[f"swap_refused_{reason}"] = int(np.count_nonzero(~good))
        inner, corners, gain = inner[good], corners[good], gain[good]

    taken = topology.has_edge(corners[:, 2], corners[:, 3])
    rim = np.flatnonzero(surface.fixed[corners[:, 2:]].all(axis=1))
    taken[rim] |= guards[1].walls_have_edge(vertices[corners[rim, 2:]])
    keep(~taken, "edge_exists")
    keep(np.all(topology.valence[corners[:, :2]] > 3, axis=1), "valence")
    keep(_keeps_shape(vertices, faces, topology, inner, corners, max_angle), "shape")
    for guard, reason in zip(guards, ("particle", "intersection"), strict=True):
        keep(guard.admits(_patches(vertices, topology, inner, corners)), reason)
    order = np.argsort(-gain, kind="stable")
    return inner[order], corners[order], refused


def _patches(
    vertices: Float[np.ndarray, "m 3"],
    topology: Topology,
    edges: Int[np.ndarray, " k"],
    corners: Int[np.ndarray, "k 4"],
) -> Patches:
    """Return the surface before and after each flip."""
    a, b, c, d = vertices[corners].transpose(1, 0, 2)
    owner = np.repeat(np.arange(len(corners)), 2)
    old = np.stack([a, b, c, b, a, d], axis=1).reshape(-1, 3, 3)
    new = np.stack([a, d, c, d, b, c], axis=1).reshape(-1, 3, 3)
    return Patches(old, owner, topology.edge_faces[edges].ravel(), new, owner, c)


def _keeps_shape(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    topology: Topology,
    edges: Int[np.ndarray, " k"],
    corners: Int[np.ndarray, "k 4"],
    max_angle: float,
) -> Bool[np.ndarray, " k"]:
    """Return whether each flip preserves the shape; see the module."""
    bound = np.cos(max_angle)
    a, b, c, d = vertices[corners].transpose(1, 0, 2)
    old = area_vectors(np.stack([a, b, c], 1)), area_vectors(np.stack([b, a, d], 1))
    new = area_vectors(np.stack([a, d, c], 1)), area_vectors(np.stack([d, b, c], 1))
    before, after = [unit(x) for x in old], [unit(x) for x in new]
    height = 2 * np.minimum(*(lengths(x) for x in old))
    flat = height < FLAT * np.einsum("ni,ni->n", b - a, b - a)
    good = (_dot(*before) >= bound) | flat
    good &= _dot(*after) >= bound

    # The patch's outer edges: old triangle (0: near, 1: far), new triangle, and the
    # corner where the edge starts. First new triangle: a-d, c-a; second: d-b, b-c.
    sides = topology.edge_faces[edges].T
    for was, becomes, start in ((1, 0, 0), (0, 0, 2), (1, 1, 3), (0, 1, 1)):
        place = np.argmax(faces[sides[was]] == corners[:, [start]], axis=1)
        pair = topology.edge_faces[topology.face_edges[sides[was], place]]
        other = np.where(pair[:, 0] == sides[was], pair[:, 1], pair[:, 0])
        beyond = unit(area_vectors(vertices[faces[other]]))
        sharpest = np.minimum(0.0, _dot(before[was], beyond))
        good &= (_dot(after[becomes], beyond) >= sharpest) | (other < 0)
    return good


def _dot(
    a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """Return the scalar product of each pair of rows."""
    return np.einsum("ni,ni->n", a, b)
