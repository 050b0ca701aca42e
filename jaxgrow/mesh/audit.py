"""Independent audit of a closed organ mesh.

It shares no code with the topology, the distances or the operations that made the mesh.
Every count is of defects, so a clean mesh has zeros; the shape distribution, the number
of components, the Euler number and the volume are reported as well.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jaxgrow.mesh.intersection import intersecting_pairs


DEGENERATE = 1e-10
"""Twice the area over the square of the longest side, below which a triangle counts
as degenerate: in float64 its normal is accurate to a few digits only."""

FOLD_DEGREES = 175.0
"""Angle between the normals of neighbours, above which they lie on each other."""


@dataclass(frozen=True)
class SurfaceAudit:
    """Findings of an audit.

    Attributes:
        vertices: Number of vertices.
        faces: Number of faces.
        components: Number of connected components (by shared vertices).
        euler_number: Vertices in use − edges + faces.
        volume: Signed enclosed volume (length³); positive for outward normals.
        non_finite_vertices: Vertices with a coordinate that is not finite.
        invalid_faces: Faces with an index out of range; they are left out below.
        unused_vertices: Vertices of no face. Reported, not a defect.
        boundary_edges: Edges of one face.
        non_manifold_edges: Edges of more than two faces.
        non_manifold_vertices: Vertices whose faces form more than one fan.
        misoriented_edges: Edges of two faces that run it in the same direction.
        degenerate_faces: Faces with a repeated vertex, or an area below `DEGENERATE`.
        duplicate_faces: Faces with the same three vertices as an earlier one.
        folded_edges: Neighbours whose normals are more than `FOLD_DEGREES` apart.
        self_intersections: Pairs of faces without a common vertex that meet.
        hinged_intersections: Pairs with one common vertex that meet elsewhere too.
        quality_min: Smallest 2 r_in / r_circ.
        quality_percentile_1: Its 1 % quantile.
        quality_median: Its median.
    """

    vertices: int
    faces: int
    components: int
    euler_number: int
    volume: float
    non_finite_vertices: int
    invalid_faces: int
    unused_vertices: int
    boundary_edges: int
    non_manifold_edges: int
    non_manifold_vertices: int
    misoriented_edges: int
    degenerate_faces: int
    duplicate_faces: int
    folded_edges: int
    self_intersections: int
    hinged_intersections: int
    quality_min: float
    quality_percentile_1: float
    quality_median: float

    @property
    def defects(self) -> dict[str, int]:
        """The defects found, by name, without those that are zero."""
        names = (
            "non_finite_vertices",
            "invalid_faces",
            "boundary_edges",
            "non_manifold_edges",
            "non_manifold_vertices",
            "misoriented_edges",
            "degenerate_faces",
            "duplicate_faces",
            "folded_edges",
            "self_intersections",
            "hinged_intersections",
        )
        return {name: n for name in names if (n := getattr(self, name))}

    @property
    def clean(self) -> bool:
        """No defect, one component, and normals that point outwards."""
        return not self.defects and self.components == 1 and self.volume > 0

    def as_dict(self) -> dict[str, Any]:
        """Return all numbers and `clean`, ready for JSON."""
        return {**asdict(self), "clean": self.clean}


def audit_surface(
    vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
) -> SurfaceAudit:
    """Audit a closed mesh for all defects that break a simulation.

    Vertices that are not finite, and faces that use them or do not exist, are counted
    and left out of the geometric checks.

    Args:
        vertices: Positions, any one unit of length.
        faces: Vertex indices.

    Returns:
        The findings.
    """
    n_vertices = len(vertices)
    in_range = np.all((faces >= 0) & (faces < n_vertices), axis=1)
    valid = faces[in_range].astype(np.int64)
    finite = np.all(np.isfinite(vertices), axis=1)
    edge = _edge_census(valid, n_vertices)
    sound = valid[finite[valid].all(axis=1)]
    positions = np.where(finite[:, None], vertices, 0.0)
    quality, degenerate = _shapes(positions, sound)
    apart, hinged = intersecting_pairs(positions, sound)
    repeated = _repeats_vertex(valid)
    distinct = np.unique(np.sort(valid, axis=1), axis=0)
    nothing = np.array([np.nan]) if not len(quality) else quality
    return SurfaceAudit(
        vertices=n_vertices,
        faces=len(faces),
        components=_components(valid, n_vertices),
        euler_number=len(np.unique(valid)) - edge["edges"] + len(valid),
        volume=_volume(positions, sound),
        non_finite_vertices=int(np.count_nonzero(~finite)),
        invalid_faces=int(np.count_nonzero(~in_range)),
        unused_vertices=n_vertices - len(np.unique(valid)),
        boundary_edges=edge["boundary"],
        non_manifold_edges=edge["crowded"],
        non_manifold_vertices=_split_vertices(valid[~repeated], n_vertices),
        misoriented_edges=edge["misoriented"],
        degenerate_faces=int(np.count_nonzero(degenerate)),
        duplicate_faces=len(valid) - len(distinct),
        folded_edges=_folds(positions, sound[~degenerate]),
        self_intersections=len(apart),
        hinged_intersections=len(hinged),
        quality_min=float(nothing.min()),
        quality_percentile_1=float(np.quantile(nothing, 0.01)),
        quality_median=float(np.median(nothing)),
    )


def _half_edges(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "h 2"]:
    """List the half-edges: all first ones, all second ones, all third ones."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def _edge_census(faces: Int[np.ndarray, "f 3"], n_vertices: int) -> dict[str, int]:
    """Count the edges, and those with each kind of defect."""
    half = _half_edges(faces)
    half = half[half[:, 0] != half[:, 1]]
    low, high = half.min(axis=1), half.max(axis=1)
    _, edge = np.unique(low * n_vertices + high, return_inverse=True)
    count = np.bincount(edge)
    forward = np.bincount(edge, weights=half[:, 0] == low)
    return {
        "edges": len(count),
        "boundary": int(np.count_nonzero(count == 1)),
        "crowded": int(np.count_nonzero(count > 2)),
        "misoriented": int(np.count_nonzero((count == 2) & (forward != 1))),
    }


