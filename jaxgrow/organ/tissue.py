"""Tissue particles in the layer under a patch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from jaxgrow.mesh.proximity import closest_on_triangles, nearest_on_mesh
from jaxgrow.mesh.quality import area_vectors, lengths, unit
from jaxgrow.mesh.topology import build_topology
from jaxgrow.organ.organ import Organ, OrganError
from jaxgrow.organ.patch import Patch


DISTANCE = 0.8
"""Smallest distance of two particles over the spacing, if the density allows it.

Random sequential packing of equal spheres jams at a volume fraction of 0.384, that is
at 1.43 particles per spacing³ for this distance.
"""

SHRINK = 0.95
"""Factor on the smallest distance when no more particles fit."""

PATIENCE = 20
"""Batches of candidates in a row that may bring less than a hundredth of what is
missing before the distance shrinks."""

BATCH = 2000
"""Darts a batch."""

CELL = 0.7
"""Side, over the spacing, of the cells that the layer is surveyed with."""

FEWEST_CELLS, MOST_CELLS = 12_000, 40_000
"""Of a survey: a small layer's volume is to be known to a per cent or two, and a large
one is to be surveyed in a second."""


@dataclass(frozen=True, eq=False)
class Tissue:
    """Particles of healthy tissue under a patch.

    Attributes:
        points: Local positions in r0 (``Patch.to_local``).
        held: Those near the bottom or the sides of the layer, which stay in place.
        depth: Distance of each to the organ's surface in r0.
        distance: The smallest distance of two points that was enforced, in r0.
        volume: Of the layer in r0³, estimated.
    """

    points: Float[np.ndarray, "n 3"]
    held: Bool[np.ndarray, "n"]
    depth: Float[np.ndarray, "n"]
    distance: float
    volume: float


def fill_tissue(
    organ: Organ,
    patch: Patch,
    *,
    spacing: float,
    density: float,
    thickness: float,
    gap: float,
    hold: float,
    rng: np.random.Generator,
) -> Tissue:
    """Fill the layer under a patch with random particles, none close to another.

    The layer is what lies on the tissue's side, has its nearest point of the organ's
    surface on the patch, and is between ``gap`` and ``thickness`` away from it. Darts
    are thrown at it; one that lands within 0.8 ``spacing`` of an earlier one is
    discarded (paper section 3: tissue is distributed randomly; the minimum distance is
    ours, so that relaxation has little to do). If no more fit, the distance shrinks.
    All lengths are in r0.

    Args:
        organ: The organ.
        patch: A patch of it.
        spacing: Distance of neighbours that the particles are to have.
        density: Particles per spacing³.
        thickness: Of the layer.
        gap: Free depth just under the surface.
        hold: Particles within this distance of the layer's bottom or sides are held.
        rng: Draws the darts; the same generator state gives the same particles.

    Returns:
        The particles.

    Raises:
        OrganError: If a length makes no sense or the layer has no room.
    """
    if not (0 <= gap < thickness and spacing > 0 and density > 0 and hold >= 0):
        msg = (
            f"a tissue layer with spacing {spacing:g}, density {density:g}, thickness "
            f"{thickness:g}, gap {gap:g} and hold {hold:g} (in r0) cannot be filled: "
            "spacing and density must be positive, hold not negative, and the gap "
            "smaller than the thickness."
        )
        raise OrganError(msg)
    layer = _Layer(organ, patch, gap, thickness)
    survey = _survey(layer, CELL * spacing, rng)
    wanted = round(density * survey.volume / spacing**3)
    if wanted < 1:
        msg = (
            f"the tissue layer under the patch has a volume of only "
            f"{survey.volume:.3g} r0³ between the depths {gap:g} and {thickness:g} r0, "
            "no room for a particle: the wall is too thin there for this lesion, "
            "choose another site."
        )
        raise OrganError(msg)
    points, depth, distance = _throw_darts(
        layer, survey, wanted, DISTANCE * spacing, rng
    )
    held = (depth > thickness - hold) | (layer.distance_to_sides(points) < hold)
    return Tissue(points, held, depth, distance, survey.volume)


@dataclass(frozen=True, eq=False)
class _Survey:
    """One random point in each cell of a grid over the layer's box, if in the layer.

    Stratified points measure the volume much better than independent ones, and they
    tell where to throw darts.
    """

    points: Float[np.ndarray, "n 3"]
    depth: Float[np.ndarray, "n"]
    cell: Float[np.ndarray, "3"]
    volume: float


def _survey(layer: _Layer, side: float, rng: np.random.Generator) -> _Survey:
    size = layer.high - layer.low
    coarsest, finest = np.cbrt(np.prod(size) / [FEWEST_CELLS, MOST_CELLS])
    side = float(np.clip(side, finest, coarsest))
    cells = np.ceil(size / side).astype(np.int64)
    corner = np.stack(
        np.meshgrid(*(np.arange(number) for number in cells), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    cell = size / cells
    tried = layer.low + (corner + rng.uniform(size=corner.shape)) * cell
    points, depth = layer.inside(tried)
    volume = float(np.prod(cell) * len(points))
    order = rng.permutation(len(points))
    return _Survey(points[order], depth[order], cell, volume)


def _throw_darts(
    layer: _Layer,
    survey: _Survey,
    wanted: int,
    distance: float,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n"], float]:
    """Particles until there are enough, at the largest distance that allows it.

    The survey's points are the first darts; further ones fall within one cell of
    those, which reaches every corner of the layer and seldom misses it.
    """
    first = _greedy(survey.points, distance)[:wanted]
    points, depth = survey.points[first], survey.depth[first]
    idle = 0
    while len(points) < wanted:
        missing = wanted - len(points)
        near = survey.points[rng.integers(len(survey.points), size=BATCH)]
        darts = near + rng.uniform(-1, 1, size=(BATCH, 3)) * survey.cell
        gap = KDTree(points).query(darts, distance_upper_bound=distance)[0]
        new, new_depth = layer.inside(darts[np.isinf(gap)])
        free = _greedy(new, distance)[:missing]
        points = np.concatenate([points, new[free]])
        depth = np.concatenate([depth, new_depth[free]])
        idle = 0 if 100 * len(free) >= missing else idle + 1
        if idle >= PATIENCE:
            idle, distance = 0, distance * SHRINK
    return points, depth, distance


def _greedy(points: Float[np.ndarray, "n 3"], distance: float) -> Int[np.ndarray, "k"]:
    """Points, first come first kept, none closer than ``distance`` to a kept one."""
    free = np.ones(len(points), dtype=bool)
    if len(points):
        pairs = KDTree(points).query_pairs(distance, output_type="ndarray")
        for first, second in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]:
            if free[first]:
                free[second] = False
    return np.flatnonzero(free)


class _Layer:
    """The space under a patch: which points lie in it, and how deep."""

    def __init__(
        self, organ: Organ, patch: Patch, gap: float, thickness: float
    ) -> None:
        self.gap, self.thickness = gap, thickness
        vertices = patch.to_local(organ.vertices)
        self.low = patch.vertices.min(axis=0) - thickness
        self.high = patch.vertices.max(axis=0) + thickness
        # no triangle further than the thickness from the box can be the nearest one
        # of a point of the layer
        corners = vertices[organ.faces]
        near = (corners.max(axis=1) >= self.low - thickness).all(axis=1)
        near &= (corners.min(axis=1) <= self.high + thickness).all(axis=1)
        self.vertices = vertices
        self.faces = organ.faces[near]
        self.on_patch = patch.face_mask[near]
        self.tissue_sign = -organ.lumen_sign
        self.pseudonormals = _pseudonormals(vertices, self.faces)
        triangles = patch.vertices[patch.faces]
        self.centres = KDTree(triangles.mean(axis=1))
        self.radius = lengths(triangles - triangles.mean(axis=1)[:, None]).max()
        self.side = _side_walls(patch, self.pseudonormals[2], thickness, organ)

    def inside(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k"]]:
        """The points that lie in the layer, and their depth."""
        reach = self.thickness + self.radius
        found = self.centres.query(points, distance_upper_bound=reach)[0]
        points = points[np.isfinite(found)]
        depth, inside = self.depth(points)
        return points[inside], depth[inside]

    def depth(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
        """Exact distance to the organ's surface, and whether the point is inside.

        The side is the sign of (x - c) · n with c the closest point and n the
        pseudonormal there: of the triangle, of the edge (sum of its two triangles) or
        of the vertex (sum weighted by angle), whichever c lies on. This sign is exact
        (Baerentzen & Aanaes, Signed distance computation using the angle weighted
        pseudonormal, IEEE TVCG 11, 2005).
        """
        if not len(points):
            return np.zeros(0), np.zeros(0, dtype=bool)
        distance, face, closest = nearest_on_mesh(points, self.vertices, self.faces)
        weights = closest_on_triangles(points, self.vertices[self.faces[face]])[1]
        of_face, of_edge, of_vertex = self.pseudonormals
        normal = of_face[face]
        absent = weights == 0
        on_edge = absent.sum(axis=1) == 1
        # the side that starts after the corner without weight
        side = (np.argmax(absent, axis=1) + 1) % 3
        normal = np.where(on_edge[:, None], of_edge[face, side], normal)
        corner = self.faces[face, np.argmax(weights, axis=1)]
        on_vertex = absent.sum(axis=1) == 2
        normal = np.where(on_vertex[:, None], of_vertex[corner], normal)
        outside = np.einsum("ni,ni->n", points - closest, normal)
        inside = (
            (self.tissue_sign * outside > 0)
            & (distance >= self.gap)
            & (distance <= self.thickness)
            & self.on_patch[face]
        )
        return distance, inside

    def distance_to_sides(
        self, points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n"]:
        """Distance to the walls that drop from the rim along its normals."""
        vertices, faces = self.side
        return nearest_on_mesh(points, vertices, faces)[0]


def _pseudonormals(
    vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[
    Float[np.ndarray, "f 3"], Float[np.ndarray, "f 3 3"], Float[np.ndarray, "m 3"]
]:
    """Pseudonormals of the faces, of the three sides of each face, of the vertices."""
    triangles = vertices[faces]
    normal = unit(area_vectors(triangles))
    topology = build_topology(faces, len(vertices))
    left, right = topology.edge_faces.T
    # a missing neighbour (the cut-out's end) adds nothing
    of_edge = np.where(left[:, None] >= 0, normal[left], 0)
    of_edge = of_edge + np.where(right[:, None] >= 0, normal[right], 0)
    to_next = unit((triangles[:, [1, 2, 0]] - triangles).reshape(-1, 3))
    to_last = unit((triangles[:, [2, 0, 1]] - triangles).reshape(-1, 3))
    angle = np.arctan2(
        lengths(np.cross(to_next, to_last)), np.einsum("ni,ni->n", to_next, to_last)
    )
    weighted = angle[:, None] * np.repeat(normal, 3, axis=0)
    corner, size = faces.ravel(), len(vertices)
    columns = [np.bincount(corner, weights=w, minlength=size) for w in weighted.T]
    return normal, of_edge[topology.face_edges], np.stack(columns, axis=1)


def _side_walls(
    patch: Patch,
    vertex_normals: Float[np.ndarray, "m 3"],
    thickness: float,
    organ: Organ,
) -> tuple[Float[np.ndarray, "w 3"], Int[np.ndarray, "s 3"]]:
    """The strip from the rim down to the bottom, two triangles a rim edge."""
    topology = build_topology(patch.faces, len(patch.vertices))
    edges = topology.edges[~topology.interior]
    down = -organ.lumen_sign * unit(vertex_normals[patch.organ_index])
    bottom = patch.vertices + thickness * down
    first, second = edges.T
    below = len(patch.vertices)
    faces = np.concatenate(
        [
            np.stack([first, second, second + below], axis=1),
            np.stack([first, second + below, first + below], axis=1),
        ]
    )
    return np.concatenate([patch.vertices, bottom]), faces
