"""Union of the grown patch with the rest of the organ, vertex for vertex."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxgrow.organ.organ import Organ, OrganError
from jaxgrow.organ.patch import Patch


class Merged(NamedTuple):
    """Organ with a grown patch in place of the original one.

    Attributes:
        vertices: In mm: first the organ's, without the patch's interior, in their
            order and with their exact coordinates; then the grown ones.
        faces: First the organ's outside the patch, in their order; then the grown
            ones. Normals point out of the closed surface.
        origin: For each vertex its index in the organ, -1 for a new one.
        placed: For each vertex of the grown patch its index in ``vertices``.
    """

    vertices: Float[np.ndarray, "m 3"]
    faces: Int[np.ndarray, "f 3"]
    origin: Int[np.ndarray, "m"]
    placed: Int[np.ndarray, "p"]


def merge(
    organ: Organ,
    patch: Patch,
    vertices_mm: Float[np.ndarray, "p 3"],
    faces: Int[np.ndarray, "g 3"],
    organ_index: Int[np.ndarray, "p"],
) -> Merged:
    """Replace a patch by the surface that grew from it.

    The rim is shared by index: its coordinates are the organ's, and the given ones are
    ignored. The result is closed and a manifold, with the organ's Euler number, if the
    grown surface is a manifold of the patch's Euler number with the patch's rim.

    Args:
        organ: The organ.
        patch: The patch that was cut out of it.
        vertices_mm: The grown surface's vertices in mm.
        faces: Its faces, normals into the lumen.
        organ_index: For each of its vertices its index in the organ, -1 for a vertex
            that growth added.

    Returns:
        The joined surface and the origin of its vertices.

    Raises:
        OrganError: If the grown surface does not have the patch's rim.
    """
    _check_rim(patch, faces, organ_index)
    inner = np.zeros(len(organ.vertices), dtype=bool)
    inner[patch.organ_index[~patch.rim]] = True
    kept = np.flatnonzero(~inner)
    renumber = np.full(len(organ.vertices), -1)
    renumber[kept] = np.arange(len(kept))

    on_rim = np.isin(organ_index, patch.organ_index[patch.rim])
    placed = np.zeros(len(vertices_mm), dtype=np.int64)
    placed[on_rim] = renumber[organ_index[on_rim]]
    placed[~on_rim] = len(kept) + np.arange(int((~on_rim).sum()))

    grown = faces[:, ::-1] if organ.lumen_sign < 0 else faces
    return Merged(
        vertices=np.concatenate([organ.vertices[kept], vertices_mm[~on_rim]]),
        faces=np.concatenate([renumber[organ.faces[~patch.face_mask]], placed[grown]]),
        origin=np.concatenate([kept, organ_index[~on_rim]]),
        placed=placed,
    )


def _check_rim(
    patch: Patch, faces: Int[np.ndarray, "g 3"], organ_index: Int[np.ndarray, "p"]
) -> None:
    """Raise if the rim's directed edges differ from those of the patch."""
    before = _rim_edges(patch.faces, patch.organ_index)
    after = _rim_edges(faces, organ_index)
    if before != after:
        msg = (
            f"the grown surface has {len(after - before)} rim edges that the patch has "
            f"not and lacks {len(before - after)} of its {len(before)}, but it can be "
            "joined to the organ only along the same rim: keep the rim as it was cut."
        )
        raise OrganError(msg)


def _rim_edges(
    faces: Int[np.ndarray, "f 3"], names: Int[np.ndarray, "m"]
) -> set[tuple[int, int]]:
    start, end = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    size = len(names)
    rim = ~np.isin(end * size + start, start * size + end)
    return set(zip(names[start[rim]].tolist(), names[end[rim]].tolist(), strict=True))
