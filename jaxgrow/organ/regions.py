"""Base, stalk and head of a lesion, by its sections along the surface.

A section is a level set of a harmonic function u on the lesion: 0 on the healthy
surface around it, with a source at the tip, the vertex farthest from there. Its weights
are positive, so u has no maximum but the tip, and every section is one closed curve:
round the foot, up a stalk however it bends, over the head to the tip. A stalk is where
the sections are narrow, with a wider one nearer to the tip.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse import csr_array, diags_array
from scipy.sparse.csgraph import dijkstra
from scipy.sparse.linalg import spsolve

from jaxgrow.mesh.quality import areas, lengths
from jaxgrow.mesh.topology import connected_parts


LESION = 0.5
"""Value of the smooth label from which on a vertex belongs to the lesion."""

NECK = 0.8
"""A lesion has a stalk if its narrowest section is at most this share of the widest one
nearer to the tip."""

RIM = 0.1
"""Share of the base's diameter (length of its ring over π) up to which a vertex, by its
distance from the healthy surface along edges, belongs to the base of any lesion."""

_SECTIONS = 100
_LEAST_WEIGHT = 1e-2


class Region(enum.IntEnum):
    """Part of the grown organ's surface."""

    HEALTHY = 0
    BASE = 1
    STALK = 2
    HEAD = 3


class Regions(NamedTuple):
    """Parts of a surface.

    Attributes:
        region: A `Region` for every vertex.
        neck: Length of the narrowest section's circumference; None without a stalk.
    """

    region: UInt8[np.ndarray, " m"]
    neck: float | None


class _Sections(NamedTuple):
    """Circumferences of a lesion from its base to its tip.

    Attributes:
        level: value of u.
        length: of the section, in the unit of the vertices.
    """

    level: Float[np.ndarray, " s"]
    length: Float[np.ndarray, " s"]


def find_regions(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    lesion: Float[np.ndarray, " m"],
    ring_length: float,
) -> Regions:
    """Divide the lesion's surface into base, stalk and head.

    With a stalk, the base ends where the sections have narrowed half-way from the
    widest one of the foot to the neck, and the head begins where they have widened
    half-way from the neck to the widest one of the head. Without, all is head but the
    base, which is the zone within `RIM` of the base's diameter from the healthy
    surface. Pits in a lesion (healthy vertices that it encloses) stay healthy; parts
    that are not connected with the largest one are base.

    Args:
        vertices: Positions, any one unit of length.
        faces: Closed oriented manifold.
        lesion: Smooth label of every vertex, from 0 to 1.
        ring_length: Length of the base's ring.

    Returns:
        The regions.
    """
    inside = lesion >= LESION
    region = np.where(inside, Region.BASE, Region.HEALTHY).astype(np.uint8)
    domain = _domain(faces, inside)
    if not inside.any() or not domain.any():
        return Regions(region, None)
    weights, distance = _graphs(vertices, faces, domain)
    beyond = (distance > RIM * ring_length / np.pi) & ~_next_to(faces, ~domain)
    if not (beyond & domain & inside).any():
        return Regions(region, None)
    tip = int(np.argmax(np.where(domain, distance, -1.0)))
    u = _harmonic(weights, domain, tip)
    sections = _sections(vertices, faces, u)
    head = inside & domain & beyond
    bounds = _stalk(sections)
    if bounds is None:
        region[head] = Region.HEAD
        return Regions(region, None)
    low, high, neck = bounds
    region[head & (u >= low)] = Region.STALK
    region[head & (u >= high)] = Region.HEAD
    return Regions(region, neck)


def _domain(
    faces: Int[np.ndarray, "f 3"], inside: Bool[np.ndarray, " m"]
) -> Bool[np.ndarray, " m"]:
    """Mark the largest part of the lesion, with the pits that it encloses."""
    around = _largest(faces, ~inside)
    return _largest(faces, ~around) if around.any() else np.zeros_like(inside)


def _largest(
    faces: Int[np.ndarray, "f 3"], chosen: Bool[np.ndarray, " m"]
) -> Bool[np.ndarray, " m"]:
    """Mark the largest connected part of the chosen vertices."""
    used = np.zeros_like(chosen)
    used[faces] = True
    part = connected_parts(faces, chosen)
    sizes = np.bincount(part[chosen & used], minlength=part.max(initial=0) + 1)
    return chosen & used & (part == np.argmax(sizes))


