"""Smooth label of the lesion: 0 on the healthy surface, 1 on the lesion."""

import numpy as np
from jaxtyping import Bool, Float32, Int
from scipy.spatial import KDTree

from jaxgrow.lesions.size import COVERING, height_above, lesion_vertices, RAISED
from jaxgrow.mesh.topology import connected_parts
from jaxgrow.state import Species, State
from jaxgrow.transfer.device import get, get_particles, get_surface


WIDTH = 1.0
"""Height, or distance to the tumour, over which the label rises from 0 to 1, in r0."""

_BELOW_HALF = np.nextafter(np.float32(0.5), np.float32(0.0))


def smooth_label(state: State) -> Float32[np.ndarray, " m"]:
    """Compute the smooth label of the membrane vertices alive, from 0 to 1.

    With the height h above the former surface and the distance d to the nearest tumour
    particle (both in r0) it is

        clip(1/2 + max(h - `RAISED`, `COVERING` - d) / `WIDTH`, 0, 1),

    continuous over the surface, and not below 1/2 exactly where
    `jaxgrow.lesions.size.lesion_vertices` has the lesion. Height counts only on a part
    of the surface above `RAISED` - `WIDTH` / 2 that is connected with the lesion, and a
    part above `RAISED` that was not raised by the tumour stays below 1/2.
    """
    assert state.membrane is not None
    assert state.frame.former is not None
    surface, former = get_surface(state.membrane), state.frame.former
    label = lesion_vertices(state)
    height = height_above(surface.vertices, get(former.vertices), get(former.faces))
    raised = 0.5 + (height - RAISED) / WIDTH
    raised = np.where(_connected(surface.faces, (raised > 0) | label, label), raised, 0)
    position, species = get_particles(state.particles)
    tumour = position[species == Species.TUMOUR]
    if len(tumour):
        distance, _ = KDTree(tumour).query(surface.vertices)
        raised = np.maximum(raised, 0.5 + (COVERING - distance) / WIDTH)
    value = np.clip(raised, 0.0, 1.0).astype(np.float32)
    # Rounded to 32 bits it may tie with 1/2; the label decides.
    return np.where(
        label, np.maximum(value, np.float32(0.5)), np.minimum(value, _BELOW_HALF)
    )


def _connected(
    faces: Int[np.ndarray, "f 3"],
    chosen: Bool[np.ndarray, " m"],
    seeds: Bool[np.ndarray, " m"],
) -> Bool[np.ndarray, " m"]:
    """Mark the parts of the chosen vertices that contain a seed."""
    part = connected_parts(faces, chosen)
    return chosen & np.isin(part, part[seeds])
