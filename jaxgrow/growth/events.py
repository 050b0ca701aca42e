"""Record of the discrete choices of a growth, for its replay.

With other parameters some choice of a growth would be different: a particle more on one
side, an edge split earlier, an equilibrium in another packing. Its derivative is that
of a growth with frozen choices; a replay repeats them. So every event also records its
equilibrium: the replay's relaxation starts there, and stays in its basin.
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
    """Record of one equilibrium, and of the fairing after it.

    Attributes:
        positions: at the equilibrium, before fairing.
        colliding: whether the collision energy was part of it.
        remeshing: operations of the fairing; None without a membrane.
    """

    positions: Positions
    colliding: bool
    remeshing: Remeshing | None


class PatchEnlargement(NamedTuple):
    """Record of an enlargement of the patch.

    Attributes:
        ground: with the larger patch.
        enlargement: the surface and tissue added.
        equilibrium: after it.
    """

    ground: Ground
    enlargement: Enlargement
    equilibrium: EquilibriumRecord


class Event(NamedTuple):
    """Discrete choices of one growth step.

    Attributes:
        divisions: particles and directions; one, or as many as the scene asks for.
        equilibrium: after them, with the fairing.
        enlargements: of the patch after it, mostly none.
        foci: vertices at which foci of hyperplasia begin before it, mostly none.
    """

    divisions: tuple[Division, ...]
    equilibrium: EquilibriumRecord
    enlargements: tuple[PatchEnlargement, ...] = ()
    foci: tuple[int, ...] = ()

    @property
    def redirected(self) -> bool:
        """Whether a polyp's daughter was not placed by the paper's rule."""
        return any(d.parent < 0 and any(d.offset) for d in self.divisions)

    @property
    def remeshing(self) -> Remeshing | None:
        """Operations of the fairing; None without a membrane."""
        return self.equilibrium.remeshing

    def __repr__(self) -> str:
        """Count the choices in one line."""
        counts = {
            "divisions": len(self.divisions),
            "enlargements": len(self.enlargements),
            "foci": len(self.foci),
        }
        told = (f"{name}={count}" for name, count in counts.items() if count)
        return f"Event({', '.join(told)})"


class InitialRecord(NamedTuple):
    """Record of the initial state of a growth.

    Attributes:
        layout: of patch and tissue; None for a free cluster.
        positions: after its relaxation; None for a free cluster.
        enlargements: of the patch before the first division, mostly none.
    """

    layout: Layout | None
    positions: Positions | None
    enlargements: tuple[PatchEnlargement, ...] = ()


@dataclass(frozen=True, eq=False)
class Events(Sequence[Event]):
    """Sequence of all events of a growth, in their order.

    `jaxgrow.grow` replays it as `events`.

    Attributes:
        start: the initial state.
        steps: the events.
        parameters: of the growth, as numbers, in r0 (`Lesion.unit_mm` in a scene).
        tolerance: of its equilibria, in F(0).
        lesion: kind of the lesion.
        particle_mm: r0 in mm.
        result: of the growth.
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
        """Make the record of a growth, with its parameters and tolerance.

        Args:
            setup: of the growth.
            start: the initial state.
            steps: the events.
            result: of the growth.
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
        """Refuse a replay or a continuation in another scene.

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
        """Return an event, or some of them."""
        return self.steps[index]

    def __len__(self) -> int:
        """Return the number of events."""
        return len(self.steps)

    @property
    def divisions(self) -> int:
        """Number of divisions, one or more per event."""
        return sum(len(event.divisions) for event in self.steps)

    def __iter__(self) -> Iterator[Event]:
        """Iterate over the events in their order."""
        return iter(self.steps)

    def __repr__(self) -> str:
        """Describe lesion, steps and result in one line."""
        return (
            f"Events({self.lesion} of {self.particle_mm:.3g} mm particles, {len(self)} "
            f"steps, {self.divisions} divisions: {self.result.name})"
        )
