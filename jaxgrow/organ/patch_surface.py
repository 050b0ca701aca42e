"""Membrane of a patch: the organ's triangles at the particles' scale."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxgrow.mesh.fairing import fair, refine
from jaxgrow.mesh.subdivide import split_edges
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.topology import build_topology, euler_number, is_manifold
from jaxgrow.organ.organ import Organ, OrganError
from jaxgrow.organ.patch import Patch, seen_from_lumen


class Lining(NamedTuple):
    """Membrane, with the indices of its vertices in the organ.

    Attributes:
        surface: Local positions in r0; fixed at the patch's rim.
        organ_index: For each vertex its index in the organ, -1 for one that was added.
    """

    surface: Surface
    organ_index: Int[np.ndarray, "m"]


def line_patch(
    organ: Organ,
    patch: Patch,
    *,
    max_area: float,
    min_area: float,
) -> Lining:
    """Build the membrane that growth starts with.

    The patch's triangles are subdivided and faired, with the rim kept. An edge across
    the patch between two vertices of the rim is split if the rest of the organ has the
    same edge: joined, four triangles would meet at it.

    Args:
        organ: The organ.
        patch: The patch.
        max_area: In r0²; larger triangles are subdivided.
        min_area: In r0²; smaller ones are collapsed.

    Returns:
        The membrane, without a source.
    """
    surface = Surface(patch.vertices, patch.faces, patch.rim)
    nobody = np.zeros((0, 3))
    lining = _refined(surface, patch.organ_index, nobody, max_area, min_area)
    return _without_chords(lining, organ.faces[~patch.face_mask], len(organ.vertices))


def extend_lining(
    lining: Lining,
    organ: Organ,
    patch: Patch,
    wider: Patch,
    particles: Float[np.ndarray, "n 3"],
    *,
    max_area: float,
    min_area: float,
) -> Lining:
    """Extend the grown membrane by the ring of a wider patch.

    The ring between the two rims is refined as in ``line_patch``, with both rims kept
    and clear of the grown surface, and joined at the old rim vertex for vertex. The
    grown vertices come first, in their order; those of the old rim are free now.

    Args:
        lining: The membrane, grown.
        organ: The organ.
        patch: The patch that it grew from.
        wider: A patch that has that one in its interior.
        particles: Local positions; no operation on the ring brings it too near.
        max_area: In r0²; larger triangles are subdivided.
        min_area: In r0²; smaller ones are collapsed.

    Returns:
        The membrane on the wider patch, with the same source.

    Raises:
        OrganError: If the result is not an oriented manifold with the wider patch's
            Euler number, because the grown membrane had another one than its patch.
    """
    grown, organ_index = lining
    seat = np.full(len(organ.vertices), -1)
    on_rim = np.isin(organ_index, patch.organ_index[patch.rim])
    seat[organ_index[on_rim]] = np.flatnonzero(on_rim)
    ring = _ring(lining, seat, organ, patch, wider)
    ring = _refined(
        *ring, particles, max_area, min_area, walls=grown.vertices[grown.faces]
    )
    beyond = [organ.faces[~wider.face_mask], organ_index[grown.faces]]
    ring = _without_chords(ring, np.concatenate(beyond), len(organ.vertices))

    joined = np.where(ring.organ_index >= 0, seat[ring.organ_index], -1)
    new = joined < 0
    joined[new] = len(grown.vertices) + np.arange(int(new.sum()))
    free = np.zeros(len(grown.vertices), dtype=bool)
    surface = Surface(
        vertices=np.concatenate([grown.vertices, ring.surface.vertices[new]]),
        faces=np.concatenate([grown.faces, joined[ring.surface.faces]]),
        fixed=np.concatenate([free, ring.surface.fixed[new]]),
        source=grown.source,
    )
    _check(surface, wider)
    return Lining(surface, np.concatenate([organ_index, ring.organ_index[new]]))


def _ring(
    lining: Lining,
    seat: Int[np.ndarray, "M"],
    organ: Organ,
    patch: Patch,
    wider: Patch,
) -> Lining:
    """Extract the organ between two rims; the old rim keeps its coordinates.

    Args:
        lining: On the patch.
        seat: For each of the organ's vertices its index on the old rim, or -1.
        organ: The organ.
        patch: The patch that has grown.
        wider: The one around it.
    """
    names, faces = seen_from_lumen(organ, wider.face_mask & ~patch.face_mask)
    vertices = np.where(
        (seat[names] >= 0)[:, None],
        lining.surface.vertices[seat[names]],
        wider.vertices[np.searchsorted(wider.organ_index, names)],
    )
    rims = build_topology(faces, len(names)).rim_vertices
    return Lining(Surface(vertices, faces, rims), names)


def _refined(
    surface: Surface,
    organ_index: Int[np.ndarray, "m"],
    particles: Float[np.ndarray, "n 3"],
    max_area: float,
    min_area: float,
    walls: Float[np.ndarray, "w 3 3"] | None = None,
) -> Lining:
    """Refine a piece of the organ to the particles' scale."""
    surface, refined = refine(surface, max_area)
    surface, faired = fair(
        surface, particles, max_area=max_area, min_area=min_area, walls=walls
    )
    return _traced(surface, organ_index, refined.then(faired).origin())


def _traced(
    surface: Surface,
    organ_index: Int[np.ndarray, "m"],
    origin: Int[np.ndarray, "k"],
) -> Lining:
    """Return a remeshed surface with the organ's indices carried along."""
    return Lining(surface, np.where(origin >= 0, organ_index[origin], -1))


def _without_chords(
    lining: Lining, beyond: Int[np.ndarray, "f 3"], size: int
) -> Lining:
    """Split edges between fixed vertices that the surface around has too.

    Edge swaps on one side of a rim do not check the edges on its other side.

    Args:
        lining: A piece of the organ with fixed rims.
        beyond: Triangles on the other side of its rims, in the organ's numbers; -1 for
            a vertex that growth added.
        size: Number of the organ's vertices.
    """
    surface, organ_index = lining
    topology = build_topology(surface.faces, len(surface.vertices))
    pairs = np.concatenate([beyond[:, [0, 1]], beyond[:, [1, 2]], beyond[:, [2, 0]]])
    pairs = pairs[(pairs >= 0).all(axis=1)]
    taken = np.isin(_keys(organ_index[topology.edges], size), _keys(pairs, size))
    across = topology.interior & surface.fixed[topology.edges].all(axis=1)
    if not (across & taken).any():
        return lining
    surface, split = split_edges(surface, topology, across & taken)
    return _traced(surface, organ_index, split.origin())


def _keys(pairs: Int[np.ndarray, "p 2"], size: int) -> Int[np.ndarray, "p"]:
    """Return one number for each unordered pair of the organ's vertices."""
    return pairs.min(axis=1) * size + pairs.max(axis=1)


def _check(surface: Surface, patch: Patch) -> None:
    number, wanted = euler_number(surface.faces), euler_number(patch.faces)
    if is_manifold(surface.faces, len(surface.vertices)) and number == wanted:
        return
    msg = (
        "the membrane on the enlarged patch is no oriented manifold with the patch's "
        f"Euler number (it has {number}, the patch {wanted}): the membrane grew a hole "
        "or a handle before, so start again from a state without one."
    )
    raise OrganError(msg)
