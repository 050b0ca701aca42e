"""Outcome of a growth: state, result, history, and the organ's mesh."""

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
    """State from which a growth can be continued.

    Attributes:
        setup: of the growth.
        reached: its last state and its history.
        generator: state of its random generator.
    """

    setup: Setup
    reached: Reached
    generator: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Growth:
    """Grown lesion: state, result and history.

    Under differentiation, state and size carry the derivative. Everything that is
    computed on the host (`particles`, `merged`, `surface`, `mesh`, and so the audit,
    pictures and files) has none, and raises then.

    Attributes:
        scene: organ, lesion and parameters.
        seed: of all random choices.
        tolerance: largest force left in every equilibrium, in F(0).
        state: at the end; lengths in r0.
        result: why it ended.
        size_mm: largest diameter of the lesion; under differentiation it is a JAX
            scalar that carries the derivative, for the fixed pair of its end points.
        events: the discrete choices of every step; `jaxgrow.grow` can replay them.
        history: one record per step; a table of them is
            ``pandas.DataFrame(growth.history)``.
        seconds: by phase.
        compilations: number of programs compiled.
        descents: number of descents on each path.
        ground: surroundings of the lesion; None for a free cluster.
        organ_index: for each membrane vertex alive the same vertex of the organ, or -1.
        continuation: state from which `jaxgrow.grow` can continue; None for a replay,
            and under differentiation.
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
        """Number of recoveries from failures, by name.

        "overflows" of lists that were enlarged, "retried_after_…" for relaxations that
        were rolled back, "fairing_rejected", "patch_enlarged", "daughter_redirected" if
        the paper's rule would have placed a polyp's new particle outside the tissue,
        and "collisions_joined" when sheets of the surface first met.
        """
        total: Counter[str] = Counter()
        for record in self.history:
            total.update(record.mended)
        return dict(total)

    @property
    def organ(self) -> Organ | None:
        """Organ before growth; None for a free cluster."""
        return None if self.ground is None else self.ground.organ

    @property
    def site(self) -> Site | None:
        """Site of the lesion; None for a free cluster."""
        return None if self.ground is None else self.ground.site

    def particles(self) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
        """Return positions (mm) and species of the particles alive.

        The positions are in the organ's coordinates.

        Raises:
            ValueError: a derivative is being taken.
        """
        self._check_undifferentiated("the array of particles")
        position, species = get_particles(self.state.particles)
        frame = self.state.frame
        return get(frame.origin) + float(frame.particle_mm) * position, species

    def merged(self) -> Merged:
        """Merge the grown patch into the whole organ, in place of the former one.

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
        """Return vertices (mm), faces and labels of the whole organ.

        Label 0 is healthy, 1 is the lesion.

        Raises:
            ValueError: the cluster grew freely, so there is no organ, or a derivative
                is being taken.
        """
        merged = self.merged()
        label = np.zeros(len(merged.vertices), dtype=np.uint8)
        label[merged.placed] = lesion_vertices(self.state)
        return merged.vertices, merged.faces, label

    def mesh(self) -> "trimesh.Trimesh":
        """Make a trimesh of the whole organ with the lesion.

        `vertex_attributes["label"]` is 1 on the lesion, else 0.

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
        """Describe lesion, size and result in one line."""
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
