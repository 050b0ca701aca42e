"""Initial state of a growth, made from a scene."""

from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxgrow.equilibrium.relax import relax, Relaxation
from jaxgrow.growth.boundary import boundary_reaction, BoundaryReaction
from jaxgrow.growth.ground import Ground, Layout
from jaxgrow.growth.setup import GrowthState, quality_bound, Setup
from jaxgrow.lesions.division import SPARE
from jaxgrow.organ import (
    cut_patch,
    fill_tissue,
    line_patch,
    load_organ,
    locate_site,
    make_organ,
    Organ,
    ORGANS,
    Site,
    walls_around,
)
from jaxgrow.organ.tissue import HOLD
from jaxgrow.scene.scene import Scene
from jaxgrow.state import FormerSurface, Frame, Species, State
from jaxgrow.transfer.device import (
    as_reference,
    get_number,
    Positions,
    put,
    put_membrane,
    put_particles,
    put_positions,
)


@dataclass(frozen=True, eq=False)
class InitialState:
    """Initial state of a growth.

    Attributes:
        state: relaxed, springs at rest.
        layout: of patch and tissue; None for a free cluster.
        outcome: of the relaxation of the tissue; None for a free cluster.
        border: boundary of the patch; None for a free cluster.
    """

    state: State
    layout: Layout | None
    outcome: Relaxation | None
    border: BoundaryReaction | None

    @property
    def ground(self) -> Ground | None:
        """Surroundings of the lesion; None for a free cluster."""
        return None if self.layout is None else self.layout.ground

    def growth_state(self) -> GrowthState:
        """Return the state before the first division."""
        index = np.zeros(0, int) if self.layout is None else self.layout.organ_index
        return GrowthState(
            self.state,
            index,
            None if self.outcome is None else self.outcome.lists,
            self.ground,
            border=self.border,
            least_quality=quality_bound(self.state),
        )


def find_organ(scene: Scene) -> Organ | None:
    """Make or read the scene's organ."""
    if scene.organ is None or isinstance(scene.organ, Organ):
        return scene.organ
    if isinstance(scene.organ, str) and scene.organ in ORGANS:
        return make_organ(scene.organ)
    path = Path(scene.organ)
    return load_organ(path, unit_mm=scene.unit_mm, tissue=scene.tissue)


def make_initial_state(setup: Setup, rng: np.random.Generator) -> InitialState:
    """Make the initial state: cut the patch, fill tissue in and relax it.

    The tissue holds the seed of the lesion.

    Args:
        setup: of the growth.
        rng: draws the tissue.

    Raises:
        OrganError: the organ or the site cannot be used.
        SceneError: the tissue alone lifts the surface.
    """
    scene = setup.scene
    organ = find_organ(scene)
    if organ is None:
        return make_free_cluster(scene)
    site = locate_site(organ, scene.lesion.site)
    scene.lesion.check_site(organ, site)
    gap = get_number(setup.parameters.contact_range)
    layout = build_layout(scene, organ, site, gap, rng)
    start = relax_layout(setup, layout)
    scene.lesion.check_start(start.state, scene.surroundings.density)
    return start


def make_free_cluster(scene: Scene) -> InitialState:
    """Make the initial state of a free cluster: one particle."""
    divisions = scene.lesion.divisions
    spare = SPARE if divisions is None else divisions
    particles = put_particles(
        np.zeros((1, 3)), np.array([int(Species.TUMOUR)]), np.array([False]), 1 + spare
    )
    frame = Frame(
        jnp.zeros(3), jnp.array([0.0, 0.0, 1.0]), jnp.asarray(scene.r0_mm), None
    )
    state = State(particles, None, frame)
    return InitialState(state, None, None, None)


def _rounded(count: int) -> int:
    """Return a rounded capacity, so that other seeds use the same programs."""
    return -(-count // SPARE) * SPARE


def meeting_distance(scene: Scene, radius: float) -> float:
    """Return the distance from the site, in r0, that a lesion cannot reach."""
    target = scene.lesion.target_mm
    if target is None:
        return float("inf")
    return radius + target / scene.r0_mm + 5.0


def build_layout(
    scene: Scene,
    organ: Organ,
    site: Site,
    contact_range: float,
    rng: np.random.Generator,
) -> Layout:
    """Cut the patch out of the organ, and fill the tissue under it."""
    around, r0_mm = scene.surroundings, scene.r0_mm
    radius, thickness = scene.lesion.extent()
    radius, thickness = around.radius or radius, around.thickness or thickness
    patch = cut_patch(organ, site, radius * r0_mm, r0_mm=r0_mm)
    surface, organ_index = line_patch(
        organ, patch, max_area=around.max_area, min_area=around.min_area
    )
    tissue = fill_tissue(
        organ,
        patch,
        spacing=1.0,
        density=around.density,
        thickness=thickness,
        gap=contact_range,
        hold=HOLD,
        rng=rng,
    )
    surface, species = scene.lesion.seed(surface, tissue, site)
    walls = walls_around(organ, patch, meeting_distance(scene, radius))
    ground = Ground(organ, site, patch, walls, radius, thickness)
    return Layout(ground, surface, organ_index, tissue, species)


def relax_layout(
    setup: Setup, layout: Layout, start: Positions | None = None
) -> InitialState:
    """Relax patch and tissue.

    Args:
        setup: of the growth.
        layout: of both.
        start: positions to begin with, of a growth that is replayed; None for those of
            the layout.
    """
    scene = setup.scene
    tissue = layout.tissue
    capacity = _rounded(len(layout.species) + (scene.lesion.divisions or SPARE))
    particles = put_particles(tissue.points, layout.species, tissue.held, capacity)
    membrane = put_membrane(layout.surface)
    if start is not None:
        particles, membrane = put_positions(particles, membrane, start)
    outcome = relax(
        particles,
        membrane,
        parameters=setup.parameters,
        tolerance=setup.tolerance,
        terms=setup.terms,
    )
    particles, membrane = outcome.state
    assert particles is not None
    assert membrane is not None
    patch, site = layout.ground.patch, layout.ground.site
    former = FormerSurface(put(patch.vertices), put(patch.faces))
    frame = Frame(
        put(site.point),
        put(site.normal),
        jnp.asarray(scene.r0_mm),
        former,
    )
    state = State(particles, as_reference(membrane), frame)
    return InitialState(state, layout, outcome, boundary_reaction(outcome))
