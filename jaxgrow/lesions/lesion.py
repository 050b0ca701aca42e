"""What every kind of lesion is: a request, and the rule by which it grows.

A kind is one class: its fields are what a user asks for, its methods are its rule.
Everything else in the package works with any kind.
"""

from abc import abstractmethod
from typing import Annotated, ClassVar, TypeAlias

import numpy as np
import pydantic
from jaxtyping import Int

from jaxgrow.energy.parameters import Parameters
from jaxgrow.lesions.division import Division
from jaxgrow.mesh.surface import Surface
from jaxgrow.organ import Site, Tissue
from jaxgrow.runtime.entries import Model, Positive
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import State


SITE_DEFAULT = "fundus"

Place: TypeAlias = str | Annotated[tuple[float, float, float], pydantic.Strict(False)]


class Lesion(Model):
    """A lesion to grow: its size, its place, its resolution, and its rule.

    A subclass has a field ``kind`` whose annotation is a literal of its name, and the
    methods below; `jaxgrow.register_lesion` makes the kind known to scene files and to
    the command.

    Attributes:
        size_mm: largest diameter at which growth ends; 10 mm if no number of divisions
            is given either.
        divisions: number of divisions after which growth ends, instead of a size.
        particle_mm: r0, the distance at which two particles rest; the resolution.
            By default a fraction of the size (`particles_across`), or 1 mm.
        site: a named site of the organ, or x, y, z in mm near its surface.
        divisions_per_step: how many particles are born before the next equilibrium, 8
            at most; fewer where there is no room for them. The paper has one. With four
            a polyp of 80 divisions took 0.47 of the time; its mean shape differed by
            less than five seeds can tell (7 % in height).
    """

    size_mm: Positive | None = None
    divisions: Annotated[int, pydantic.Field(ge=1)] | None = None
    particle_mm: Positive | None = None
    site: Place = SITE_DEFAULT
    divisions_per_step: Annotated[int, pydantic.Field(ge=1, le=8)] = 1
    kind: str

    mechanics: ClassVar[dict[str, float]] = {}
    """Parameters of this kind of lesion, where they are not the general defaults."""

    particles_across: ClassVar[float] = 10.0
    """Particle diameters in the largest diameter of the lesion, by default."""

    needs_organ: ClassVar[bool] = True
    """Whether it cannot grow freely in space."""

    pushes_off: ClassVar[bool] = False
    """Whether it pushes itself off from the bottom of its layer of tissue: then forces
    on that are no reason to enlarge the patch."""

    @pydantic.model_validator(mode="after")
    def _one_end(self) -> "Lesion":
        if self.size_mm is not None and self.divisions is not None:
            raise ValueError("give size_mm or divisions, not both")
        return self

    @property
    def target_mm(self) -> float | None:
        """Largest diameter asked for; None if a number of divisions is."""
        if self.divisions is not None:
            return None
        return 10.0 if self.size_mm is None else self.size_mm

    @property
    def r0_mm(self) -> float:
        """Length of r0 in mm."""
        if self.particle_mm is not None:
            return self.particle_mm
        return 1.0 if self.target_mm is None else self.target_mm / self.particles_across

    @property
    def across(self) -> float:
        """Largest diameter that is expected, in r0."""
        if self.target_mm is not None:
            return self.target_mm / self.r0_mm
        return 10.0 if self.divisions is None else 2 * self.divisions ** (1 / 3)

    @abstractmethod
    def extent(self) -> tuple[float, float]:
        """Return radius of the patch and thickness of its tissue, in r0."""

    @abstractmethod
    def seed(
        self, surface: Surface, tissue: Tissue, site: Site
    ) -> tuple[Surface, Int[np.ndarray, " n"]]:
        """Return the surface, with its source if it has one, and all species.

        Args:
            surface: of the patch, in r0.
            tissue: under it, in r0.
            site: where the lesion is to grow.
        """

    def check_start(self, state: State, density: float) -> None:
        """Refuse a start that cannot be measured, before anything has grown.

        Args:
            state: relaxed.
            density: of the tissue, per r0³.

        Raises:
            SceneError: with the reason.
        """

    def most_at_once(self, thickness: float, parameters: Parameters) -> int:
        """Return the number of divisions that there is room for in one step.

        Args:
            thickness: of the free layer of tissue, in r0.
            parameters: of the mechanics.
        """
        return self.divisions_per_step

    @abstractmethod
    def choose(
        self,
        state: State,
        parameters: Parameters,
        rng: np.random.Generator,
        count: int,
    ) -> tuple[Division, ...] | None:
        """Choose who divides, and where to.

        Args:
            state: an equilibrium.
            parameters: of the mechanics.
            rng: draws.
            count: number of divisions; fewer where a further one has no place.

        Returns:
            The choices; None if every way leads out of the tissue.
        """

    @abstractmethod
    def divide(self, state: State, division: Division, parameters: Parameters) -> State:
        """Return the state after a division that has been chosen.

        It is differentiable in state and parameters.

        Args:
            state: its particles have room for one more.
            division: from `choose`.
            parameters: of the mechanics.
        """

    @abstractmethod
    def size(self, state: State) -> Scalar:
        """Return the largest diameter of the lesion, in r0.

        A number; where a derivative of the state is taken, a scalar with the same value
        and the derivative.
        """
