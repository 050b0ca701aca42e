"""Stars of edges that are to be collapsed, before and after."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrow.mesh.particle_guard import Patches
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.topology import group, Topology


@dataclass(frozen=True, eq=False)
class Stars:
    """Stars of edges: all faces at their two ends, edge after edge.

    Attributes:
        owner: The edge of each entry, ascending.
        face: The face.
        gone: Whether the collapse removes it (it has both ends as corners).
        corner: Which of its corners moves (the first one, if it is gone).
        link: The face's next two vertices after that corner.
        old: The triangle before the collapse.
        new: The triangle after it; degenerate where gone.
        apex: Where the ends of each edge go.
    """

    owner: Int[np.ndarray, " t"]
    face: Int[np.ndarray, " t"]
    gone: Bool[np.ndarray, " t"]
    corner: Int[np.ndarray, " t"]
    link: Int[np.ndarray, "t 2"]
    old: Float[np.ndarray, "t 3 3"]
    new: Float[np.ndarray, "t 3 3"]
    apex: Float[np.ndarray, "k 3"]

    def select(self, chosen: Bool[np.ndarray, " k"]) -> Stars:
        """Return the stars of the chosen edges, renumbered."""
        keep = chosen[self.owner]
        number = np.cumsum(chosen) - 1
        return Stars(
            number[self.owner[keep]],
            self.face[keep],
            self.gone[keep],
            self.corner[keep],
            self.link[keep],
            self.old[keep],
            self.new[keep],
            self.apex[chosen],
        )

    def patches(self) -> Patches:
        """Return the surface before and after each collapse."""
        stay = ~self.gone
        return Patches(
            self.old, self.owner, self.face, self.new[stay], self.owner[stay], self.apex
        )


@dataclass(frozen=True, eq=False)
class Ends:
    """Ends of collapsing edges: which stays, which goes, and where to.

    Attributes:
        stays: The end that keeps its index.
        goes: The end that goes.
        middle: Whether the first moves to the middle.
    """

    stays: Int[np.ndarray, " k"]
    goes: Int[np.ndarray, " k"]
    middle: Bool[np.ndarray, " k"]

    def select(self, chosen: Int[np.ndarray, " s"]) -> Ends:
        """Return the ends of the chosen edges, in that order."""
        return Ends(self.stays[chosen], self.goes[chosen], self.middle[chosen])


def ends(surface: Surface, topology: Topology, edges: Int[np.ndarray, " k"]) -> Ends:
    """Choose the end that stays: a kept one, else the middle of the edge.

    Kept are the vertices that are fixed, on the rim, or the source.
    """
    first, second = topology.edges[edges].T
    kept = surface.kept | topology.rim_vertices
    stays = np.where(kept[second], second, first)
    goes = np.where(kept[second], first, second)
    return Ends(stays, goes, ~kept[stays])


def collapsing_stars(surface: Surface, merging: Ends) -> Stars:
    """Gather the stars of edges.

    Args:
        surface: The surface.
        merging: Which end of each edge stays, and where.

    Returns:
        Their stars.
    """
    vertices, faces = surface.vertices, surface.faces
    stays, goes, middle = merging.stays, merging.goes, merging.middle
    apex = np.where(
        middle[:, None], (vertices[stays] + vertices[goes]) / 2, vertices[stays]
    )
    incident = group(faces.ravel(), np.repeat(np.arange(len(faces)), 3), len(vertices))
    pairs = [incident.rows(end) for end in (stays, goes)]
    owner = np.concatenate([pair[0] for pair in pairs])
    face = np.concatenate([pair[1] for pair in pairs])
    key = np.unique(owner * len(faces) + face)
    owner, face = key // max(len(faces), 1), key % max(len(faces), 1)

    corners = faces[face]
    moving = (corners == stays[owner, None]) | (corners == goes[owner, None])
    corner = moving.argmax(axis=1)
    turn = (corner[:, None] + np.arange(1, 3)) % 3
    old = vertices[corners]
    return Stars(
        owner=owner,
        face=face,
        gone=moving.sum(axis=1) == 2,
        corner=corner,
        link=np.take_along_axis(corners, turn, axis=1),
        old=old,
        new=np.where(moving[:, :, None], apex[owner][:, None], old),
        apex=apex,
    )
