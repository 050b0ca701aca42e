"""What is written about one iteration, and what a progress bar is told."""

from typing import Any

from jaxgrow.growth.boundary import Feeling
from jaxgrow.growth.result import Progress
from jaxgrow.growth.settling import Settled
from jaxgrow.runtime.timer import Clock
from jaxgrow.runtime.types import Scalar
from jaxgrow.scene.scene import Scene
from jaxgrow.state import Species, State
from jaxgrow.transfer.device import get, get_number


def make_record(
    division: int, size_mm: Scalar, state: State, settled: Settled, clock: Clock
) -> dict[str, Any]:
    """The record of an iteration, without what the border of the patch felt.

    Args:
        division: number of its last division.
        size_mm: of the lesion after it.
        state: after it; the one before it, if it failed.
        settled: how it ended.
        clock: with the seconds since the last record.
    """
    particles, membrane = state.particles, state.membrane
    stats = settled.adapted.relaxation.stats
    alive = get(particles.alive)
    record: dict[str, Any] = {
        "division": division,
        "size_mm": size_mm,
        "residual": stats.residual,
        "steps": stats.steps,
        "method": stats.method,
        "result": settled.result.name,
        "particles": int(alive.sum()),
        "tumour": int((alive & (get(particles.species) == Species.TUMOUR)).sum()),
    }
    if membrane is not None:
        record["vertices"] = int(get(membrane.vertex_alive).sum())
        record["faces"] = int(get(membrane.face_alive).sum())
        record["colliding"] = settled.adapted.colliding
        record["quality"] = settled.quality
    if settled.remeshing is not None:
        record["operations"] = dict(settled.remeshing.counts)
    record["mended"] = settled.mended
    record["seconds"] = clock.lap()
    return record


def add_feeling(record: dict[str, Any], felt: Feeling | None) -> None:
    """What the border of the patch felt, if there is one."""
    if felt is not None:
        record["border_force"] = felt.force
        record["border_distance"] = felt.distance


def make_progress(scene: Scene, record: dict[str, Any], clock: Clock) -> Progress:
    """Where a running growth stands."""
    return Progress(
        divisions=record["division"],
        size_mm=get_number(record["size_mm"]),
        target_mm=scene.lesion.target_mm,
        target_divisions=scene.lesion.divisions,
        residual=record["residual"],
        seconds=clock.elapsed,
    )
