"""What a growth is made with, and where it stands between two divisions."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.problem import ExtraTerms
from jaxgrow.growth.boundary import BoundaryReaction
from jaxgrow.growth.ground import Ground
from jaxgrow.lesions.lesion import Lesion
from jaxgrow.mesh.collision_mesh import Walls
from jaxgrow.mesh.quality import radius_ratio
from jaxgrow.scene.scene import Scene
from jaxgrow.state import State
from jaxgrow.transfer.device import get_surface


LEAST_QUALITY = 0.01
"""Least radius ratio 2 r_in / r_circ of a triangle of a valid surface; half of the
organ's least, if that is less. Repair sets in at 0.15, see `jaxgrow.mesh.repair`."""


@dataclass(frozen=True, eq=False)
class Setup:
    """What all steps of a growth have in common.

    Attributes:
        scene: what grows.
        parameters: of the energy, as arrays.
        tolerance: largest force left in an equilibrium, in F(0).
        terms: of the energy, besides those of jaxgrow.
    """

    scene: Scene
    parameters: Parameters
    tolerance: float
    terms: ExtraTerms = ()

    @property
    def lesion(self) -> Lesion:
        """The lesion asked for, which knows its rule."""
        return self.scene.lesion


@dataclass(frozen=True, eq=False)
class GrowthState:
    """The state between two divisions, with what is carried along on the host.

    Attributes:
        state: an equilibrium, springs reset.
        organ_index: of each vertex alive the organ's vertex that it is, or -1.
        lists: of the last relaxation; None before the first.
        ground: what is around; None for a free cluster.
        colliding: whether sheets of the surface have come near each other.
        border: what is held around the patch, before growth; None for a free cluster.
        least_quality: radius ratio that no triangle may fall below.
    """

    state: State
    organ_index: Int[np.ndarray, " m"]
    lists: Lists | None
    ground: Ground | None
    colliding: bool = False
    border: BoundaryReaction | None = None
    least_quality: float = LEAST_QUALITY

    def __getstate__(self) -> dict[str, Any]:
        """Return what goes to another process: lists are made again there."""
        return {**self.__dict__, "lists": None}

    @property
    def walls(self) -> Walls | None:
        """The rest of the organ."""
        return None if self.ground is None else self.ground.walls


def min_radius_ratio(state: State) -> float:
    """Return the least radius ratio of the surface's triangles; 1 if there is none."""
    if state.membrane is None:
        return 1.0
    surface = get_surface(state.membrane)
    corners = surface.vertices[surface.faces]
    return float(radius_ratio(corners).min(initial=1.0))


def quality_bound(state: State) -> float:
    """Return the least quality that is asked for from here on: `LEAST_QUALITY`."""
    return min(LEAST_QUALITY, 0.5 * min_radius_ratio(state))
