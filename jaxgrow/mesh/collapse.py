"""Edge collapse (paper section 4; Quicken et al. for the valences).

In "Surface fairing" small triangles are removed by collapsing their shortest edge,
conservatively: only if its two ends and their common neighbours all have valences
larger than three.

What the paper leaves open, and our choice:

- *Threshold*: the area bound is an argument, as for the subdivision.
- *Needles*, whose area is not small, have one short edge: an edge shorter than
  ``min_edge`` is collapsed too. (Caps, which have none, are left to the swaps.)
- *Where to*: the middle of the edge; the fixed vertex or the source if one end is one.
- *Order*: shortest edge first. Collapses whose stars share no vertex with a better
  one are done together; a few rounds.
- *Refused* are: an edge on the rim, or between two rim or kept vertices; ends with
  other than two common neighbours (the link condition: the result would not be a
  manifold); a change of shape; harm to a particle (see `jaxgrow.mesh.particle_guard`);
  a surface that crosses itself or a wall (see `jaxgrow.mesh.intersection_guard`). Of
  two collapses of a round that would cross each other, the one of the shorter edge is
  done.
- *Shape*: a collapse is refused for a triangle that turns by more than ``max_angle``
  (if it was a sliver, whose normal is meaningless: away from the mean normal of the
  star); a radius ratio below `FAIR_SHAPE`, unless the star had one as bad; a triangle
  over ``max_area``; an edge over ``max_edge``, unless the star had one as long; and a
  crease of more than 90 degrees where there was none as sharp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrow.mesh.collapse_ends import collapsing_stars, Ends, ends, Stars
from jaxgrow.mesh.intersection_guard import Crossing
from jaxgrow.mesh.particle_guard import Guard
from jaxgrow.mesh.quality import (
    area_vectors,
    areas,
    lengths,
    radius_ratio,
    side_lengths,
    unit,
)
from jaxgrow.mesh.surface import average_parents, Remeshing, Surface
from jaxgrow.mesh.topology import (
    build_topology,
    greedy_independent,
    group,
    Topology,
)


SLIVER = 0.05
"""Radius ratio below which a triangle's own normal is not trusted."""

FAIR_SHAPE = 0.3
"""Radius ratio that is good enough after a collapse, even if it was better before."""


@dataclass(frozen=True)
class _Limits:
    """Bounds of what is collapsed and of the result; see `collapse`."""

    min_area: float
    max_area: float
    min_edge: float
    max_edge: float
    max_angle: float


def collapse(
    surface: Surface,
    particles: Float[np.ndarray, "n 3"],
    *,
    min_area: float,
    max_area: float = np.inf,
    min_edge: float = 0.0,
    max_edge: float = np.inf,
    walls: Float[np.ndarray, "w 3 3"] | None = None,
    clearance: float = 0.15,
    gap: float = 0.05,
    max_angle: float = np.pi / 4,
    max_rounds: int = 8,
) -> tuple[Surface, Remeshing]:
    """Collapse the shortest edges of small triangles, and very short edges.

    Args:
        surface: An oriented manifold with or without rim.
        particles: Live particles, which must keep their side.
        min_area: Triangles below it are to vanish (length²).
        max_area: No collapse may make a triangle larger than this.
        min_edge: Edges below it are to vanish too (length).
        max_edge: No collapse may make an edge longer than this, unless the triangles
            around it had one as long (length).
        walls: Static triangles that the surface must not cross, oriented as it is;
            None for none.
        clearance: See `Guard` (length).
        gap: See `Crossing` (length).
        max_angle: Largest turn of a triangle (radians).
        max_rounds: Bound on the rounds.

    Returns:
        The surface and the remeshing that leads to it, with counts: "collapsed", and of
        the last round's wanted edges those refused by reason, "collapse_refused_rim",
        "…_valence", "…_link", "…_shape", "…_particle", "…_intersection".
    """
    limits = _Limits(min_area, max_area, min_edge, max_edge, max_angle)
    done = Remeshing.unchanged(surface)
    collapsed, refused = 0, {}
    for _ in range(max_rounds):
        guard = Guard(particles, surface.vertices, clearance)
        crossing = Crossing.of(surface.vertices, surface.faces, walls, gap)
        edges, topology, refused = _wanted(surface, (guard, crossing), limits)
        if topology is None or not len(edges):
            break
        surface, step = collapse_edges(
            surface, topology, edges, ends(surface, topology, edges)
        )
        done = done.then(step)
        collapsed += len(edges)
    done.counts.update(collapsed=collapsed, **refused)
    return surface, done


def collapse_edges(
    surface: Surface,
    topology: Topology,
    edges: Int[np.ndarray, " k"],
    merging: Ends,
) -> tuple[Surface, Remeshing]:
    """Collapse edges that share no triangle, unconditionally.

    Args:
        surface: The surface.
        topology: Its topology.
        edges: The edges to collapse.
        merging: Which of their ends stays, and where.

    Returns:
        The surface without the two triangles of each edge, and the map to it.
    """
    stays, goes, middle = merging.stays, merging.goes, merging.middle
    n_vertices = len(surface.vertices)
    parents = np.repeat(np.arange(n_vertices)[:, None], 2, axis=1)
    parents[stays[middle], 1] = goes[middle]
    alive = np.ones(n_vertices, dtype=bool)
    alive[goes] = False
    target = np.arange(n_vertices)
    target[goes] = stays
    number = np.cumsum(alive) - 1

    faces = np.delete(surface.faces, topology.edge_faces[edges].ravel(), axis=0)
    faces = number[target[faces]]
    parents = parents[alive]
    vertices = average_parents(surface.vertices, parents)
    fixed = surface.fixed[alive]
    source = int(number[surface.source]) if surface.source >= 0 else -1
    result = Surface(vertices, faces, fixed, source)
    return result, Remeshing((parents,), faces, fixed, source)


