"""Connectivity of oriented triangle meshes, vectorised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


@dataclass(frozen=True, eq=False)
class Topology:
    """Edges of an oriented manifold and the faces on their two sides.

    Attributes:
        edges: Unique edges, smaller index first, in ascending order.
        edge_faces: Column 0: the face that runs the edge from the smaller to the
            larger index; column 1: the one that runs it back; -1: none (a rim edge).
        opposite: The third vertex of those faces, -1: none.
        face_edges: Index of the edge from corner k to corner k + 1 of each face.
        valence: Number of edges at each vertex.
    """

    edges: Int[np.ndarray, "e 2"]
    edge_faces: Int[np.ndarray, "e 2"]
    opposite: Int[np.ndarray, "e 2"]
    face_edges: Int[np.ndarray, "f 3"]
    valence: Int[np.ndarray, " m"]

    @property
    def interior(self) -> Bool[np.ndarray, " e"]:
        """Edges with a face on both sides; the others are the rim."""
        return np.all(self.edge_faces >= 0, axis=1)

    @property
    def rim_vertices(self) -> Bool[np.ndarray, " m"]:
        """Vertices at the end of a rim edge."""
        flags = np.zeros(len(self.valence), dtype=bool)
        flags[self.edges[~self.interior]] = True
        return flags

    def has_edge(
        self, first: Int[np.ndarray, " k"], second: Int[np.ndarray, " k"]
    ) -> Bool[np.ndarray, " k"]:
        """Return whether each pair of vertices is joined by an edge."""
        count = len(self.valence)
        keys = self.edges[:, 0] * count + self.edges[:, 1]
        wanted = np.minimum(first, second) * count + np.maximum(first, second)
        if not len(keys):
            return np.zeros(len(wanted), dtype=bool)
        place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        return keys[place] == wanted


def build_topology(faces: Int[np.ndarray, "f 3"], n_vertices: int) -> Topology:
    """Find the edges of a mesh and the faces on their sides.

    Args:
        faces: Consistently oriented faces of a manifold, with or without rim.
        n_vertices: Number of vertices, used or not.

    Returns:
        The topology; O(f log f).

    Raises:
        ValueError: A face repeats a vertex, or two faces run the same edge in the
            same direction (non-manifold, or inconsistently oriented).
    """
    tail = faces.ravel().astype(np.int64)
    head = faces[:, [1, 2, 0]].ravel().astype(np.int64)
    apex = faces[:, [2, 0, 1]].ravel().astype(np.int64)
    if (tail == head).any():
        face = int(np.flatnonzero(tail == head)[0] // 3)
        raise ValueError(
            f"face {face} has a vertex twice: {faces[face].tolist()}; remove it."
        )
    key = np.minimum(tail, head) * n_vertices + np.maximum(tail, head)
    order = np.argsort(key)
    ordered = key[order]
    first = np.concatenate([[True], ordered[1:] != ordered[:-1]])[: len(ordered)]
    edge = np.zeros(len(key), dtype=np.int64)
    edge[order] = np.cumsum(first) - 1
    unique = ordered[first]
    edges = np.stack([unique // max(n_vertices, 1), unique % max(n_vertices, 1)], 1)

    side = 2 * edge + (tail > head)
    runs = np.bincount(side, minlength=2 * len(edges))
    if (runs > 1).any():
        a, b = edges[np.flatnonzero(runs > 1)[0] // 2]
        raise ValueError(
            f"edge ({a}, {b}) is run twice in the same direction; the mesh must be "
            "an oriented manifold."
        )
    edge_faces = np.full(2 * len(edges), -1, dtype=np.int64)
    edge_faces[side] = np.repeat(np.arange(len(faces)), 3)
    opposite = np.full(2 * len(edges), -1, dtype=np.int64)
    opposite[side] = apex
    return Topology(
        edges=edges,
        edge_faces=edge_faces.reshape(-1, 2),
        opposite=opposite.reshape(-1, 2),
        face_edges=edge.reshape(-1, 3),
        valence=np.bincount(edges.ravel(), minlength=n_vertices),
    )


def euler_number(faces: Int[np.ndarray, "f 3"]) -> int:
    """Return vertices − edges + faces, of vertices that a face uses."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return len(np.unique(faces)) - len(np.unique(edges, axis=0)) + len(faces)


def component_labels(
    faces: Int[np.ndarray, "f 3"], n_vertices: int
) -> Int[np.ndarray, " f"]:
    """Label each face by its connected component, joined by shared vertices."""
    label = connected_parts(faces, np.ones(n_vertices, dtype=bool))
    return np.unique(label[faces[:, 0]], return_inverse=True)[1]


