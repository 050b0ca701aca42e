"""Setup of a growth, and its state between two divisions."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.extra_terms import ExtraTerms
from jaxgrow.equilibrium.lists import Lists
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
organ's least, if that is less. Repair begins at 0.15, see `jaxgrow.mesh.repair`."""


@dataclass(frozen=True, eq=False)
class Setup:
    """Setup of a growth, common to all its steps.

    Attributes:
        scene: organ, lesion and parameters.
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
        """Lesion asked for, with its rule."""
        return self.scene.lesion


@dataclass(frozen=True, eq=False)
class GrowthState:
    """State between two divisions, with its data on the host.

    Attributes:
        state: an equilibrium, springs reset.
        organ_index: for each vertex alive the same vertex of the organ, or -1.
        lists: of the last relaxation; None before the first.
        ground: surroundings of the lesion; None for a free cluster.
        colliding: whether sheets of the surface have approached each other.
        border: boundary of the patch before growth; None for a free cluster.
        least_quality: least radius ratio that a triangle may have.
        stage: how often foci of hyperplasia were placed.
    """

    state: State
    organ_index: Int[np.ndarray, " m"]
    lists: Lists | None
    ground: Ground | None
    colliding: bool = False
    border: BoundaryReaction | None = None
    least_quality: float = LEAST_QUALITY
    stage: int = 0

    def __getstate__(self) -> dict[str, Any]:
        """Return what goes to another process: lists are made again there."""
        return {**self.__dict__, "lists": None}

    @property
    def walls(self) -> Walls | None:
        """Rest of the organ's surface; None for a free cluster."""
        return None if self.ground is None else self.ground.walls


def min_radius_ratio(state: State) -> float:
    """Return the least radius ratio of the surface's triangles; 1 if none."""
    if state.membrane is None:
        return 1.0
    surface = get_surface(state.membrane)
    corners = surface.vertices[surface.faces]
    return float(radius_ratio(corners).min(initial=1.0))


def quality_bound(state: State) -> float:
    """Return the least radius ratio required from this state on.

    `LEAST_QUALITY`, or half of the current least, if that is less.
    """
    return min(LEAST_QUALITY, 0.5 * min_radius_ratio(state))
