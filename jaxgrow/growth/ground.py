"""What surrounds a lesion on the host: the organ, the site, the patch cut out of it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxgrow.mesh.collision_mesh import Walls
from jaxgrow.mesh.surface import Surface
from jaxgrow.organ import Organ, Patch, Site, Tissue


@dataclass(frozen=True, eq=False)
class Ground:
    """What surrounds a lesion on the host; None throughout for a free cluster.

    Attributes:
        organ: the whole organ.
        site: where the lesion grows.
        patch: the piece of surface that is simulated.
        walls: the rest of the organ's surface, as far as the lesion may meet it.
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
        """Return whether a place on the border is at the bottom, not at the sides.

        Args:
            place: in r0.
        """
        axis = self.site.normal
        sideways = float(np.linalg.norm(place - (place @ axis) * axis))
        return sideways < 0.6 * self.radius


@dataclass(frozen=True, eq=False)
class Layout:
    """Patch and tissue before they are relaxed, on the host.

    Attributes:
        ground: what is around.
        surface: of the patch, with the source of a polyp.
        organ_index: of each of its vertices the organ's vertex that it is, or -1.
        tissue: the particles.
        species: of each of them.
    """

    ground: Ground
    surface: Surface
    organ_index: Int[np.ndarray, " m"]
    tissue: Tissue
    species: Int[np.ndarray, " n"]
