"""Adaptive subdivision (paper section 4, "Surface fairing").

Triangles that are too large get quaternary subdivision, and their neighbours are
closed by the paper's rule R_adapt: three subdivided neighbours, quaternary; two,
A-shape; one, T-shape. We get the same by marking edges: all edges of the large
triangles are marked, and every triangle is split according to its number of marked
edges. Two triangles always agree on their common edge, so no crack can open.

What the paper leaves open, and our choice:

- *The rim.* Its edges belong to the rest of the organ too and are never split, so a
  large triangle with one rim edge is split in A-shape, with two in T-shape.
- *Slivers at the rim.* Beside a rim edge that is long against √``max_area`` every
  split halves the height of the triangle on it. A triangle whose longest side is on the
  rim is not cut if a part would have a radius ratio below ``SLIVER``, and below that of
  the whole; nor then one whose longest side that triangle keeps whole. They stay over
  the area bound instead, and the patch is graded to the organ's edges.
- *The diagonal of the A-shape*: the one with the larger sum of radius ratios.
- *Long thin triangles* below the area bound: an edge longer than ``max_edge`` is split
  too (T-shape on both sides) if no side of its two triangles is longer. The latter is
  Rivara's condition for termination, and keeps a long rim edge from creating slivers
  without end.
- *How often.* The paper subdivides once an iteration. `subdivide` is that one pass;
  `subdivide_all` repeats it until the bound holds.

A midpoint subdivision does not move the surface, so it is safe for all particles.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrow.mesh.quality import areas, radius_ratio, side_lengths, SLIVER
from jaxgrow.mesh.surface import average_parents, Remeshing, Surface
from jaxgrow.mesh.topology import build_topology, Topology


def subdivide(
    surface: Surface, max_area: float, max_edge: float = np.inf
) -> tuple[Surface, Remeshing]:
    """Split the triangles over the area bound once, and close neighbours.

    Every triangle over the bound is cut into parts of at most half its area, as long
    as one of its edges is not on the rim, and it does not become a sliver there.

    Args:
        surface: An oriented manifold with or without rim.
        max_area: Area threshold t (length²).
        max_edge: Length above which an edge is split for its own sake.

    Returns:
        The new surface (vertices of the old one first, in their order), and the map
        to it with counts of "quaternary", "a_shape", "t_shape".
    """
    triangles = surface.vertices[surface.faces]
    large = areas(triangles) > max_area
    sides = side_lengths(triangles) if np.isfinite(max_edge) else None
    none = {"quaternary": 0, "a_shape": 0, "t_shape": 0}
    if not large.any() and (sides is None or not (sides > max_edge).any()):
        return surface, Remeshing.unchanged(surface, none)
    topology = build_topology(surface.faces, len(surface.vertices))
    marked = np.zeros(len(topology.edges), dtype=bool)
    marked[topology.face_edges[large]] = True
    if sides is not None:
        marked |= _long_edges(topology, sides, max_edge)
    marked = _without_slivers(surface, topology, marked)
    if not marked.any():
        return surface, Remeshing.unchanged(surface, none)
    return split_edges(surface, topology, marked)


def subdivide_all(
    surface: Surface, max_area: float, max_edge: float = np.inf
) -> tuple[Surface, Remeshing]:
    """Repeat `subdivide` until no interior triangle is over the bound.

    An interior triangle has an edge off the rim, and no longest side on it. Each pass
    at least halves the area of a triangle over the bound, so it takes no more than
    ceil(log2(largest area / max_area)) passes for the area. Edges over the length bound
    are given as many passes and one more.

    Args:
        surface: An oriented manifold with or without rim.
        max_area: Area threshold t (length²).
        max_edge: Length above which an edge is split for its own sake.

    Returns:
        The new surface and the map to it.
    """
    largest = areas(surface.vertices[surface.faces]).max(initial=0.0)
    passes = 1 + int(np.ceil(np.log2(max(largest / max_area, 1.0))))
    result, done = subdivide(surface, max_area, max_edge)
    for _ in range(passes):
        before = len(result.faces)
        result, step = subdivide(result, max_area, max_edge)
        if len(result.faces) == before:
            break
        done = done.then(step)
    return result, done


def split_edges(
    surface: Surface, topology: Topology, marked: Bool[np.ndarray, " e"]
) -> tuple[Surface, Remeshing]:
    """Split the marked edges at their middle, and the faces at them.

    Args:
        surface: The surface.
        topology: Its topology.
        marked: Edges to split. On a marked edge both faces are split.

    Returns:
        The new surface and the map to it, with counts as in `subdivide`.
    """
    n_vertices = len(surface.vertices)
    middle = np.full(len(marked), -1)
    middle[marked] = n_vertices + np.arange(np.count_nonzero(marked))
    own = np.repeat(np.arange(n_vertices)[:, None], 2, axis=1)
    parents = np.concatenate([own, topology.edges[marked]])
    vertices = average_parents(surface.vertices, parents)

    new = middle[topology.face_edges]
    count = (new >= 0).sum(axis=1)
    faces = split_faces(vertices, surface.faces, new)
    fixed = np.concatenate(
        [surface.fixed, np.zeros(len(parents) - n_vertices, dtype=bool)]
    )
    counts = {
        "quaternary": int(np.count_nonzero(count == 3)),
        "a_shape": int(np.count_nonzero(count == 2)),
        "t_shape": int(np.count_nonzero(count == 1)),
    }
    result = Surface(vertices, faces, fixed, surface.source)
    return result, Remeshing((parents,), faces, fixed, surface.source, counts)


def split_faces(
    vertices: Float[np.ndarray, "m 3"],
    corners: Int[np.ndarray, "f 3"],
    new: Int[np.ndarray, "f 3"],
) -> Int[np.ndarray, "_ 3"]:
    """Split each face at the new vertices on its sides.

    Args:
        vertices: Positions, of the new vertices too.
        corners: The faces.
        new: The new vertex on the side from corner k to corner k + 1, -1 for none.

    Returns:
        First the faces without a new vertex, as they are; then those with three
        (quaternary), with two (A-shape) and with one (T-shape).
    """
    count = (new >= 0).sum(axis=1)
    return np.concatenate(
        [
            corners[count == 0],
            _quaternary(corners[count == 3], new[count == 3]),
            _a_shape(vertices, *_turn(corners, new, count == 2, lead=False)),
            _t_shape(*_turn(corners, new, count == 1, lead=True)),
        ]
    )


def _turn(
    corners: Int[np.ndarray, "f 3"],
    new: Int[np.ndarray, "f 3"],
    chosen: Bool[np.ndarray, " f"],
    *,
    lead: bool,
) -> tuple[Int[np.ndarray, "k 3"], Int[np.ndarray, "k 3"]]:
    """Rotate the chosen faces so that the edge that differs comes first.

    It is the only edge with (lead) or without a middle.
    """
    corners, new = corners[chosen], new[chosen]
    first = np.argmax((new >= 0) == lead, axis=1)
    turn = (first[:, None] + np.arange(3)) % 3
    return np.take_along_axis(corners, turn, 1), np.take_along_axis(new, turn, 1)


def _quaternary(
    corners: Int[np.ndarray, "f 3"], new: Int[np.ndarray, "f 3"]
) -> Int[np.ndarray, "_ 3"]:
    """Split each face into three corner triangles and the middle one."""
    (a, b, c), (ab, bc, ca) = corners.T, new.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def _t_shape(
    corners: Int[np.ndarray, "f 3"], new: Int[np.ndarray, "f 3"]
) -> Int[np.ndarray, "_ 3"]:
    """Split each face at its edge (a, b) into two triangles."""
    (a, b, c), ab = corners.T, new[:, 0]
    return np.concatenate([np.stack([a, ab, c], 1), np.stack([ab, b, c], 1)])


def _a_shape(
    vertices: Float[np.ndarray, "m 3"],
    corners: Int[np.ndarray, "f 3"],
    new: Int[np.ndarray, "f 3"],
) -> Int[np.ndarray, "_ 3"]:
    """Split each face at (b, c) and (c, a): the tip at c, and a quad.

    The quad is cut by the better of its diagonals.
    """
    (a, b, c), (_, bc, ca) = corners.T, new.T
    tip = np.stack([ca, bc, c], axis=1)
    one = np.stack([a, b, bc], 1), np.stack([a, bc, ca], 1)
    two = np.stack([a, b, ca], 1), np.stack([b, bc, ca], 1)
    ratios = [[radius_ratio(vertices[t]) for t in pair] for pair in (one, two)]
    pick = (np.sum(ratios[1], axis=0) > np.sum(ratios[0], axis=0))[:, None]
    halves = [np.where(pick, t, o) for o, t in zip(one, two, strict=True)]
    return np.concatenate([tip, *halves])


def _without_slivers(
    surface: Surface, topology: Topology, marked: Bool[np.ndarray, " e"]
) -> Bool[np.ndarray, " e"]:
    """Remove the marks of triangles that would become slivers on a whole side.

    That is a longest side on the rim, or one whose mark is removed here: fewer marks
    may change how the triangles beside are cut, so it is done again until there is no
    such triangle.
    """
    vertices, faces = surface.vertices, surface.faces
    whole = np.minimum(radius_ratio(vertices[faces]), SLIVER)
    places = np.concatenate([vertices, vertices[topology.edges].mean(axis=1)])
    longest = np.argmax(side_lengths(vertices[faces]), axis=1)
    base = topology.face_edges[np.arange(len(faces)), longest]
    closed = ~topology.interior
    while (marked & ~closed).any():
        there = (marked & ~closed)[topology.face_edges]
        new = np.where(there, len(vertices) + topology.face_edges, -1)
        count = there.sum(axis=1)
        of = [np.flatnonzero(count == k) for k in (0, 3, 2, 1)]
        owner = np.concatenate(
            [np.tile(some, parts) for some, parts in zip(of, (1, 4, 3, 2), strict=True)]
        )
        thin = radius_ratio(places[split_faces(places, faces, new)])
        bad = owner[thin < whole[owner] * (1 - 1e-9)]
        bad = bad[closed[base[bad]]]
        if not len(bad):
            break
        closed[topology.face_edges[bad]] = True
    return marked & ~closed


def _long_edges(
    topology: Topology, sides: Float[np.ndarray, "f 3"], max_edge: float
) -> Bool[np.ndarray, " e"]:
    """Mark edges over the bound that are the longest side of both triangles."""
    longest = (sides > max_edge) & (sides >= sides.max(axis=1)[:, None] * (1 - 1e-12))
    votes = np.bincount(topology.face_edges[longest], minlength=len(topology.edges))
    return votes == 2
