"""Progress of a running growth."""

from typing import NamedTuple

from jaxgrow.growth.history import StepRecord
from jaxgrow.runtime.timer import Clock
from jaxgrow.scene.scene import Scene
from jaxgrow.state import State
from jaxgrow.transfer.device import get_number


class Progress(NamedTuple):
    """Progress of a running growth after a step.

    Attributes:
        divisions: number made so far.
        size_mm: largest diameter of the lesion now, without a derivative.
        target_mm: size asked for, or None.
        target_divisions: divisions asked for, or None.
        share: share of the request that is reached.
        residual: largest force left by the last relaxation, in F(0).
        seconds: since the start.
        state: the last equilibrium, springs reset; lengths in r0.
    """

    divisions: int
    size_mm: float
    target_mm: float | None
    target_divisions: int | None
    share: float
    residual: float
    seconds: float
    state: State | None = None


def make_progress(
    scene: Scene, state: State, record: StepRecord, clock: Clock
) -> Progress:
    """Make the progress after a step.

    Args:
        scene: of the growth.
        state: after the step.
        record: of the step.
        clock: has the seconds since the start.
    """
    return Progress(
        divisions=record.division,
        size_mm=get_number(record.size_mm),
        target_mm=scene.lesion.target_mm,
        target_divisions=scene.lesion.divisions,
        share=record.share,
        residual=record.residual,
        seconds=clock.elapsed,
        state=state,
    )
