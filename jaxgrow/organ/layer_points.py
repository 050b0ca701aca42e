"""Layer under a patch that tissue fills."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from jaxgrow.mesh.proximity import nearest_on_mesh
from jaxgrow.mesh.quality import lengths, unit
from jaxgrow.mesh.topology import build_topology
from jaxgrow.organ.organ import Organ
from jaxgrow.organ.patch import Patch
from jaxgrow.organ.signed_distance import Sides


class LayerPoints(NamedTuple):
    """Points in a layer, with their depth under the organ's surface.

    Attributes:
        points: Local positions in r0.
        depth: Exact distance to the organ's surface in r0.
        face: The organ's triangle that is nearest.
    """

    points: Float[np.ndarray, "k 3"]
    depth: Float[np.ndarray, "k"]
    face: Int[np.ndarray, "k"]


class Layer:
    """Layer of tissue under a patch.

    It holds the points that lie on the tissue's side, have their nearest point of the
    organ's surface on the patch, and are between ``gap`` and ``thickness`` away from
    it. Its sides are the walls that drop from the rim along its normals. All lengths
    are in r0.

    Attributes:
        gap: Free depth just under the surface.
        thickness: Depth of the bottom.
        low: Corner of a box that holds the layer.
        high: Its opposite corner.
    """

    def __init__(
        self, organ: Organ, patch: Patch, gap: float, thickness: float
    ) -> None:
        self.gap, self.thickness = gap, thickness
        self.low = patch.vertices.min(axis=0) - thickness
        self.high = patch.vertices.max(axis=0) + thickness
        # a triangle farther than the thickness from the box cannot be the nearest one
        # of a point in the layer
        self._surface = Sides(
            patch.to_local(organ.vertices),
            organ.faces,
            self.low - thickness,
            self.high + thickness,
        )
        self._on_patch = patch.face_mask
        self._tissue_sign = -organ.lumen_sign
        triangles = patch.vertices[patch.faces]
        self._centres = KDTree(triangles.mean(axis=1))
        self._radius = lengths(triangles - triangles.mean(axis=1)[:, None]).max()
        normals = self._surface.vertex_normals[patch.organ_index]
        self._walls = _side_walls(patch, -organ.lumen_sign * normals, thickness)

    def inside(self, points: Float[np.ndarray, "n 3"]) -> LayerPoints:
        """Select the points that lie in the layer."""
        reach = self.thickness + self._radius
        centre = self._centres.query(points, distance_upper_bound=reach)[0]
        points = points[np.isfinite(centre)]
        depth, side, face = self._surface.measure(points)
        inside = (
            (self._tissue_sign * side > 0)
            & (depth >= self.gap)
            & (depth <= self.thickness)
            & self._on_patch[face]
        )
        return LayerPoints(points[inside], depth[inside], face[inside])

    def depth(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Compute the exact distance to the organ's surface, on either side."""
        return self._surface.measure(points).distance

    def near_edge(
        self,
        points: Float[np.ndarray, "n 3"],
        depth: Float[np.ndarray, "n"],
        margin: float,
    ) -> Bool[np.ndarray, "n"]:
        """Return whether points of this depth are within a margin of an edge.

        Edges are the bottom and the sides.
        """
        if not len(points):
            return np.zeros(0, dtype=bool)
        beside = nearest_on_mesh(points, *self._walls)[0]
        return (depth > self.thickness - margin) | (beside < margin)


class Addition:
    """Part of a wider or deeper layer that is not in the one before.

    A point of it lies in the new layer, not in the old one, and behind the grown
    surface by at least the gap.

    Attributes:
        layer: The new layer.
        low: Corner of a box that holds the space.
        high: Its opposite corner.
    """

    def __init__(
        self,
        layer: Layer,
        patch_before: Patch,
        thickness_before: float,
        grown: Sides,
        sign: int,
    ) -> None:
        """Set up the difference of two layers under a grown surface.

        Args:
            layer: The new one.
            patch_before: The patch over the old one.
            thickness_before: Of the old one.
            grown: The organ's surface with the lesion.
            sign: Of the side of ``grown`` that the tissue is on.
        """
        self.low, self.high = layer.low, layer.high
        self.layer, self._grown, self._sign = layer, grown, sign
        self._on_patch = patch_before.face_mask
        self._thickness = thickness_before

    def inside(self, points: Float[np.ndarray, "n 3"]) -> LayerPoints:
        """Select the points that lie in the added part."""
        points, depth, face = self.layer.inside(points)
        new = ~self._on_patch[face] | (depth > self._thickness)
        points, depth, face = points[new], depth[new], face[new]
        gap, side, _ = self._grown.measure(points)
        free = (self._sign * side > 0) & (gap >= self.layer.gap)
        return LayerPoints(points[free], depth[free], face[free])


def _side_walls(
    patch: Patch, down: Float[np.ndarray, "m 3"], thickness: float
) -> tuple[Float[np.ndarray, "w 3"], Int[np.ndarray, "s 3"]]:
    """Build the strip from the rim to the bottom, two triangles per rim edge."""
    topology = build_topology(patch.faces, len(patch.vertices))
    bottom = patch.vertices + thickness * unit(down)
    first, second = topology.edges[~topology.interior].T
    below = len(patch.vertices)
    faces = np.concatenate(
        [
            np.stack([first, second, second + below], axis=1),
            np.stack([first, second + below, first + below], axis=1),
        ]
    )
    return np.concatenate([patch.vertices, bottom]), faces
