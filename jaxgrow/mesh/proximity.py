"""Exact distance from points to triangles and to a mesh."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxgrow import kernels


def closest_on_triangles(
    points: Float[np.ndarray, "n 3"], triangles: Float[np.ndarray, "n 3 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Compute the distance of point i to triangle i, and the closest point.

    The foot of the perpendicular, where it falls inside; otherwise the nearest of the
    three sides. This covers every Voronoi region, and degenerate triangles (segments,
    points) too, as their interior is not used.

    Args:
        points: Positions.
        triangles: Corners, in the same unit of length.

    Returns:
        Distances, and barycentric weights (non-negative, sum 1) of the closest point.
    """
    corners = np.require(triangles, float, ["C", "W"]).reshape(-1, 3)
    points = np.require(points, float, ["C", "W"])
    return kernels.loops("distances").to_triangles(points, corners)


class Nearest(NamedTuple):
    """Nearest point of a mesh for each query point.

    Attributes:
        distance: Exact distance.
        face: The face where it is reached; any one of equally near faces (a closest
            point on an edge).
        closest: The closest point.
    """

    distance: Float[np.ndarray, " n"]
    face: Int[np.ndarray, " n"]
    closest: Float[np.ndarray, "n 3"]


class Proximity:
    """Bounding volume tree of a mesh, for repeated nearest-point queries.

    The tree is one of boxes, see `jaxgrow.kernels.nearest`.
    """

    def __init__(
        self, vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
    ) -> None:
        """Sort the triangles.

        Args:
            vertices: Mesh vertices.
            faces: Mesh faces, at least one.

        Raises:
            ValueError: The mesh has no face.
        """
        if not len(faces):
            raise ValueError(
                "the mesh has no face; a distance to nothing is undefined."
            )
        # one dtype and layout, as loops are compiled for each
        self._vertices = np.require(vertices, float, ["C", "W"])
        self._faces = np.require(faces, np.int64, ["C", "W"])
        self._tree = kernels.loops("nearest").plant(self._vertices, self._faces)

    def nearest(self, points: Float[np.ndarray, "n 3"]) -> Nearest:
        """Find distances, faces and closest points, in the mesh's unit."""
        distance, face, weights = self.feet(points)
        return Nearest(distance, face, self.at(face, weights))

    def at(
        self, face: Int[np.ndarray, " n"], weights: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Return the points on faces with the given barycentric weights."""
        return np.einsum("nk,nki->ni", weights, self._vertices[self._faces[face]])

    def feet(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[
        Float[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]
    ]:
        """Find distances, faces, and barycentric weights of the closest points."""
        points, loops = np.require(points, float, ["C", "W"]), kernels.loops("nearest")
        return loops.find(points, self._vertices, self._faces, *self._tree)


def nearest_on_mesh(
    points: Float[np.ndarray, "n 3"],
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
) -> Nearest:
    """Find the exact distance to a mesh, with its face and closest point.

    For repeated queries of a mesh, keep a `Proximity`.

    Args:
        points: Positions.
        vertices: Mesh vertices, in the same unit.
        faces: Mesh faces, at least one.

    Returns:
        Distances, face indices, closest points.

    Raises:
        ValueError: The mesh has no face.
    """
    return Proximity(vertices, faces).nearest(points)


def closest_on_segments(
    first: Float[np.ndarray, "n 2 3"], second: Float[np.ndarray, "n 2 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Compute the distance of segment i of one list to i of the other.

    The common perpendicular, where both of its feet fall inside; otherwise the nearest
    of the four distances of an end to the other segment.

    Args:
        first: Ends.
        second: Ends, in the same unit of length.

    Returns:
        Distances, and where on each segment they are reached, from 0 to 1.
    """
    ends = np.concatenate([first, second], axis=1, dtype=float)
    return kernels.loops("distances").of_segments(ends)
