"""Surroundings of a lesion on the host: organ, site and patch."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxgrow.mesh.collision_mesh import Walls
from jaxgrow.mesh.surface import Surface
from jaxgrow.organ import Organ, Patch, Site, Tissue


@dataclass(frozen=True, eq=False)
class Ground:
    """Surroundings of a lesion on the host; a free cluster has none.

    Attributes:
        organ: the whole organ.
        site: of the lesion.
        patch: the piece of surface that is simulated.
        walls: the rest of the organ's surface, as far as the lesion may touch it.
        radius: of the patch along the surface, in r0.
        thickness: of the layer of tissue under it, in r0.
    """

    organ: Organ
    site: Site
    patch: Patch
    walls: Walls
    radius: float
    thickness: float

    def is_below(self, place: Float[np.ndarray, "3"]) -> bool:
        """Return whether a place on the boundary is at its bottom.

        Else it is at the sides.

        Args:
            place: in r0.
        """
        axis = self.site.normal
        sideways = float(np.linalg.norm(place - (place @ axis) * axis))
        return sideways < 0.6 * self.radius


@dataclass(frozen=True, eq=False)
class Layout:
    """Layout of patch and tissue before their relaxation, on the host.

    Attributes:
        ground: the surroundings.
        surface: of the patch, with the source of a polyp.
        organ_index: for each of its vertices the same vertex of the organ, or -1.
        tissue: the particles.
        species: of each of them.
    """

    ground: Ground
    surface: Surface
    organ_index: Int[np.ndarray, " m"]
    tissue: Tissue
    species: Int[np.ndarray, " n"]
