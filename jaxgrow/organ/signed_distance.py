"""Signed distance to an oriented surface, by pseudonormals."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxgrow.mesh.proximity import Proximity
from jaxgrow.mesh.quality import area_vectors, lengths, unit
from jaxgrow.mesh.topology import build_topology


class SignedDistance(NamedTuple):
    """Distance and side of points with respect to a surface.

    Attributes:
        distance: Exact distance to the surface, not negative.
        side: Positive where the normals point to, negative behind; zero on it.
        face: The triangle that is nearest.
    """

    distance: Float[np.ndarray, "n"]
    side: Float[np.ndarray, "n"]
    face: Int[np.ndarray, "n"]


class Sides:
    """Surface with the pseudonormals that give the sign of distances.

    The side of a point x is the sign of (x - c) · n with c the closest point and n the
    pseudonormal there: of the triangle, of the edge (sum of its two triangles) or of
    the vertex (sum weighted by angle), whichever c lies on. This sign is exact for a
    surface that does not meet itself (Baerentzen & Aanaes, Signed distance computation
    using the angle weighted pseudonormal, IEEE TVCG 11, 2005).

    If a box is given, only the triangles that reach into it are kept: make it so large
    that none outside it can be the nearest of a query point.

    Attributes:
        vertices: All vertices.
        faces: The triangles kept.
        kept: Their indices among all.
        vertex_normals: Pseudonormals of the vertices, not of length one.
    """

    def __init__(
        self,
        vertices: Float[np.ndarray, "m 3"],
        faces: Int[np.ndarray, "f 3"],
        low: Float[np.ndarray, "3"] | float = -np.inf,
        high: Float[np.ndarray, "3"] | float = np.inf,
    ) -> None:
        corners = vertices[faces]
        near = (corners.max(axis=1) >= low).all(axis=1)
        near &= (corners.min(axis=1) <= high).all(axis=1)
        self.vertices = vertices
        self.kept = np.flatnonzero(near)
        self.faces = faces[near]
        self.face_normals, self.side_normals, self.vertex_normals = _pseudonormals(
            vertices, self.faces
        )

    @cached_property
    def _proximity(self) -> Proximity:
        return Proximity(self.vertices, self.faces)

    def measure(self, points: Float[np.ndarray, "n 3"]) -> SignedDistance:
        """Compute distance, side and nearest triangle of each point."""
        if not len(points):
            return SignedDistance(np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64))
        distance, face, weights = self._proximity.feet(points)
        closest = self._proximity.at(face, weights)
        normal = self.face_normals[face]
        absent = weights == 0
        on_edge = absent.sum(axis=1) == 1
        # the side that starts after the corner without weight
        start = (np.argmax(absent, axis=1) + 1) % 3
        normal = np.where(on_edge[:, None], self.side_normals[face, start], normal)
        corner = self.faces[face, np.argmax(weights, axis=1)]
        on_vertex = absent.sum(axis=1) == 2
        normal = np.where(on_vertex[:, None], self.vertex_normals[corner], normal)
        side = np.einsum("ni,ni->n", points - closest, normal)
        return SignedDistance(distance, side, self.kept[face])


def _pseudonormals(
    vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[
    Float[np.ndarray, "f 3"], Float[np.ndarray, "f 3 3"], Float[np.ndarray, "m 3"]
]:
    """Compute the pseudonormals of faces, of their sides, and of vertices."""
    triangles = vertices[faces]
    normal = unit(area_vectors(triangles))
    topology = build_topology(faces, len(vertices))
    left, right = topology.edge_faces.T
    # a missing neighbour (at the end of the cut-out) adds 0
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
