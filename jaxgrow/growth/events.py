"""The discrete choices of a growth, from which it can be replayed.

With other parameters a growth would choose otherwise somewhere: a particle more on one
side, an edge split earlier, an equilibrium in another packing. Its derivative is that
of a growth whose choices are frozen; a replay makes them again. So every event also
keeps its equilibrium: the replay's relaxation starts there, and stays in its basin.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, overload

from jaxgrow.energy.parameters import Parameters
from jaxgrow.growth.division import Division
from jaxgrow.growth.initial_state import Ground, Layout
from jaxgrow.mesh.surface import Remeshing
from jaxgrow.organ import Enlargement
from jaxgrow.runtime.results import Result
from jaxgrow.transfer.device import Positions


class Settling(NamedTuple):
    """One equilibrium, and the fairing after it.

    Attributes:
        positions: at the equilibrium, before fairing.
        colliding: whether the collision energy was part of it.
        remeshing: what fairing did; None without a membrane.
    """

    positions: Positions
    colliding: bool
    remeshing: Remeshing | None


class Widening(NamedTuple):
    """An enlargement of the patch.

    Attributes:
        ground: with the larger patch.
        enlargement: what was taken in.
        settling: after it.
    """

    ground: Ground
    enlargement: Enlargement
    settling: Settling


class Event(NamedTuple):
    """The discrete choices of one growth step.

    Attributes:
        divisions: who divided, and where to; one, or as many as the scene asks for.
        settling: the equilibrium and the fairing.
        widenings: of the patch after it, mostly none.
    """

    divisions: tuple[Division, ...]
    settling: Settling
    widenings: tuple[Widening, ...] = ()

    @property
    def redirected(self) -> bool:
        """Whether a polyp's daughter was not put where the rule puts it."""
        return any(d.parent < 0 and any(d.offset) for d in self.divisions)

    @property
    def remeshing(self) -> Remeshing | None:
        """What fairing did; None without a membrane."""
        return self.settling.remeshing


class Start(NamedTuple):
    """What a growth starts from.

    Attributes:
        layout: of patch and tissue; None for a free cluster.
        positions: once it was relaxed; None for a free cluster.
        widenings: of the patch before the first division, mostly none.
    """

    layout: Layout | None
    positions: Positions | None
    widenings: tuple[Widening, ...] = ()


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

    start: Start
    steps: tuple[Event, ...]
    parameters: Parameters
    tolerance: float
    lesion: str
    particle_mm: float
    result: Result

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