def _repeats_vertex(faces: Int[np.ndarray, "f 3"]) -> np.ndarray:
    """Mark the faces with the same vertex twice."""
    a, b, c = faces.T
    return (a == b) | (b == c) | (c == a)


def _shapes(
    vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[np.ndarray, np.ndarray]:
    """Compute 2 r_in / r_circ of each face, and mark degenerate faces."""
    corner = vertices[faces]
    side = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2)
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    double_area = np.linalg.norm(cross, axis=1)
    longest = side.max(axis=1, initial=0.0)
    degenerate = _repeats_vertex(faces) | (double_area <= DEGENERATE * longest**2)
    scale = side.prod(axis=1) * side.sum(axis=1)
    quality = 4 * double_area**2 / np.where(scale > 0, scale, 1.0)
    return quality, degenerate


def _components(faces: Int[np.ndarray, "f 3"], n_vertices: int) -> int:
    """Count the connected components among the vertices in use."""
    half = _half_edges(faces)
    graph = coo_array(
        (np.ones(len(half), bool), (half[:, 0], half[:, 1])), shape=(n_vertices,) * 2
    )
    _, label = connected_components(graph, directed=False)
    return len(np.unique(label[np.unique(faces)]))


def _volume(vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]) -> float:
    """Compute the signed volume, about the mean vertex for accuracy."""
    if not len(faces):
        return 0.0
    corner = vertices[faces] - vertices[np.unique(faces)].mean(axis=0)
    cross = np.cross(corner[:, 1], corner[:, 2])
    return float(np.einsum("fi,fi->", corner[:, 0], cross) / 6.0)


def _split_vertices(faces: Int[np.ndarray, "f 3"], n_vertices: int) -> int:
    """Count the vertices whose faces form more than one fan.

    Faces of a fan are joined through edges.
    """
    n_faces = len(faces)
    half = _half_edges(faces)
    face = np.tile(np.arange(n_faces), 3)
    low, high = half.min(axis=1), half.max(axis=1)
    key = low * n_vertices + high
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    one, two = face[order[same]], face[order[same + 1]]
    # Nodes are (face, corner); faces that share an edge are joined at both its ends.
    nodes = [
        [3 * f + np.argmax(faces[f] == end[:, None], axis=1) for f in (one, two)]
        for end in (low[order[same]], high[order[same]])
    ]
    a, b = np.concatenate(nodes, axis=1)
    graph = coo_array((np.ones(len(a), bool), (a, b)), shape=(3 * n_faces,) * 2)
    count, label = connected_components(graph, directed=False)
    owner = np.zeros(count, dtype=np.int64)
    owner[label] = faces.ravel()
    return int(np.count_nonzero(np.bincount(owner) > 1)) if count else 0


def _folds(vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]) -> int:
    """Count the edges whose two faces lie on each other.

    The orientation of the faces does not matter.
    """
    half = _half_edges(faces)
    third = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
    key = half.min(axis=1) * len(vertices) + half.max(axis=1)
    _, edge, count = np.unique(key, return_inverse=True, return_counts=True)
    order = np.argsort(edge, kind="stable")
    order = order[count[edge[order]] == 2]
    one, two = order[::2], order[1::2]
    # Perpendiculars from the edge to the third vertices: parallel in a fold, opposite
    # in a plane, whichever way the faces are turned.
    low, high = half[one].min(axis=1), half[one].max(axis=1)
    along = vertices[high] - vertices[low]
    along = along / np.linalg.norm(along, axis=1)[:, None]
    foot = []
    for pick in (one, two):
        arm = vertices[third[pick]] - vertices[low]
        arm = arm - np.einsum("ei,ei->e", arm, along)[:, None] * along
        foot.append(arm / np.linalg.norm(arm, axis=1)[:, None])
    cosine = np.einsum("ei,ei->e", *foot)
    return int(np.count_nonzero(cosine > np.cos(np.deg2rad(180.0 - FOLD_DEGREES))))
