"""Repair of pleats and slivers, which the paper's phases cannot undo.

A *pleat* is a vertex whose fan of triangles has folded over, a *sliver* a triangle that
is nearly a segment. Both arise where the membrane is compressed, near the base of a
growing polyp. Neither a swap nor a collapse may touch them, because triangles would
turn, and because the valences there have dropped to three. If they stay, the energy has
a kink, and folds lead to self-intersections.

The paper leaves all of this open. Our choice:

- *Defect*: an edge with a crease beyond ``CREASE`` counts n·n' / cos ``CREASE`` − 1
  with the two normals, a triangle with a radius ratio ρ under ``SLIVER`` counts 1 − ρ /
  ``SLIVER``; each is at most 1. A surface without defects is not changed.
- *Moves*: the edges of defective triangles are flipped, or collapsed to either end or
  to the middle, one at a time. The one that reduces the sum of defects most comes
  first; the sum falls by at least ``GAIN`` each time, so the process terminates.
- *Never worse*: neither the sharpest crease nor the worst radius ratio of the triangles
  concerned and the edges around them may get worse than it was, unless it stays
  within 90 degrees or above ``FAIR_SHAPE``.
- *Valences* larger than three are for ordinary collapses. A repair may take away a
  vertex of valence three (a triangle takes the place of its three) or four; it
  must leave all valences at three or more, which with the link condition keeps the
  mesh a manifold.
- *Refused* are also: rim edges; moving or removing the rim, fixed vertices or the
  source; a swept volume over that of a prism over the largest triangle, ``SWEEP`` of
  its side high; a triangle or an edge over the bounds of fairing, unless there was one
  as large; what harms a particle (see `jaxgrow.mesh.particle_guard`), however bad the
  pleat; and what makes the surface cross itself or a wall (see
  `jaxgrow.mesh.intersection_guard`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrow.mesh.collapse import collapse_edges, common_neighbours
from jaxgrow.mesh.collapse_ends import collapsing_stars, Ends
from jaxgrow.mesh.intersection_guard import Crossing
from jaxgrow.mesh.particle_guard import Guard, Patches
from jaxgrow.mesh.quality import (
    area_vectors,
    lengths,
    radius_ratio,
    side_lengths,
    SLIVER,
    unit,
)
from jaxgrow.mesh.surface import Remeshing, Surface
from jaxgrow.mesh.topology import build_topology, group, Topology


CREASE = np.deg2rad(120.0)
"""Angle between the normals of neighbours above which they make a pleat (radians)."""

GAIN = 0.1
"""Least decrease of the sum of defects that is worth a repair (dimensionless)."""

SWEEP = 0.5
"""How far a repair may move the surface, in sides of the largest triangle."""

FAIR_SHAPE = 0.3
"""Radius ratio that is good enough after a repair, even if it was better before."""


def repair(
    surface: Surface,
    particles: Float[np.ndarray, "n 3"],
    *,
    max_area: float = np.inf,
    max_edge: float = np.inf,
    walls: Float[np.ndarray, "w 3 3"] | None = None,
    clearance: float = 0.15,
    gap: float = 0.05,
    max_repairs: int = 50,
) -> tuple[Surface, Remeshing]:
    """Remove pleats and slivers, one flip or collapse at a time.

    Args:
        surface: An oriented manifold with or without rim.
        particles: Live particles, which must keep their side.
        max_area: No repair may make a triangle larger than this (length²), unless one
            of those it replaces was; it bounds the swept volume too.
        max_edge: No repair may make an edge longer than this (length), unless one of
            those it replaces was.
        walls: Static triangles that the surface must not cross, oriented as it is;
            None for none.
        clearance: See `Guard` (length).
        gap: See `Crossing` (length).
        max_repairs: Bound on the number; the remaining defects are left to the next
            call.

    Returns:
        The surface and the remeshing that leads to it, with counts: "repaired", and of
        the repairs wanted at the end those refused by reason,
        "repair_refused_particle", "…_intersection".
    """
    done = Remeshing.unchanged(surface)
    repaired, refused = 0, {}
    for _ in range(max_repairs):
        topology = build_topology(surface.faces, len(surface.vertices))
        edges = _defective(surface, topology)
        if not len(edges):
            refused = {}
            break
        moves = _moves(surface, topology, edges)
        moves = moves.select(_improving(surface, moves, max_area, max_edge))
        guard = Guard(particles, surface.vertices, clearance)
        safe = np.flatnonzero(guard.admits(moves.patches()))
        refused = {"repair_refused_particle": len(moves.edge) - len(safe)}
        moves = moves.select(safe)
        crossing = Crossing.of(surface.vertices, surface.faces, walls, gap)
        move = _first_clear(moves, crossing)
        if move < 0:
            refused["repair_refused_intersection"] = len(safe)
            break
        surface, step = _perform(surface, topology, moves, move)
        done = done.then(step)
        repaired += 1
    done.counts.update(repaired=repaired, **refused)
    return surface, done


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Triangles that moves remove or add, move after move.

    Attributes:
        owner: The move of each triangle, ascending.
        face: Its index in the surface's faces, -1 for an added one.
        corners: Its vertices.
        triangles: Their positions.
    """

    owner: Int[np.ndarray, " t"]
    face: Int[np.ndarray, " t"]
    corners: Int[np.ndarray, "t 3"]
    triangles: Float[np.ndarray, "t 3 3"]

    def select(self, chosen: Int[np.ndarray, " k"], count: int) -> _Pieces:
        """Return the pieces of the chosen ones of `count` moves, in that order."""
        rows = group(self.owner, np.arange(len(self.owner)), count)
        owner, row = rows.rows(chosen)
        return _Pieces(owner, self.face[row], self.corners[row], self.triangles[row])