def _wanted(
    surface: Surface, guards: tuple[Guard, Crossing], limits: _Limits
) -> tuple[Int[np.ndarray, " k"], Topology | None, dict[str, int]]:
    """Select the edges to collapse now, with topology and refusals by reason."""
    triangles = surface.vertices[surface.faces]
    sides = side_lengths(triangles)
    want = sides < limits.min_edge
    small = np.flatnonzero(areas(triangles) < limits.min_area)
    want[small, sides[small].argmin(axis=1)] = True
    refused: dict[str, int] = {}
    if not want.any():
        return np.zeros(0, dtype=np.int64), None, refused
    topology = build_topology(surface.faces, len(surface.vertices))
    edges, where = np.unique(topology.face_edges[want], return_index=True)
    edges = edges[np.argsort(sides[want][where], kind="stable")]

    def keep(good: Bool[np.ndarray, " k"], reason: str) -> None:
        """Keep the good ones and count the others."""
        nonlocal edges
        refused[f"collapse_refused_{reason}"] = int(np.count_nonzero(~good))
        edges = edges[good]

    kept = surface.kept | topology.rim_vertices
    keep(topology.interior[edges] & ~kept[topology.edges[edges]].all(axis=1), "rim")
    around = np.concatenate([topology.edges, topology.opposite], axis=1)
    keep(np.all(topology.valence[around[edges]] > 3, axis=1), "valence")
    keep(common_neighbours(topology, edges) == 2, "link")
    stars = collapsing_stars(surface, ends(surface, topology, edges))
    good = _keeps_shape(stars, topology, triangles, limits)
    keep(good, "shape")
    stars = stars.select(good)
    for guard, reason in zip(guards, ("particle", "intersection"), strict=True):
        good = guard.admits(stars.patches())
        keep(good, reason)
        stars = stars.select(good)
    touched = surface.faces[stars.face].ravel()
    chosen = greedy_independent(np.repeat(stars.owner, 3), touched, len(edges))
    together = guards[1].compatible(stars.select(chosen).patches())
    return edges[chosen][together], topology, refused


def common_neighbours(
    topology: Topology, edges: Int[np.ndarray, " k"]
) -> Int[np.ndarray, " k"]:
    """Count the vertices joined by an edge to both ends of each edge."""
    n_vertices = len(topology.valence)
    both = np.concatenate([topology.edges, topology.edges[:, ::-1]])
    neighbours = group(both[:, 0], both[:, 1], n_vertices)
    keys = []
    for end in topology.edges[edges].T:
        owner, neighbour = neighbours.rows(end)
        keys.append(owner * n_vertices + neighbour)
    common = np.intersect1d(*keys, assume_unique=True)
    return np.bincount(common // max(n_vertices, 1), minlength=len(edges))


def _keeps_shape(
    stars: Stars,
    topology: Topology,
    triangles: Float[np.ndarray, "f 3 3"],
    limits: _Limits,
) -> Bool[np.ndarray, " k"]:
    """Return whether each collapse preserves the shape; see the module."""
    n_stars = len(stars.apex)
    worst = np.ones(n_stars)
    np.minimum.at(worst, stars.owner, radius_ratio(stars.old))
    longest = np.full(n_stars, limits.max_edge)
    np.maximum.at(longest, stars.owner, side_lengths(stars.old).max(axis=1))
    total = np.zeros((n_stars, 3))
    np.add.at(total, stars.owner, area_vectors(stars.old))

    stay = ~stars.gone
    owner, old, new = stars.owner[stay], stars.old[stay], stars.new[stay]
    was, becomes = area_vectors(old), area_vectors(new)
    before, after = unit(was), unit(becomes)
    ratio = radius_ratio(new)
    turned = _dot(before, after) < np.cos(limits.max_angle)
    trusted = radius_ratio(old) >= SLIVER
    away = _dot(after, total[owner]) <= 0
    bad = np.where(trusted, turned, away)
    bad |= ratio < np.minimum(FAIR_SHAPE, worst[owner])
    bad |= lengths(becomes) > np.maximum(limits.max_area, lengths(was))
    bad |= side_lengths(new).max(axis=1) > longest[owner]

    # Creases across the edge opposite the moved corner, to the triangle outside …
    link = topology.face_edges[stars.face[stay], (stars.corner[stay] + 1) % 3]
    pair, own = topology.edge_faces[link], stars.face[stay]
    other = np.where(pair[:, 0] == own, pair[:, 1], pair[:, 0])
    beyond = unit(area_vectors(triangles[other]))
    bad |= (other >= 0) & (_dot(after, beyond) < np.minimum(0.0, _dot(before, beyond)))
    # … and between neighbours in the star: one's link edge ends where the next starts.
    n_vertices = len(topology.valence)
    start = owner * n_vertices + stars.link[stay, 0]
    end = owner * n_vertices + stars.link[stay, 1]
    order = np.argsort(start)
    place = np.minimum(np.searchsorted(start[order], end), len(start) - 1)
    following = order[place] if len(order) else order
    joined = start[following] == end
    bad |= joined & (
        _dot(after, after[following]) < np.minimum(0.0, _dot(before, before[following]))
    )
    return np.bincount(owner[bad], minlength=n_stars) == 0


def _dot(
    a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """Return the scalar product of each pair of rows."""
    return np.einsum("ni,ni->n", a, b)
