"""History of a growth: one record per step."""

from dataclasses import dataclass, field, fields
from typing import Any

from jaxgrow.growth.boundary import BoundaryCheck
from jaxgrow.growth.settling import FairingResult
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Species, State
from jaxgrow.transfer.device import get


@dataclass(frozen=True, eq=False)
class StepRecord:
    """Record of one step of a growth.

    ``pandas.DataFrame(growth.history)`` makes a table of all records.

    Attributes:
        division: number of its last division.
        size_mm: largest diameter of the lesion after it; the only field with a
            derivative.
        share: share of the request that is reached: of the size, or of the number of
            divisions.
        residual: largest force left, in F(0).
        steps: of the relaxation.
        method: last method of the relaxation.
        result: name of the `Result`: CONVERGED, or why there is no valid state.
        particles: number alive.
        tumour: number of tumour particles.
        vertices: number of the membrane's; None without a membrane, like those below.
        faces: number of the membrane's.
        colliding: whether the collision energy was part of the equilibrium.
        quality: least radius ratio of a triangle.
        operations: of the fairing, counted by name.
        border_force: largest change of the force on a held particle, in F(0).
        border_distance: of the nearest tumour particle to the boundary, in r0.
        mended: recoveries from failures, counted by name.
        seconds: by phase.
    """

    division: int
    size_mm: Scalar
    share: float
    residual: float
    steps: int
    method: str
    result: str
    particles: int
    tumour: int
    vertices: int | None = None
    faces: int | None = None
    colliding: bool | None = None
    quality: float | None = None
    operations: dict[str, int] | None = None
    border_force: float | None = None
    border_distance: float | None = None
    mended: dict[str, int] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by their names, without those that are None."""
        every = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value for name, value in every.items() if value is not None}


def make_record(
    state: State,
    settled: FairingResult,
    check: BoundaryCheck | None,
    *,
    division: int,
    size_mm: Scalar,
    share: float,
    result: str,
    mended: dict[str, int],
    seconds: dict[str, float],
) -> StepRecord:
    """Make the record of a step.

    Args:
        state: after it; the one before it, if it failed.
        settled: its equilibrium and fairing.
        check: of the patch's boundary; None if it was not checked.
        division: number of its last division.
        size_mm: of the lesion after it.
        share: of the request that is reached.
        result: name of the `Result`.
        mended: recoveries besides those in `settled`.
        seconds: by phase.
    """
    particles, membrane = state.particles, state.membrane
    stats, alive = settled.found.relaxation.stats, get(particles.alive)
    tumour = alive & (get(particles.species) == Species.TUMOUR)
    of_membrane: dict[str, Any] = {}
    if membrane is not None:
        of_membrane = {
            "vertices": int(get(membrane.vertex_alive).sum()),
            "faces": int(get(membrane.face_alive).sum()),
            "colliding": settled.found.colliding,
            "quality": settled.quality,
        }
    remeshing = settled.remeshing
    return StepRecord(
        division=division,
        size_mm=size_mm,
        share=share,
        residual=stats.residual,
        steps=stats.steps,
        method=stats.method,
        result=result,
        particles=int(alive.sum()),
        tumour=int(tumour.sum()),
        operations=None if remeshing is None else dict(remeshing.counts),
        border_force=None if check is None else check.force,
        border_distance=None if check is None else check.distance,
        mended={**settled.mended, **mended},
        seconds=seconds,
        **of_membrane,
    )
