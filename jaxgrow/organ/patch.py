"""Patch of an organ's surface that a lesion grows on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra

from jaxgrow.mesh.quality import areas, lengths, side_lengths
from jaxgrow.mesh.topology import build_topology, Topology, vertex_fans
from jaxgrow.organ.organ import Organ, OrganError, Site
from jaxgrow.organ.validity import place


FEWEST_FACES = 12
"""Least number of triangles: a smaller patch has hardly any free vertex."""

LARGEST_ISLAND = 0.5
"""Share of the patch's area below which enclosed pieces are filled in. Larger ones are
parts of the organ, as on both sides of a patch around a tube, which has two rims."""

LARGEST_SHARE = 0.9
"""Largest share of the organ's area: a larger patch would have no support."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Connected piece of an organ's surface, seen from the lumen.

    Lengths inside a simulation are in r0 and positions relative to the site, so no
    digits are lost for an organ far from the origin of its coordinates.

    Attributes:
        site: Centre of the lesion; the origin of local positions.
        r0_mm: Length of one r0 in mm.
        face_mask: The organ's triangles that are in the patch.
        organ_index: For each vertex of the patch, its index in the organ.
        vertices: Local positions in r0.
        faces: Local vertex indices; normals point into the lumen.
        rim: Vertices of the patch's edge, shared with the rest of the organ.
    """

    site: Site
    r0_mm: float
    face_mask: Bool[np.ndarray, "F"]
    organ_index: Int[np.ndarray, "m"]
    vertices: Float[np.ndarray, "m 3"]
    faces: Int[np.ndarray, "f 3"]
    rim: Bool[np.ndarray, "m"]

    def to_local(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Convert points in mm to local positions in r0: (x - x_site) / r0."""
        return (points - self.site.point) / self.r0_mm

    def to_mm(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Convert local positions in r0 to points in mm: x_site + r0 u."""
        return self.site.point + self.r0_mm * points


def cut_patch(organ: Organ, site: Site, radius_mm: float, *, r0_mm: float) -> Patch:
    """Cut out the triangles within a distance along the surface from a site.

    The distance is that of shortest paths over the mesh (``distances_along``), so the
    opposite wall of a thin lumen is far away. The patch is made simple: only the piece
    that holds the site is kept, islands that it encloses are filled in, and vertices
    where it touches itself are added with all their triangles. It may go round a tube;
    then it has two rims.

    Args:
        organ: The organ.
        site: The centre.
        radius_mm: Distance in mm up to which vertices belong to the patch.
        r0_mm: Length of one r0 in mm, the unit of the patch's vertices.

    Returns:
        The patch, with a rim.

    Raises:
        OrganError: If the patch is too small or takes nearly the whole organ.
    """
    return _cut(organ, site, radius_mm, r0_mm, np.zeros(0, dtype=np.int64))


def widen_patch(organ: Organ, patch: Patch, radius_mm: float) -> Patch:
    """Cut out a larger patch around a patch.

    It has all triangles of the patch and all that touch it, so that the old rim lies
    inside it everywhere, and those within the radius as in ``cut_patch``.

    Args:
        organ: The organ.
        patch: The patch that it is to contain.
        radius_mm: Distance in mm from the site up to which vertices belong to it.

    Returns:
        The larger patch, of the same site and the same unit: local positions stay.

    Raises:
        OrganError: If it takes nearly the whole organ.
    """
    touching = np.any(np.isin(organ.faces, patch.organ_index), axis=1)
    around = np.unique(organ.faces[touching])
    return _cut(organ, patch.site, radius_mm, patch.r0_mm, around)


def seen_from_lumen(
    organ: Organ, mask: Bool[np.ndarray, "F"]
) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "f 3"]]:
    """Extract some of the organ's triangles, with normals into the lumen.

    Args:
        organ: The organ.
        mask: The triangles.

    Returns:
        The organ's vertices that they use, in ascending order, and the triangles as
        positions in that list.
    """
    index, flat = np.unique(organ.faces[mask], return_inverse=True)
    faces = flat.reshape(-1, 3)
    if organ.lumen_sign < 0:
        faces = faces[:, ::-1]
    return index, np.ascontiguousarray(faces)


def _cut(
    organ: Organ,
    site: Site,
    radius_mm: float,
    r0_mm: float,
    taken: Int[np.ndarray, "k"],
) -> Patch:
    """Cut the patch of a radius, with vertices taken at any distance."""
    topology = build_topology(organ.faces, len(organ.vertices))
    local = organ.vertices - site.point
    reached = distances_along(local, organ.faces, topology, site.face) <= radius_mm
    reached[taken] = True
    mask = np.all(reached[organ.faces], axis=1)
    mask[site.face] = True
    corners = local[organ.faces]
    area = areas(corners)
    mask = _simple(mask, organ.faces, area, topology, site.face)
    share = float(area[mask].sum() / area.sum())
    if share > LARGEST_SHARE:
        msg = (
            f"a patch of radius {radius_mm:g} mm around {place(site.point)} takes "
            f"{100 * share:.0f} % of {organ.name}, but at least "
            f"{100 * (1 - LARGEST_SHARE):.0f} % must stay to hold it: ask for a "
            "smaller lesion or use a larger organ."
        )
        raise OrganError(msg)
    if mask.sum() < FEWEST_FACES:
        longest = float(side_lengths(corners[site.face][None]).max())
        msg = (
            f"a patch of radius {radius_mm:g} mm around {place(site.point)} has only "
            f"{int(mask.sum())} triangles of {organ.name}, but {FEWEST_FACES} are "
            f"needed: refine the organ's mesh there (its edges are {longest:.3g} mm "
            "long) or ask for a larger lesion."
        )
        raise OrganError(msg)

    organ_index, faces = seen_from_lumen(organ, mask)
    rim = build_topology(faces, len(organ_index)).rim_vertices
    return Patch(
        site=site,
        r0_mm=float(r0_mm),
        face_mask=mask,
        organ_index=organ_index,
        vertices=local[organ_index] / r0_mm,
        faces=faces,
        rim=rim,
    )


def distances_along(
    local: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    topology: Topology,
    face: int,
) -> Float[np.ndarray, "m"]:
    """Compute shortest paths along the surface from the origin on ``face``.

    Paths run straight from the origin to the corners of its triangle and its three
    neighbours, then over edges and over the diagonals of pairs of triangles folded
    flat. On even meshes they are a few per cent longer than geodesics (with edges
    alone up to 15 %).

    Args:
        local: Vertices relative to the starting point.
        faces: Triangles.
        topology: Of ``faces``.
        face: The triangle that holds the starting point.

    Returns:
        A distance for every vertex, infinite where there is no path.
    """
    size = len(local)
    ends = [topology.edges]
    edge = local[topology.edges[:, 1]] - local[topology.edges[:, 0]]
    costs = [lengths(edge)]
    pairs, diagonal = _diagonals(local, topology)
    ends.append(pairs)
    costs.append(diagonal)
    around = faces[np.unique(topology.edge_faces[topology.face_edges[face]])]
    near = np.unique(around)
    ends.append(np.stack([np.full(len(near), size), near], axis=1))
    # for a start on a vertex: the graph drops edges of length 0
    costs.append(np.maximum(lengths(local[near]), np.finfo(float).tiny))
    pairs = np.concatenate(ends)
    graph = coo_array(
        (np.concatenate(costs), (pairs[:, 0], pairs[:, 1])), shape=(size + 1,) * 2
    ).tocsr()
    return dijkstra(graph, directed=False, indices=size)[:size]


def _diagonals(
    local: Float[np.ndarray, "m 3"], topology: Topology
) -> tuple[Int[np.ndarray, "d 2"], Float[np.ndarray, "d"]]:
    """Find apexes of triangle pairs, and their distance when unfolded.

    The distance is that in the plane, for pairs whose quadrilateral is convex: there
    the straight line crosses the common edge.
    """
    inner = topology.interior
    first, second = topology.edges[inner].T
    one, other = topology.opposite[inner].T
    edge = local[second] - local[first]
    length = lengths(edge)
    along_one = np.einsum("ei,ei->e", local[one] - local[first], edge) / length
    along_other = np.einsum("ei,ei->e", local[other] - local[first], edge) / length
    high_one = np.sqrt(
        np.maximum(lengths(local[one] - local[first]) ** 2 - along_one**2, 0)
    )
    high_other = np.sqrt(
        np.maximum(lengths(local[other] - local[first]) ** 2 - along_other**2, 0)
    )
    crossing = along_one + (along_other - along_one) * high_one / (
        high_one + high_other
    )
    convex = (crossing > 0) & (crossing < length)
    distance = np.hypot(along_one - along_other, high_one + high_other)
    # two vertices joined by an edge too (a tetrahedron) would count twice
    convex &= ~topology.has_edge(one, other)
    pairs = np.stack([np.minimum(one, other), np.maximum(one, other)], axis=1)[convex]
    # the shorter one, where two quadrilaterals share both apexes
    order = np.lexsort((distance[convex], pairs[:, 1], pairs[:, 0]))
    pairs, distance = pairs[order], distance[convex][order]
    new = np.ones(len(pairs), dtype=bool)
    new[1:] = (pairs[1:] != pairs[:-1]).any(axis=1)
    return pairs[new], distance[new]


def _simple(
    mask: Bool[np.ndarray, "f"],
    faces: Int[np.ndarray, "f 3"],
    area: Float[np.ndarray, "f"],
    topology: Topology,
    face: int,
) -> Bool[np.ndarray, "f"]:
    """Make a patch connected, without islands and without bow ties.

    Every round only adds triangles, so it terminates.
    """
    piece = _pieces(mask, topology)
    mask = piece == piece[face]
    while True:
        before = mask
        rest = _pieces(~mask, topology)
        outside = rest >= 0
        if outside.any():
            size = np.bincount(rest[outside], weights=area[outside])
            island = size < LARGEST_ISLAND * area[mask].sum()
            # the largest piece of the rest is always the organ
            island[np.argmax(size)] = False
            mask = mask | (outside & island[rest])
        part = np.flatnonzero(mask)
        small = faces[part]
        fans = vertex_fans(small, build_topology(small, len(topology.valence)))
        mask = mask | (fans > 1)[faces].any(axis=1)
        if np.array_equal(mask, before):
            return mask


def _pieces(mask: Bool[np.ndarray, "f"], topology: Topology) -> Int[np.ndarray, "f"]:
    """Label each face by its edge-connected piece of ``mask``; -1 elsewhere."""
    links = topology.edge_faces[topology.interior]
    links = links[mask[links].all(axis=1)]
    graph = coo_array(
        (np.ones(len(links), dtype=bool), (links[:, 0], links[:, 1])),
        shape=(len(mask),) * 2,
    )
    _, label = connected_components(graph, directed=False)
    return np.where(mask, label, -1)