def is_manifold(faces: Int[np.ndarray, "f 3"], n_vertices: int) -> bool:
    """Return whether the mesh is an oriented manifold, with or without rim.

    Every edge is run at most once in each direction, and the faces around every
    vertex form one fan (closed, or open between two rim edges).
    """
    try:
        topology = build_topology(faces, n_vertices)
    except ValueError:
        return False
    return bool((vertex_fans(faces, topology) <= 1).all())


def vertex_fans(
    faces: Int[np.ndarray, "f 3"], topology: Topology
) -> Int[np.ndarray, " m"]:
    """Count the fans of faces at each vertex.

    It is 1 at a manifold vertex and 0 at an unused one.
    """
    # A node for every corner; corners of one vertex are linked where their faces
    # share an edge at it. Fans are the connected components.
    n_faces = len(faces)
    inner = np.flatnonzero(topology.interior)
    near, far = topology.edge_faces[inner].T
    corners = []
    for vertex in topology.edges[inner].T:
        a = 3 * near + np.argmax(faces[near] == vertex[:, None], axis=1)
        b = 3 * far + np.argmax(faces[far] == vertex[:, None], axis=1)
        corners.append(np.stack([a, b]))
    a, b = np.concatenate(corners, axis=1)
    links = coo_array((np.ones(len(a), bool), (a, b)), shape=(3 * n_faces,) * 2)
    count, label = connected_components(links, directed=False)
    owner = np.zeros(count, dtype=np.int64)
    owner[label] = faces.ravel()
    return np.bincount(owner, minlength=len(topology.valence))


@dataclass(frozen=True, eq=False)
class Incidence:
    """Lists of different length, concatenated (CSR layout).

    Attributes:
        start: Where each row starts in `items`.
        count: Number of items of each row.
        items: All items, row after row.
    """

    start: Int[np.ndarray, " r"]
    count: Int[np.ndarray, " r"]
    items: Int[np.ndarray, " n"]

    def rows(
        self, wanted: Int[np.ndarray, " k"]
    ) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
        """Return all (position in `wanted`, item) pairs of the wanted rows."""
        owner, place = expand(self.start[wanted], self.count[wanted])
        return owner, self.items[place]


def group(
    rows: Int[np.ndarray, " n"], items: Int[np.ndarray, " n"], n_rows: int
) -> Incidence:
    """Sort (row, item) pairs into an incidence list."""
    count = np.bincount(rows, minlength=n_rows)
    return Incidence(np.cumsum(count) - count, count, items[np.argsort(rows)])


def expand(
    start: Int[np.ndarray, " k"], count: Int[np.ndarray, " k"]
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """List positions start[i] … start[i] + count[i] − 1, with their i."""
    owner = np.repeat(np.arange(len(start)), count)
    before = np.cumsum(count) - count
    return owner, np.arange(len(owner)) + (start - before)[owner]


def greedy_independent(
    operation: Int[np.ndarray, " p"], touched: Int[np.ndarray, " p"], n_operations: int
) -> Bool[np.ndarray, " k"]:
    """Select operations greedily that touch nothing in common, best first.

    The result is that of a serial pass in order of rank, found in rounds: an operation
    that is the best one at everything it touches is chosen, those that meet a chosen
    one are dropped.

    Args:
        operation: Rank of the operation (0 is the best) of each pair.
        touched: The index that it touches (of a vertex, for example).
        n_operations: Number of operations.

    Returns:
        Whether each operation is chosen.
    """
    chosen = np.zeros(n_operations, dtype=bool)
    open_ = np.ones(n_operations, dtype=bool)
    size = int(touched.max()) + 1 if len(touched) else 0
    while open_.any():
        best = np.full(size, n_operations)
        np.minimum.at(best, touched, operation)
        beaten = np.bincount(
            operation[best[touched] < operation], minlength=n_operations
        )
        new = open_ & (beaten == 0)
        chosen |= new
        taken = np.zeros(size, dtype=bool)
        taken[touched[new[operation]]] = True
        open_[operation[taken[touched]]] = False
        open_ &= ~new
        live = open_[operation]
        operation, touched = operation[live], touched[live]
    return chosen


def connected_parts(
    faces: Int[np.ndarray, "f 3"], chosen: Bool[np.ndarray, " m"]
) -> Int[np.ndarray, " m"]:
    """Label the connected parts of the chosen vertices.

    Every other vertex is a part of its own.
    """
    tail, head = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    kept = chosen[tail] & chosen[head]
    links = coo_array(
        (np.ones(int(kept.sum())), (tail[kept], head[kept])), shape=(len(chosen),) * 2
    )
    _, part = connected_components(links, directed=False)
    return part
