"""Walls: the rest of an organ, which a growing surface may meet."""

from __future__ import annotations

import numpy as np

from jaxgrow.mesh.collision_mesh import Walls
from jaxgrow.mesh.quality import lengths
from jaxgrow.organ.organ import Organ
from jaxgrow.organ.patch import Patch


def walls_around(organ: Organ, patch: Patch, within: float) -> Walls:
    """Return the organ's triangles outside the patch, up to a distance.

    Args:
        organ: The organ.
        patch: A patch of it.
        within: Distance from the site in r0 up to which triangles are taken.

    Returns:
        Walls in the patch's frame; vertices are named by the organ's indices.
    """
    local = patch.to_local(organ.vertices)
    near = lengths(local) <= within
    rest = ~patch.face_mask & near[organ.faces].any(axis=1)
    faces = organ.faces[rest]
    if organ.lumen_sign < 0:
        faces = faces[:, ::-1]
    names, flat = np.unique(faces, return_inverse=True)
    # the rim's coordinates as the patch has them, to the last bit
    return Walls(local[names], flat.reshape(-1, 3), names)
