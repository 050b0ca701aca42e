"""The discrete choices of a growth, from which it can be replayed.

With other parameters a growth would choose otherwise somewhere: a particle more on one
side, an edge split earlier, an equilibrium in another packing. Its derivative is that
of a growth whose choices are frozen; a replay makes them again. So every event also
keeps its equilibrium: the replay's relaxation starts there, and stays in its basin.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, overload

import jax

from jaxgrow.energy.parameters import Parameters
from jaxgrow.growth.ground import Ground, Layout
from jaxgrow.growth.setup import Setup
from jaxgrow.lesions.division import Division
from jaxgrow.mesh.surface import Remeshing
from jaxgrow.organ import Enlargement
from jaxgrow.runtime.results import Result
from jaxgrow.scene.scene import Scene
from jaxgrow.transfer.device import get_number, Positions


def numbers(parameters: Parameters) -> Parameters:
    """Return the parameters as numbers, without derivatives."""
    return jax.tree.map(get_number, parameters)


class EquilibriumRecord(NamedTuple):
    """One equilibrium, and the fairing after it.

    Attributes:
        positions: at the equilibrium, before fairing.
        colliding: whether the collision energy was part of it.
        remeshing: what fairing did; None without a membrane.
    """

    positions: Positions
    colliding: bool
    remeshing: Remeshing | None


class PatchEnlargement(NamedTuple):
    """An enlargement of the patch.

    Attributes:
        ground: with the larger patch.
        enlargement: what was taken in.
        equilibrium: after it.
    """

    ground: Ground
    enlargement: Enlargement
    equilibrium: EquilibriumRecord


class Event(NamedTuple):
    """The discrete choices of one growth step.

    Attributes:
        divisions: who divided, and where to; one, or as many as the scene asks for.
        equilibrium: after them, with the fairing.
        enlargements: of the patch after it, mostly none.
    """

    divisions: tuple[Division, ...]
    equilibrium: EquilibriumRecord
    enlargements: tuple[PatchEnlargement, ...] = ()

    @property
    def redirected(self) -> bool:
        """Whether a polyp's daughter was not put where the rule puts it."""
        return any(d.parent < 0 and any(d.offset) for d in self.divisions)

    @property
    def remeshing(self) -> Remeshing | None:
        """What fairing did; None without a membrane."""
        return self.equilibrium.remeshing


class InitialRecord(NamedTuple):
    """What a growth starts from.

    Attributes:
        layout: of patch and tissue; None for a free cluster.
        positions: once it was relaxed; None for a free cluster.
        enlargements: of the patch before the first division, mostly none.
    """

    layout: Layout | None
    positions: Positions | None
    enlargements: tuple[PatchEnlargement, ...] = ()


@dataclass(frozen=True, eq=False)
class Events(Sequence[Event]):
    """All events of a growth, in their order; for `jaxgrow.grow(..., events=...)`.

    Attributes:
        start: what came before the first.
        steps: the events.
        parameters: the growth was made with, as numbers.
        tolerance: of its equilibria, in F(0).
        lesion: kind of the lesion.
        particle_mm: r0 in mm.
        result: why it ended.
    """

    start: InitialRecord
    steps: tuple[Event, ...]
    parameters: Parameters
    tolerance: float
    lesion: str
    particle_mm: float
    result: Result

    @classmethod
    def of(
        cls,
        setup: Setup,
        start: InitialRecord,
        steps: tuple[Event, ...],
        result: Result,
    ) -> "Events":
        """Return the choices of a growth, with what it was made with.

        Args:
            setup: of the growth.
            start: what came before the first step.
            steps: the events.
            result: why it ended.
        """
        scene = setup.scene
        return cls(
            start,
            steps,
            numbers(setup.parameters),
            setup.tolerance,
            scene.lesion.kind,
            scene.r0_mm,
            result,
        )

    def check_scene(self, scene: Scene) -> None:
        """Refuse to be replayed, or gone on with, in another scene.

        Raises:
            ValueError: kind of lesion or size of particles differ.
        """
        kind, r0_mm = scene.lesion.kind, scene.r0_mm
        if (kind, r0_mm) != (self.lesion, self.particle_mm):
            raise ValueError(
                f"the events are those of a {self.lesion} with particles of "
                f"{self.particle_mm:g} mm, and the scene asks for a {kind} with "
                f"{r0_mm:g} mm; replay a growth in its own scene."
            )

    @overload
    def __getitem__(self, index: int) -> Event: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Event]: ...
    def __getitem__(self, index: int | slice) -> Event | Sequence[Event]:
        """An event, or some of them."""
        return self.steps[index]

    def __len__(self) -> int:
        """Number of events."""
        return len(self.steps)

    @property
    def divisions(self) -> int:
        """Number of divisions, one or more an event."""
        return sum(len(event.divisions) for event in self.steps)

    def __iter__(self) -> Iterator[Event]:
        """The events in their order."""
        return iter(self.steps)