@dataclass(frozen=True, eq=False)
class _Moves:
    """Candidate repairs.

    Attributes:
        edge: The edge that each flips or collapses.
        flip: Whether it flips it.
        merging: Which of its ends stays in a collapse, and where.
        apex: The new triangles are a cone from here.
        old: Triangles that are removed.
        new: Triangles that are added.
    """

    edge: Int[np.ndarray, " k"]
    flip: Bool[np.ndarray, " k"]
    merging: Ends
    apex: Float[np.ndarray, "k 3"]
    old: _Pieces
    new: _Pieces

    def select(self, chosen: Int[np.ndarray, " s"]) -> _Moves:
        """Return the chosen moves, in that order."""
        count = len(self.edge)
        return _Moves(
            self.edge[chosen],
            self.flip[chosen],
            self.merging.select(chosen),
            self.apex[chosen],
            self.old.select(chosen, count),
            self.new.select(chosen, count),
        )

    def patches(self) -> Patches:
        """Return the surface before and after each move."""
        old, new = self.old, self.new
        return Patches(
            old.triangles, old.owner, old.face, new.triangles, new.owner, self.apex
        )


def _defective(surface: Surface, topology: Topology) -> Int[np.ndarray, " k"]:
    """Find all edges of slivers and of the triangles at a sharp crease."""
    triangles = surface.vertices[surface.faces]
    bad = radius_ratio(triangles) < SLIVER
    normal = unit(area_vectors(triangles))
    pair = topology.edge_faces[topology.interior]
    cosine = np.einsum("ni,ni->n", normal[pair[:, 0]], normal[pair[:, 1]])
    bad[pair[cosine < np.cos(CREASE)]] = True
    edges = np.unique(topology.face_edges[bad])
    return edges[topology.interior[edges]]


