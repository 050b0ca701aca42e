"""Validation of an organ mesh: raise `OrganError` naming the first defect.

Checks run from the coarse to the fine, so that the first complaint is the cause and
not a consequence: numbers, indices, duplicate vertices, degenerate triangles, edges,
winding, holes, vertices, components, orientation, size.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jaxgrow.mesh.quality import area_vectors, lengths
from jaxgrow.mesh.topology import build_topology, component_labels, vertex_fans


SMALLEST_MM = 5.0
"""Bounding-box diagonal below which the unit of length must be wrong."""

LARGEST_MM = 2000.0
"""Bounding-box diagonal above which the unit of length must be wrong."""


class OrganError(ValueError):
    """Error of an organ, site or patch that cannot be used.

    The message is what the user reads, in one sentence: what came, what is wanted, what
    to do.
    """


def check_surface(
    vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"], name: str
) -> None:
    """Raise unless a mesh is a closed, connected, outward oriented manifold.

    Args:
        vertices: In mm, finite.
        faces: Vertex indices, three per triangle.
        name: Of the surface, for messages.

    Raises:
        OrganError: With one sentence for the first defect.
    """
    _check_numbers(vertices, faces, name)
    # differences first: a surface far from the origin keeps its digits
    local = vertices - vertices.mean(axis=0)
    _check_duplicates(vertices, faces, name)
    _check_triangles(local, vertices, faces, name)
    _check_edges(vertices, faces, name)
    _check_fans(vertices, faces, name)
    _check_connected(local, faces, name)
    _check_orientation(local, faces, name)
    _check_size(local, name)


def signed_volume(
    vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
) -> float:
    """Return Σ a·(b × c)/6 of a closed surface, positive for outward normals."""
    local = vertices - vertices.mean(axis=0)
    a, b, c = (local[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def is_closed_manifold(faces: Int[np.ndarray, "f 3"]) -> bool:
    """Return whether each directed edge and its opposite occur exactly once."""
    start, end = _half_edges(faces)
    count = int(faces.max()) + 1 if len(faces) else 0
    forward = np.sort(start * count + end)
    backward = np.sort(end * count + start)
    return bool(
        np.all(forward[1:] != forward[:-1]) and np.array_equal(forward, backward)
    )


def merge_duplicates(
    vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[Float[np.ndarray, "k 3"], Int[np.ndarray, "f 3"]]:
    """Merge exactly coincident vertices, in the order of first occurrence."""
    # adding 0 makes -0.0 and 0.0 the same number
    _, first, inverse = np.unique(
        vertices + 0.0, axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first, kind="stable")
    rank = np.argsort(order, kind="stable")
    return vertices[first[order]], rank[inverse.ravel()][faces]


def place(point: Float[np.ndarray, "3"]) -> str:
    """Format a point in mm as text."""
    return f"({point[0]:.6g}, {point[1]:.6g}, {point[2]:.6g}) mm"


def count(number: int, noun: str, plural: str = "") -> str:
    """Format a number with its noun: ``1 hole``, ``2 holes``."""
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def _half_edges(
    faces: Int[np.ndarray, "f 3"],
) -> tuple[Int[np.ndarray, "h"], Int[np.ndarray, "h"]]:
    return faces.ravel(), faces[:, [1, 2, 0]].ravel()


def _check_numbers(vertices: np.ndarray, faces: np.ndarray, name: str) -> None:
    if len(faces) == 0:
        msg = (
            f"{name} has {count(len(vertices), 'vertex', 'vertices')} and no "
            "triangles, but an organ is a triangulated surface: export it as a mesh "
            "with faces, not as points or lines."
        )
        raise OrganError(msg)
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        first = int(np.argmin(finite))
        msg = (
            f"{name} has {count(int((~finite).sum()), 'vertex', 'vertices')} with a "
            f"coordinate that is no finite number (the first is vertex {first}), but "
            "all must be finite: export the mesh again or drop the triangles there."
        )
        raise OrganError(msg)
    bad = (faces < 0) | (faces >= len(vertices))
    if bad.any():
        row = int(np.argmax(bad.any(axis=1)))
        msg = (
            f"{name} has triangles that refer to vertices that do not exist (the first "
            f"is triangle {row}: {faces[row].tolist()} of {len(vertices)} vertices): "
            "the file is damaged, export the mesh again."
        )
        raise OrganError(msg)
    unused = len(vertices) - len(np.unique(faces))
    if unused:
        msg = (
            f"{name} has {count(unused, 'vertex', 'vertices')} that no triangle uses, "
            "but every vertex must lie on the surface: remove "
            f"{'it' if unused == 1 else 'them'}, for example with "
            "trimesh's mesh.remove_unreferenced_vertices()."
        )
        raise OrganError(msg)


def _check_duplicates(vertices: np.ndarray, faces: np.ndarray, name: str) -> None:
    merged, joined = merge_duplicates(vertices, faces)
    number = len(vertices) - len(merged)
    if number == 0:
        return
    outcome = (
        "merging them makes the surface closed"
        if is_closed_manifold(joined)
        else "and merging them alone does not make the surface closed"
    )
    msg = (
        f"{name} has {count(number, 'duplicate vertex', 'duplicate vertices')} at "
        f"exactly the place of another, so triangles that touch do not share "
        f"vertices ({outcome}): merge them, for example with trimesh's "
        "mesh.merge_vertices(merge_tex=True, merge_norm=True)."
    )
    raise OrganError(msg)


def _check_triangles(
    local: np.ndarray, vertices: np.ndarray, faces: np.ndarray, name: str
) -> None:
    corners = local[faces]
    edges = corners[:, [1, 2, 0]] - corners
    longest = np.einsum("fij,fij->fi", edges, edges).max(axis=1)
    # the area over the longest edge squared is half the height over the length
    flat = lengths(area_vectors(corners)) <= 1e-9 * longest
    if flat.any():
        first = int(np.argmax(flat))
        where = place(vertices[faces[first]].mean(axis=0))
        msg = (
            f"{name} has {count(int(flat.sum()), 'degenerate triangle')} of no area "
            f"(the first is triangle {first} at {where}), but every triangle needs "
            "three corners that are not on a line: collapse their short edges, for "
            "example by remeshing."
        )
        raise OrganError(msg)


def _check_edges(vertices: np.ndarray, faces: np.ndarray, name: str) -> None:
    start, end = _half_edges(faces)
    low, high = np.minimum(start, end), np.maximum(start, end)
    key, inverse, uses = np.unique(
        low * len(vertices) + high, return_inverse=True, return_counts=True
    )
    ends = np.stack([key // len(vertices), key % len(vertices)], axis=1)
    if (uses > 2).any():
        first = int(np.argmax(uses > 2))
        where = place(vertices[ends[first]].mean(axis=0))
        msg = (
            f"{name} has {count(int((uses > 2).sum()), 'edge')} with more than two "
            f"triangles (the first at {where} has {uses[first]}), but an edge of a "
            "surface has exactly two: remove inner walls and doubled triangles, for "
            "example with trimesh's mesh.update_faces(mesh.unique_faces())."
        )
        raise OrganError(msg)
    holes = _holes(ends[uses == 1])
    if holes:
        first = holes[0]
        where = place(vertices[first].mean(axis=0))
        msg = (
            f"{name} has {count(len(holes), 'hole')} (the first around {where}, with "
            f"{count(len(first), 'rim edge')}), but an organ's surface must be closed: "
            "close its openings, for example with trimesh's mesh.fill_holes()."
        )
        raise OrganError(msg)
    # the two uses of an edge must run in opposite directions
    balance = np.bincount(inverse, weights=np.where(start < end, 1, -1))
    if (balance != 0).any():
        first = int(np.argmax(balance != 0))
        where = place(vertices[ends[first]].mean(axis=0))
        msg = (
            f"{name} has {count(int((balance != 0).sum()), 'edge')} whose two "
            f"triangles are wound in opposite senses (the first at {where}), but all "
            "normals must point to the same side: make the winding consistent, for "
            "example with trimesh.repair.fix_normals(mesh)."
        )
        raise OrganError(msg)


def _holes(edges: Int[np.ndarray, "e 2"]) -> list[Int[np.ndarray, "_"]]:
    """Find the vertices of each connected piece of the rim, the largest first."""
    if len(edges) == 0:
        return []
    used, flat = np.unique(edges, return_inverse=True)
    ends = flat.reshape(-1, 2)
    links = coo_array(
        (np.ones(len(ends), dtype=bool), (ends[:, 0], ends[:, 1])),
        shape=(len(used), len(used)),
    )
    number, label = connected_components(links, directed=False)
    pieces = [used[label == k] for k in range(number)]
    return sorted(pieces, key=lambda piece: (-len(piece), int(piece[0])))


def _check_fans(vertices: np.ndarray, faces: np.ndarray, name: str) -> None:
    pinched = vertex_fans(faces, build_topology(faces, len(vertices))) > 1
    if pinched.any():
        first = int(np.argmax(pinched))
        msg = (
            f"{name} has {count(int(pinched.sum()), 'vertex', 'vertices')} where two "
            f"sheets touch in a single point (the first is vertex {first} at "
            f"{place(vertices[first])}), but a surface must look like a disc around "
            "every vertex: split the vertex in two and move the sheets apart."
        )
        raise OrganError(msg)


def _check_connected(local: np.ndarray, faces: np.ndarray, name: str) -> None:
    sizes = np.sort(np.bincount(component_labels(faces, len(local))))[::-1]
    number = len(sizes)
    if number > 1:
        listed = ", ".join(str(size) for size in sizes[:4])
        more = ", ..." if number > 4 else ""
        msg = (
            f"{name} has {number} separate components (of {listed}{more} triangles), "
            "but an organ is one connected surface: keep the one you mean, for example "
            "max(mesh.split(), key=lambda part: part.area) with trimesh."
        )
        raise OrganError(msg)


def _check_orientation(local: np.ndarray, faces: np.ndarray, name: str) -> None:
    volume = signed_volume(local, faces)
    if volume <= 0:
        msg = (
            f"{name} has normals that point the wrong way, to the inside (its signed "
            f"volume is {volume:.6g} mm³), but they must point out of the closed "
            "surface: turn them round, for example with trimesh's mesh.invert()."
        )
        raise OrganError(msg)


def _check_size(local: np.ndarray, name: str) -> None:
    diagonal = float(np.linalg.norm(np.ptp(local, axis=0)))
    if not SMALLEST_MM <= diagonal <= LARGEST_MM:
        msg = (
            f"{name} is {diagonal:.6g} mm across, but an organ measures between "
            f"{SMALLEST_MM:g} and {LARGEST_MM:g} mm: give the length of the file's "
            "unit with unit_mm (10 for a file in centimetres, 1000 for one in metres, "
            "0.001 for one in micrometres)."
        )
        raise OrganError(msg)