def _next_to(
    faces: Int[np.ndarray, "f 3"], chosen: Bool[np.ndarray, " m"]
) -> Bool[np.ndarray, " m"]:
    """Mark the vertices of all faces with a chosen vertex."""
    marked = np.zeros_like(chosen)
    marked[faces[chosen[faces].any(axis=1)]] = True
    return marked


def _graphs(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    domain: Bool[np.ndarray, " m"],
) -> tuple[csr_array, Float[np.ndarray, " m"]]:
    """Compute the domain's cotangent weights, and distances from its outside.

    The weights are at least `_LEAST_WEIGHT`, so that u has no other maximum than the
    tip. Distances are along edges; they are 0 outside.
    """
    own = faces[domain[faces].any(axis=1)]
    rows, columns, weight = [], [], []
    for k in range(3):
        apex, one, other = own[:, k], own[:, (k + 1) % 3], own[:, (k + 2) % 3]
        a, b = vertices[one] - vertices[apex], vertices[other] - vertices[apex]
        double_area = np.maximum(lengths(np.cross(a, b)), np.finfo(float).tiny)
        cotangent = np.einsum("fi,fi->f", a, b) / double_area
        rows += [one, other]
        columns += [other, one]
        weight += [cotangent / 2, cotangent / 2]
    i, j = np.concatenate(rows), np.concatenate(columns)
    shape = (len(vertices), len(vertices))
    weights = csr_array((np.concatenate(weight), (i, j)), shape=shape)
    weights.sum_duplicates()
    weights.data = np.maximum(weights.data, _LEAST_WEIGHT)
    i, j = weights.nonzero()
    edges = csr_array((lengths(vertices[i] - vertices[j]), (i, j)), shape=shape)
    border = np.unique(own[~domain[own]])
    distance = dijkstra(edges, indices=border, min_only=True)
    return weights, np.where(domain, distance, 0.0)


def _harmonic(
    weights: csr_array, domain: Bool[np.ndarray, " m"], tip: int
) -> Float[np.ndarray, " m"]:
    """Solve Laplace's equation: 0 outside the domain, 1 at the tip."""
    own = np.flatnonzero(domain)
    total = np.asarray(weights.sum(axis=1))[own]
    matrix = diags_array(total) - weights[own][:, own]
    source = (own == tip).astype(float)
    u = np.zeros(len(domain))
    u[own] = np.asarray(spsolve(matrix.tocsc(), source))
    return u / u[tip]


def _sections(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    u: Float[np.ndarray, " m"],
) -> _Sections:
    """Measure sections that divide the lesion's area equally."""
    own = faces[(u[faces] > 0).any(axis=1)]
    value = u[own].mean(axis=1)
    order = np.argsort(value)
    share = np.cumsum(areas(vertices[own])[order])
    wanted = share[-1] * np.arange(1, _SECTIONS) / _SECTIONS
    level = value[order][np.searchsorted(share, wanted)]
    length = np.array([_section_length(vertices, own, u, at) for at in level])
    return _Sections(level, length)


def _section_length(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    u: Float[np.ndarray, " m"],
    level: float,
) -> float:
    """Measure u's level line on the faces."""
    above = u[faces] >= level
    crossed = faces[above.any(axis=1) & ~above.all(axis=1)]
    tail, head = crossed, np.roll(crossed, -1, axis=1)
    cut = (u[tail] >= level) != (u[head] >= level)
    one, other = tail[cut], head[cut]
    share = (level - u[one]) / (u[other] - u[one])
    points = vertices[one] + share[:, None] * (vertices[other] - vertices[one])
    return float(lengths(points[1::2] - points[::2]).sum())


def _stalk(sections: _Sections) -> tuple[float, float, float] | None:
    """Find where a stalk begins and ends (u), and its least circumference."""
    level, length = sections
    narrowest = np.minimum.accumulate(length)
    widest = int(np.argmax(length / narrowest))
    neck = int(np.argmin(length[: widest + 1]))
    if length[neck] > NECK * length[widest]:
        return None
    foot = length[: neck + 1].max()
    below = length[: neck + 1] > (length[neck] + foot) / 2
    above = length[neck : widest + 1] > (length[neck] + length[widest]) / 2
    low = level[np.flatnonzero(below)[-1]] if below.any() else 0.0
    high = level[neck + np.argmax(above)]
    return float(low), float(high), float(length[neck])
