"""What a growth returns: state, result, history, and the organ's mesh with it."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxgrow.equilibrium.transformations import check_undifferentiated
from jaxgrow.growth.events import Events
from jaxgrow.growth.ground import Ground
from jaxgrow.growth.history import StepRecord
from jaxgrow.growth.loop import Reached
from jaxgrow.growth.setup import Setup
from jaxgrow.lesions.size import lesion_vertices
from jaxgrow.organ import merge, Merged, Organ, Site
from jaxgrow.runtime.descents import Descents
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.types import Scalar
from jaxgrow.scene.scene import Scene
from jaxgrow.state import State
from jaxgrow.transfer.device import get, get_number, get_particles, get_surface


if TYPE_CHECKING:
    import trimesh


class Continuation(NamedTuple):
    """What a growth needs to go on.

    Attributes:
        setup: that it was made with.
        reached: how far it came.
        generator: state of its random generator.
    """

    setup: Setup
    reached: Reached
    generator: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Growth:
    """A grown lesion.

    Where a derivative is taken, state and size carry it. What is made on the host
    (`particles`, `merged`, `surface`, `mesh`, and so what is audited, drawn or written)
    has none, and is refused there.

    Attributes:
        scene: what was asked for.
        seed: of all random choices.
        tolerance: largest force left in every equilibrium, in F(0).
        state: at the end; lengths in r0.
        result: why it ended.
        size_mm: largest diameter of the lesion; where a derivative is taken it is a
            JAX scalar that carries it, with the two ends of the diameter held fast.
        events: the discrete choices of every step; `jaxgrow.grow` can replay them.
        history: one record a step; a table of them is
            ``pandas.DataFrame(growth.history)``.
        seconds: by phase.
        compilations: number of programs compiled.
        descents: which path they ran on.
        ground: the organ around it; None for a free cluster.
        organ_index: for each membrane vertex alive the organ's vertex it was, or -1.
        continuation: what `jaxgrow.grow` needs to go on; None for a replay, and where a
            derivative was taken.
    """

    scene: Scene
    seed: int
    tolerance: float
    state: State
    result: Result
    size_mm: Scalar
    events: Events
    history: tuple[StepRecord, ...]
    seconds: dict[str, float]
    compilations: int
    descents: Descents
    ground: Ground | None = None
    organ_index: Int[np.ndarray, " m"] = field(
        default_factory=lambda: np.zeros(0, dtype=np.int64)
    )
    continuation: Continuation | None = None

    @property
    def mended(self) -> dict[str, int]:
        """What went wrong on the way and was mended, how often.

        "overflows" of lists that were made larger, "retried_after_…" of relaxations
        that were rolled back, "fairing_rejected", "patch_enlarged",
        "daughter_redirected" where the rule would have put a polyp's new particle out
        of the tissue, and "collisions_joined" when sheets of the surface first met.
        """
        total: Counter[str] = Counter()
        for record in self.history:
            total.update(record.mended)
        return dict(total)

    @property
    def organ(self) -> Organ | None:
        """The organ before growth."""
        return None if self.ground is None else self.ground.organ

    @property
    def site(self) -> Site | None:
        """Where the lesion grew."""
        return None if self.ground is None else self.ground.site

    def particles(self) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
        """Positions in mm, in the organ's coordinates, and species of the living.

        Raises:
            ValueError: a derivative is being taken.
        """
        self._check_undifferentiated("the array of particles")
        position, species = get_particles(self.state.particles)
        frame = self.state.frame
        return get(frame.origin) + float(frame.particle_mm) * position, species

    def merged(self) -> Merged:
        """The whole organ with the grown patch in place of the original one.

        Raises:
            ValueError: the cluster grew freely, so there is no organ, or a derivative
                is being taken.
        """
        self._check_undifferentiated("the organ's mesh")
        if self.ground is None or self.state.membrane is None:
            raise ValueError(
                "this cluster grew without an organ, so it has no surface; "
                "use growth.particles(), or give the scene an organ."
            )
        surface = get_surface(self.state.membrane)
        patch = self.ground.patch
        return merge(
            self.ground.organ,
            patch,
            patch.to_mm(surface.vertices),
            surface.faces,
            self.organ_index,
        )

    def surface(
        self,
    ) -> tuple[
        Float[np.ndarray, "m 3"], Int[np.ndarray, "f 3"], UInt8[np.ndarray, " m"]
    ]:
        """Vertices (mm), faces and labels (0 healthy, 1 lesion) of the whole organ.

        Raises:
            ValueError: the cluster grew freely, so there is no organ, or a derivative
                is being taken.
        """
        merged = self.merged()
        label = np.zeros(len(merged.vertices), dtype=np.uint8)
        label[merged.placed] = lesion_vertices(self.state)
        return merged.vertices, merged.faces, label

    def mesh(self) -> "trimesh.Trimesh":
        """The whole organ with the lesion; `vertex_attributes["label"]` marks it.

        Raises:
            ValueError: the cluster grew freely, so there is no organ, or a derivative
                is being taken.
        """
        import trimesh

        vertices, faces, label = self.surface()
        return trimesh.Trimesh(
            vertices, faces, process=False, vertex_attributes={"label": label}
        )

    def __repr__(self) -> str:
        """What grew, how it ended, and how large it is, in one line."""
        size = get_number(self.size_mm)
        divisions = sum(len(event.divisions) for event in self.events)
        return (
            f"Growth({self.scene.lesion.kind} of {size:.4g} mm after {divisions} "
            f"divisions, seed {self.seed}: {self.result.name})"
        )

    def _check_undifferentiated(self, what: str) -> None:
        check_undifferentiated(
            self.state,
            what,
            "differentiate jaxgrow.shape_metrics(growth.state), growth.size_mm or "
            "growth.state itself",
        )
