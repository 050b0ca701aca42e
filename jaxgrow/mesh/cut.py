"""Remeshing of a surface along an iso-line, which then is a line of edges.

Phases:

1. *Snap.* A vertex nearer to the line than a share of a crossed edge moves along this
   edge onto the line, the nearest first. If a triangle would tip over or become thin,
   the vertex stays where it is and the line passes through it instead.
2. *Cut.* Every edge that is still crossed gets a vertex at the crossing, and its
   triangles are split: T-shape or A-shape, the latter by the better diagonal.
3. *Fair.* The line's vertices move along the surface, to where a filter that smooths
   without shrinking (G. Taubin, *A Signal Processing Approach to Fair Surface Design*,
   1995) has them, or half-way, as long as no triangle tips over or becomes thin.

A cut alone does not move the surface, so it is safe for all that lies beside it. The
other two keep vertices on it, but the triangles between them move a little.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrow.mesh.intersection import intersecting_pairs
from jaxgrow.mesh.isoline import trace_isolines
from jaxgrow.mesh.proximity import Proximity
from jaxgrow.mesh.quality import area_vectors, lengths, radius_ratio, unit
from jaxgrow.mesh.subdivide import split_faces
from jaxgrow.mesh.topology import build_topology, group, Incidence


SNAP = 0.3
"""Share of a crossed edge below which its end is taken onto the line."""

UPRIGHT = 0.7
"""Least cosine between the normals of a triangle before and after a move."""

STOUT = 0.3
"""Quality 2 r_in / r_circ below which a move may not bring a triangle that was better,
nor worsen one that was worse."""

SPIKE = 2.0**-10
"""How far below the level a vertex of the line is put that would be a spike."""

PASSES = 10
"""Number of passes of the filter that fairs the line."""

_SHRINK, _GROW = 0.5, -0.53


class Cut(NamedTuple):
    """Surface whose edges follow a line.

    Attributes:
        vertices: First the old ones, in their order; then those on crossed edges.
        faces: First the old faces that were not cut, in their order.
        values: The scalar on all vertices; exactly the level on the line.
        parents: Ends of the edge that each new vertex lies on.
        share: Place of each new vertex on it, from the first parent (0) to the second.
        moved: The old vertices that were moved.
        shift: How far each was moved.
        met: Number of old vertices that the line was taken to instead.
        faired: Number of vertices, old or new, that were moved along the surface.
        quality: Least 2 r_in / r_circ of the faces that are new or at a moved vertex;
            1 if there is none.
    """

    vertices: Float[np.ndarray, "m 3"]
    faces: Int[np.ndarray, "f 3"]
    values: Float[np.ndarray, " m"]
    parents: Int[np.ndarray, "k 2"]
    share: Float[np.ndarray, " k"]
    moved: Int[np.ndarray, " j"]
    shift: Float[np.ndarray, " j"]
    met: int
    faired: int
    quality: float

    def interpolate(self, values: Float[np.ndarray, " o"]) -> Float[np.ndarray, " m"]:
        """Interpolate another scalar of the old vertices to the new ones."""
        first, second = values[self.parents.T]
        return np.concatenate([values, first + self.share * (second - first)])


def cut_along(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    values: Float[np.ndarray, " m"],
    level: float,
    *,
    moving: bool = True,
) -> Cut:
    """Cut a surface along an iso-line, so that no edge crosses it.

    The part of the surface with values not below the level is bounded by edges of the
    result. A vertex on the line that would be a spike of this part, without a triangle,
    is put `SPIKE` below the level. The result has the Euler number of the surface that
    it was made from, and no self-intersection that this had not.

    Args:
        vertices: Positions, any one unit of length.
        faces: Closed oriented manifold.
        values: A scalar on the vertices, linear on each triangle.
        level: Its value on the line.
        moving: Whether vertices may be moved onto the line; else the line is taken to
            them, the surface stays where it is, and the line is less smooth.

    Returns:
        The surface.
    """
    topology = build_topology(faces, len(vertices))
    snapped = _snap(vertices, faces, values, level, topology.edges, moving=moving)
    result = _cut(snapped, faces, level, topology.edges, topology.face_edges)
    result = result._replace(values=_without_spikes(result.faces, result.values, level))
    if moving:
        result = _fair(result, level, Proximity(vertices, faces))
    old = result.vertices[: len(vertices)]
    moved = np.flatnonzero((old != vertices).any(axis=1))
    touched = _touched(result.faces, len(vertices), moved)
    if moving and _meets(result.vertices, result.faces, touched):
        return cut_along(vertices, faces, values, level, moving=False)
    quality = radius_ratio(result.vertices[result.faces[touched]]).min(initial=1.0)
    return result._replace(
        moved=moved,
        shift=lengths((old - vertices)[moved]),
        quality=float(quality),
    )


class _Snapped(NamedTuple):
    vertices: Float[np.ndarray, "m 3"]
    values: Float[np.ndarray, " m"]
    met: int


def _snap(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    values: Float[np.ndarray, " m"],
    level: float,
    edges: Int[np.ndarray, "e 2"],
    *,
    moving: bool,
) -> _Snapped:
    """Move the vertices that are near the line onto it, the nearest first."""
    vertices, values, at = vertices.copy(), values.copy(), _fans(vertices, faces)
    near = edges[_crossed(values, edges, level)]
    pairs = np.concatenate([near, near[:, ::-1]])
    own, other = values[pairs].T
    share = (level - own) / (other - own)
    met, above = 0, int(np.count_nonzero(values > level))
    for i in np.argsort(share, kind="stable"):
        if share[i] >= SNAP:
            break
        vertex, end = pairs[i].tolist()
        if values[vertex] == level or values[end] == level:
            continue
        if values[vertex] > level:
            if above == 1:  # the part within would vanish
                continue
            above -= 1
        place = vertices[vertex] + share[i] * (vertices[end] - vertices[vertex])
        around = faces[at.rows(np.array([vertex]))[1]]
        if moving and _stays_sound(vertices, around, vertex, place):
            vertices[vertex] = place
        else:
            met += 1
        values[vertex] = level
    return _Snapped(vertices, values, met)


def _fans(
    vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
) -> Incidence:
    """List the faces at each vertex."""
    return group(faces.ravel(), np.repeat(np.arange(len(faces)), 3), len(vertices))


def _crossed(
    values: Float[np.ndarray, " m"], edges: Int[np.ndarray, "e 2"], level: float
) -> Bool[np.ndarray, " e"]:
    """Mark edges whose ends lie strictly on two sides of the line."""
    side = np.sign(values - level)[edges]
    return side[:, 0] * side[:, 1] < 0


def _stays_sound(
    vertices: Float[np.ndarray, "m 3"],
    around: Int[np.ndarray, "k 3"],
    vertex: int,
    place: Float[np.ndarray, "3"],
) -> bool:
    """Return whether a vertex can move without a tipped or thin triangle."""
    before = vertices[around]
    after = np.where((around == vertex)[:, :, None], place, before)
    turned = np.einsum(
        "ki,ki->k", unit(area_vectors(before)), unit(area_vectors(after))
    )
    least = np.minimum(radius_ratio(before), STOUT)
    return bool((turned >= UPRIGHT).all() and (radius_ratio(after) >= least).all())


def _cut(
    snapped: _Snapped,
    faces: Int[np.ndarray, "f 3"],
    level: float,
    edges: Int[np.ndarray, "e 2"],
    face_edges: Int[np.ndarray, "f 3"],
) -> Cut:
    """Split the edges that the line crosses, and their faces."""
    vertices, values, met = snapped
    crossed = _crossed(values, edges, level)
    parents = edges[crossed]
    own, other = values[parents].T
    share = (level - own) / (other - own)
    first, second = vertices[parents[:, 0]], vertices[parents[:, 1]]
    new = np.full(len(edges), -1)
    new[crossed] = len(vertices) + np.arange(len(parents))
    points = np.concatenate([vertices, first + share[:, None] * (second - first)])
    return Cut(
        vertices=points,
        faces=split_faces(points, faces, new[face_edges]),
        values=np.concatenate([values, np.full(len(parents), level)]),
        parents=parents,
        share=share,
        moved=np.zeros(0, dtype=np.int64),
        shift=np.zeros(0),
        met=met,
        faired=0,
        quality=1.0,
    )


def _without_spikes(
    faces: Int[np.ndarray, "f 3"], values: Float[np.ndarray, " m"], level: float
) -> Float[np.ndarray, " m"]:
    """Strip the line of vertices that bound no triangle within."""
    values = values.copy()
    while True:
        bounding = np.zeros(len(values), dtype=bool)
        bounding[faces[values[faces].min(axis=1) >= level]] = True
        loose = (values == level) & ~bounding
        if not loose.any():
            return values
        values[loose] = level - SPIKE


def _fair(cut: Cut, level: float, former: Proximity) -> Cut:
    """Fair the line along the surface."""
    vertices, at = cut.vertices.copy(), _fans(cut.vertices, cut.faces)
    faired = 0
    for line in trace_isolines(vertices, cut.faces, cut.values, level):
        wanted = former.nearest(_filtered(line.points)).closest
        for vertex, place in zip(line.within.tolist(), wanted, strict=True):
            around = cut.faces[at.rows(np.array([vertex]))[1]]
            middle = (vertices[vertex] + place) / 2
            for target in (place, former.nearest(middle[None]).closest[0]):
                if _stays_sound(vertices, around, vertex, target):
                    vertices[vertex] = target
                    faired += 1
                    break
    return cut._replace(vertices=vertices, faired=faired)


def _filtered(points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
    """Filter a closed polygon."""
    for factor in PASSES * (_SHRINK, _GROW):
        middle = (np.roll(points, 1, axis=0) + np.roll(points, -1, axis=0)) / 2
        points = points + factor * (middle - points)
    return points


def _touched(
    faces: Int[np.ndarray, "f 3"], old: int, moved: Int[np.ndarray, " j"]
) -> Bool[np.ndarray, " f"]:
    """Mark the faces with a new vertex or a moved one."""
    return np.asarray(((faces >= old) | np.isin(faces, moved)).any(axis=1))


def _meets(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    touched: Bool[np.ndarray, " f"],
) -> bool:
    """Return whether a touched face intersects any other."""
    ordered = np.concatenate([faces[touched], faces[~touched]])
    return any(map(len, intersecting_pairs(vertices, ordered, int(touched.sum()))))
