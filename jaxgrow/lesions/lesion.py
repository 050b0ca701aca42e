"""Base class of all kinds of lesion: a request, and a rule of growth.

A kind is one class: its fields are the user's request, its methods are its rule.
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
from jaxgrow.organ import Organ, Site, Tissue
from jaxgrow.runtime.entries import Model, Positive
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import State
from jaxgrow.transfer.device import get_number


SITE_DEFAULT = "fundus"

Place: TypeAlias = str | Annotated[tuple[float, float, float], pydantic.Strict(False)]


class Lesion(Model):
    """Lesion to grow: its size, site and resolution, and its rule.

    A subclass has a field ``kind`` whose annotation is a literal of its name, and the
    methods below; `jaxgrow.register_lesion` registers the kind for scene files and for
    the command.

    Attributes:
        size_mm: largest diameter at which growth ends; 10 mm if no number of divisions
            is given either.
        divisions: number of divisions after which growth ends, instead of a size.
        particle_mm: r0, the equilibrium distance of two particles; the resolution. By
            default a fraction of the size (`particles_across`), or 1 mm.
        site: a named site of the organ, or x, y, z in mm near its surface.
        divisions_per_step: number of divisions before the next equilibrium, 8 at most;
            fewer if there is no room for them. The paper has one. With four a polyp of
            80 divisions took 0.37 of the time; the difference of its mean shape was
            below what five seeds can resolve (6 % in height).
    """

    size_mm: Positive | None = None
    divisions: Annotated[int, pydantic.Field(ge=1)] | None = None
    particle_mm: Positive | None = None
    site: Place = SITE_DEFAULT
    divisions_per_step: Annotated[int, pydantic.Field(ge=1, le=8)] = 1
    kind: str

    mechanics: ClassVar[dict[str, float]] = {}
    """Parameters of this kind of lesion that differ from the general defaults."""

    particles_across: ClassVar[float] = 10.0
    """Default ratio of the lesion's largest diameter to r0."""

    needs_organ: ClassVar[bool] = True
    """Whether it needs an organ; if not, it can grow freely in space."""

    pushes_off: ClassVar[bool] = False
    """Whether it presses against the bottom of its layer of tissue as it grows; forces
    there do not enlarge the patch then."""

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
    def unit_mm(self) -> float:
        """Unit of length of the scene's parameters, in mm: r0 by default.

        A fraction of the size (`particles_across`); r0 if no size is asked for.
        """
        if self.target_mm is not None:
            return self.target_mm / self.particles_across
        return 1.0 if self.particle_mm is None else self.particle_mm

    @property
    def r0_mm(self) -> float:
        """Length of r0 in mm."""
        return self.unit_mm if self.particle_mm is None else self.particle_mm

    def defaults(self) -> dict[str, float]:
        """Return the default parameters of this lesion, in `unit_mm`."""
        return dict(self.mechanics)

    def requested(self) -> dict[str, float]:
        """Return the parameters that the request determines, in `unit_mm`."""
        return {}

    @property
    def across(self) -> float:
        """Expected largest diameter, in r0."""
        if self.target_mm is not None:
            return self.target_mm / self.r0_mm
        return 10.0 if self.divisions is None else 2 * self.divisions ** (1 / 3)

    @abstractmethod
    def extent(self) -> tuple[float, float]:
        """Return the patch's radius and its tissue's thickness, in r0."""

    @abstractmethod
    def seed(
        self, surface: Surface, tissue: Tissue, site: Site
    ) -> tuple[Surface, Int[np.ndarray, " n"]]:
        """Place the seed of the lesion: a source vertex, or a tumour particle.

        Args:
            surface: of the patch, in r0.
            tissue: under it, in r0.
            site: of the lesion.

        Returns:
            The surface, with its source if it has one, and the species of all
            particles.
        """

    def share_reached(self, state: State, size_mm: Scalar, divisions: int) -> float:
        """Return the share of the request that is reached; 1 ends the growth.

        Args:
            state: of the lesion.
            size_mm: its size.
            divisions: number made so far.
        """
        if self.target_mm is None:
            return divisions / (self.divisions or 1)
        return get_number(size_mm) / self.target_mm

    def accepts(self, result: Result) -> bool:
        """Return whether an end before the size is what was asked for.

        Args:
            result: after which it cannot continue.
        """
        return False

    def check_site(self, organ: Organ, site: Site) -> None:
        """Refuse a site that has no room for a lesion of the requested size.

        Args:
            organ: before growth.
            site: on it.

        Raises:
            OrganError: with the reason, and the size for which there is room.
        """

    def check_start(self, state: State, density: float) -> None:
        """Refuse an initial state in which the lesion could not be measured.

        Args:
            state: relaxed, before the first division.
            density: of the tissue, per r0³.

        Raises:
            SceneError: with the reason.
        """

    def most_at_once(self, thickness: float, parameters: Parameters) -> int:
        """Return the largest number of divisions with enough room in one step.

        Args:
            thickness: of the free layer of tissue, in r0.
            parameters: of the mechanics.
        """
        return self.divisions_per_step

    def next_foci(
        self, state: State, stage: int, parameters: Parameters
    ) -> tuple[int, ...]:
        """Choose the vertices at which foci of hyperplasia begin before this step.

        Args:
            state: an equilibrium.
            stage: how often foci were placed before.
            parameters: of the mechanics.

        Returns:
            The centres; none if nothing changes.
        """
        return ()

    def place_foci(
        self, state: State, centres: tuple[int, ...], stage: int, parameters: Parameters
    ) -> State:
        """Mark foci of hyperplasia, as chosen.

        The result is differentiable in state and parameters.

        Args:
            state: an equilibrium.
            centres: from `next_foci`.
            stage: how often foci were placed before.
            parameters: of the mechanics.
        """
        return state

    @abstractmethod
    def choose(
        self,
        state: State,
        parameters: Parameters,
        rng: np.random.Generator,
        count: int,
    ) -> tuple[Division, ...] | None:
        """Choose the dividing particles and the places of their daughters.

        Args:
            state: an equilibrium.
            parameters: of the mechanics.
            rng: of the random choices.
            count: number of divisions; fewer if there is no place for more.

        Returns:
            The choices; None if every direction leads out of the tissue.
        """

    @abstractmethod
    def divide(self, state: State, division: Division, parameters: Parameters) -> State:
        """Divide a particle, as chosen.

        The result is differentiable in state and parameters.

        Args:
            state: its particles have a free slot.
            division: from `choose`.
            parameters: of the mechanics.
        """

    @abstractmethod
    def size(self, state: State) -> Scalar:
        """Measure the largest diameter of the lesion, in r0.

        The result is a number; under differentiation of the state, a scalar with the
        same value and the derivative.
        """
