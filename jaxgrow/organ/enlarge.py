"""Enlargement of a patch whose growth has come too near its rim.

All particles and vertices of the membrane keep their positions. A ring of the organ is
added around them, with tissue under it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxgrow.organ.layer_points import Addition, Layer
from jaxgrow.organ.merge import merge
from jaxgrow.organ.organ import Organ, OrganError
from jaxgrow.organ.patch import Patch, widen_patch
from jaxgrow.organ.patch_surface import extend_lining, Lining
from jaxgrow.organ.signed_distance import Sides
from jaxgrow.organ.tissue import extend_tissue, Tissue


@dataclass(frozen=True, eq=False)
class Enlargement:
    """Larger patch with its additions, as data that can be replayed.

    Attributes:
        patch: The larger patch. Local positions are those of the one before.
        lining: The membrane on it: first the earlier vertices, in their order.
        tissue: The new particles, to be appended to the earlier ones.
        held: Which of the earlier particles are held now.
        thickness: Of the layer of tissue, in r0.
    """

    patch: Patch
    lining: Lining
    tissue: Tissue
    held: Bool[np.ndarray, "n"]
    thickness: float


def enlarge(
    organ: Organ,
    patch: Patch,
    lining: Lining,
    points: Float[np.ndarray, "n 3"],
    held: Bool[np.ndarray, "n"],
    *,
    radius: float,
    thickness: float,
    thickness_before: float,
    density: float,
    max_area: float,
    min_area: float,
    gap: float,
    hold: float,
    rng: np.random.Generator,
) -> Enlargement:
    """Enlarge a patch during growth by a ring of the organ and deeper tissue.

    The patch gets every triangle that touches it and those within the radius, so it
    grows on every side, whatever the radius: the whole old rim becomes free. The ring
    is refined and joined to the membrane (``extend_lining``); tissue is put under it,
    and under the old layer where that gets thicker, around the particles present
    (``extend_tissue``). A held particle stays held only near the new sides and bottom;
    a free one stays free. All lengths are in r0.

    The new tissue and the ring are not in equilibrium: relax them before continuing.

    Args:
        organ: The organ.
        patch: The patch that the membrane grew from.
        lining: The membrane at present.
        points: All particles at present, tissue and tumour.
        held: Which of them are held.
        radius: Of the new patch, along the surface.
        thickness: Of the new layer of tissue.
        thickness_before: Of the old layer of tissue.
        density: Of the new tissue, particles per r0³.
        max_area: Triangles of the ring above it (r0²) are subdivided.
        min_area: Triangles of the ring below it (r0²) are collapsed.
        gap: Distance of new particles to the membrane.
        hold: Particles within this distance of the sides or the bottom are held.
        rng: Draws the new tissue.

    Returns:
        The patch, the membrane, the new particles and the held ones.

    Raises:
        OrganError: If the patch would take nearly the whole organ, the layer would
            become thinner, the membrane does not have the patch's rim or form, or a
            particle is outside the tissue beside the old patch.
    """
    if not thickness >= thickness_before:
        msg = (
            f"a tissue layer of {thickness_before:g} r0 cannot become {thickness:g} r0 "
            "thick in an enlargement, as what has grown stays: give at least as much."
        )
        raise OrganError(msg)
    wider = widen_patch(organ, patch, radius * patch.r0_mm)
    new = extend_lining(
        lining, organ, patch, wider, points, max_area=max_area, min_area=min_area
    )
    layer = Layer(organ, wider, gap, thickness)
    grown = _grown_organ(organ, wider, new)
    _check_side(organ, grown, points)
    tissue = extend_tissue(
        Addition(layer, patch, thickness_before, grown, -organ.lumen_sign),
        points,
        spacing=1.0,
        density=density,
        hold=hold,
        rng=rng,
    )
    still = np.flatnonzero(held)
    depth = layer.depth(points[still])
    now = np.zeros(len(points), dtype=bool)
    now[still] = layer.near_edge(points[still], depth, hold)
    return Enlargement(wider, new, tissue, now, float(thickness))


def _grown_organ(organ: Organ, patch: Patch, lining: Lining) -> Sides:
    """Return the organ with the lesion, in local positions."""
    surface, organ_index = lining
    vertices_mm = patch.to_mm(surface.vertices)
    merged = merge(organ, patch, vertices_mm, surface.faces, organ_index)
    return Sides(patch.to_local(merged.vertices), merged.faces)


def _check_side(organ: Organ, grown: Sides, points: Float[np.ndarray, "n 3"]) -> None:
    side = grown.measure(points).side
    lost = int((-organ.lumen_sign * side <= 0).sum())
    if lost:
        msg = (
            f"{lost} particles are outside the tissue of {organ.name} beside the patch "
            "that grew, so it cannot be enlarged around them: start again with a "
            "larger radius."
        )
        raise OrganError(msg)