def _moves(
    surface: Surface, topology: Topology, edges: Int[np.ndarray, " e"]
) -> _Moves:
    """List the flips and collapses that keep a manifold and fixed vertices."""
    corners = np.concatenate([topology.edges, topology.opposite], axis=1)[edges]
    valence = topology.valence[corners]
    kept = (surface.kept | topology.rim_vertices)[corners]
    flips = np.all(valence[:, :2] > 3, axis=1)
    flips &= ~topology.has_edge(corners[:, 2], corners[:, 3])
    merges = np.all(valence[:, 2:] > 3, axis=1) & (valence[:, :2].sum(axis=1) >= 7)
    merges &= common_neighbours(topology, edges) == 2

    first, second = corners[:, :2].T
    none = np.zeros(len(edges), dtype=bool)
    ways = (
        (flips, Ends(first, second, none)),
        (merges & ~kept[:, 1], Ends(first, second, none)),
        (merges & ~kept[:, 0], Ends(second, first, none)),
        (merges & ~kept[:, :2].any(axis=1), Ends(first, second, ~none)),
    )
    chosen = [np.flatnonzero(possible) for possible, _ in ways]
    which = np.concatenate(chosen)
    parts = [way.select(pick) for pick, (_, way) in zip(chosen, ways, strict=True)]
    merging = Ends(
        np.concatenate([part.stays for part in parts]),
        np.concatenate([part.goes for part in parts]),
        np.concatenate([part.middle for part in parts]),
    )
    flip = np.arange(len(which)) < len(chosen[0])
    a, b, c, d = corners[which[flip]].T
    owner = np.repeat(np.arange(len(a)), 2)
    vertices = surface.vertices

    def both(one: tuple[Any, ...], other: tuple[Any, ...], face: Any) -> _Pieces:
        """Build the two triangles of each flip."""
        faces = np.stack([*one, *other], axis=1).reshape(-1, 3)
        return _Pieces(owner, face, faces, vertices[faces])

    sides = topology.edge_faces[edges[which[flip]]].ravel()
    old = both((a, b, c), (b, a, d), sides)
    new = both((a, d, c), (d, b, c), np.full_like(sides, -1))
    rest = merging.select(np.flatnonzero(~flip))
    stars = collapsing_stars(surface, rest)
    stay, number = ~stars.gone, stars.owner + len(a)
    was = surface.faces[stars.face]
    goes, stays = rest.goes[stars.owner][:, None], rest.stays[stars.owner][:, None]
    becomes = np.where(was == goes, stays, was)
    return _Moves(
        edge=edges[which],
        flip=flip,
        merging=merging,
        apex=np.concatenate([vertices[c], stars.apex]),
        old=_joined(old, _Pieces(number, stars.face, was, stars.old)),
        new=_joined(
            new,
            _Pieces(
                number[stay],
                np.full_like(number[stay], -1),
                becomes[stay],
                stars.new[stay],
            ),
        ),
    )


def _joined(one: _Pieces, other: _Pieces) -> _Pieces:
    """Concatenate two lists of pieces."""
    return _Pieces(
        np.concatenate([one.owner, other.owner]),
        np.concatenate([one.face, other.face]),
        np.concatenate([one.corners, other.corners]),
        np.concatenate([one.triangles, other.triangles]),
    )


def _improving(
    surface: Surface,
    moves: _Moves,
    max_area: float,
    max_edge: float,
) -> Int[np.ndarray, " k"]:
    """Select the moves that gain enough and make nothing worse, best first."""
    count = len(moves.edge)
    before = _state(surface, moves.old, count)
    after = _state(surface, moves.new, count)
    gain = before.defects - after.defects
    good = gain >= GAIN
    good &= after.cosine >= np.minimum(0.0, before.cosine)
    good &= after.ratio >= np.minimum(FAIR_SHAPE, before.ratio)
    good &= after.area <= np.maximum(max_area, before.area)
    good &= after.edge <= np.maximum(max_edge, before.edge)
    side = np.sqrt(4.0 * max_area / np.sqrt(3.0))
    height = moves.apex[moves.old.owner] - moves.old.triangles[:, 0]
    volume = np.einsum("ni,ni->n", area_vectors(moves.old.triangles), height) / 3.0
    swept = np.bincount(moves.old.owner, np.abs(volume), minlength=count)
    good &= swept <= SWEEP * side * max_area
    chosen = np.flatnonzero(good)
    return chosen[np.argsort(-gain[chosen], kind="stable")]


@dataclass(frozen=True, eq=False)
class _State:
    """Quality of the triangles of every move.

    Attributes:
        defects: Sum of defects over the triangles and their edges.
        cosine: Least scalar product of the normals at an edge.
        ratio: Least radius ratio.
        area: Largest area.
        edge: Largest edge.
    """

    defects: Float[np.ndarray, " k"]
    cosine: Float[np.ndarray, " k"]
    ratio: Float[np.ndarray, " k"]
    area: Float[np.ndarray, " k"]
    edge: Float[np.ndarray, " k"]


def _state(surface: Surface, pieces: _Pieces, count: int) -> _State:
    """Measure the triangles of each move, and the edges in and around them."""
    vector, ratio = area_vectors(pieces.triangles), radius_ratio(pieces.triangles)
    normal = unit(vector)
    outside = unit(area_vectors(surface.vertices[surface.faces]))
    n_vertices = len(surface.vertices)

    # Half-edges of the pieces; the neighbour is one of them, or a face of the surface.
    owner = np.repeat(pieces.owner, 3)
    tail, head = pieces.corners.ravel(), pieces.corners[:, [1, 2, 0]].ravel()
    own = np.repeat(normal, 3, axis=0)
    key = (owner * n_vertices + tail) * n_vertices + head
    back = (owner * n_vertices + head) * n_vertices + tail
    order = np.argsort(key)
    place = order[np.minimum(np.searchsorted(key[order], back), len(key) - 1)]
    inside = key[place] == back
    around = surface.faces.ravel() * n_vertices + surface.faces[:, [1, 2, 0]].ravel()
    place_around = np.argsort(around)
    wanted = back - owner * n_vertices**2
    found = np.minimum(np.searchsorted(around[place_around], wanted), len(around) - 1)
    half_edge = place_around[found]
    known = around[half_edge] == wanted
    other = np.where(inside[:, None], own[place], outside[half_edge // 3])
    cosine = np.einsum("ni,ni->n", own, other)
    cosine = np.where(inside | known, cosine, 1.0)

    crease = np.maximum(0.0, cosine / np.cos(CREASE) - 1.0)
    defects = np.bincount(owner, np.where(inside, 0.5, 1.0) * crease, count)
    defects += np.bincount(pieces.owner, np.maximum(0.0, 1.0 - ratio / SLIVER), count)
    sides = side_lengths(pieces.triangles).max(axis=1)
    sharpest, worst = np.ones(count), np.ones(count)
    largest, longest = np.zeros(count), np.zeros(count)
    np.minimum.at(sharpest, owner, cosine)
    np.minimum.at(worst, pieces.owner, ratio)
    np.maximum.at(largest, pieces.owner, lengths(vector))
    np.maximum.at(longest, pieces.owner, sides)
    return _State(defects, sharpest, worst, largest, longest)


def _first_clear(moves: _Moves, crossing: Crossing) -> int:
    """Return the first move that crosses nothing, -1 for none."""
    # Usually the first one is; testing the rest at once is cheaper than one by one.
    everything = np.arange(len(moves.edge))
    for part in (everything[:1], everything[1:]):
        clear = crossing.admits(moves.select(part).patches())
        if clear.any():
            return int(part[clear.argmax()])
    return -1


def _perform(
    surface: Surface, topology: Topology, moves: _Moves, move: int
) -> tuple[Surface, Remeshing]:
    """Apply one move."""
    if not moves.flip[move]:
        chosen = np.array([move])
        merging = moves.merging.select(chosen)
        return collapse_edges(surface, topology, moves.edge[chosen], merging)
    faces = surface.faces.copy()
    faces[moves.old.face[moves.old.owner == move]] = moves.new.corners[
        moves.new.owner == move
    ]
    result = Surface(surface.vertices, faces, surface.fixed, surface.source)
    return result, Remeshing.unchanged(result)
