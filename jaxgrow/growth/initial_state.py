"""From a scene to the state that growth starts from."""

from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.problem import ExtraTerms
from jaxgrow.equilibrium.relax import relax, Relaxation
from jaxgrow.growth.boundary import Border, border_of
from jaxgrow.growth.lesion import height_above, RAISED
from jaxgrow.mesh.collision_mesh import Walls
from jaxgrow.mesh.surface import Surface
from jaxgrow.organ import (
    cut_patch,
    fill_tissue,
    line_patch,
    load_organ,
    locate_site,
    Organ,
    Patch,
    Site,
    Tissue,
    uterus,
    walls_around,
)
from jaxgrow.scene.scene import Myoma, Polyp, Scene, SceneError
from jaxgrow.state import FormerSurface, Frame, Species, State
from jaxgrow.transfer.device import (
    get,
    get_number,
    get_surface,
    Positions,
    put,
    put_membrane,
    put_particles,
    put_positions,
    reset_springs,
)


HOLD = 1.0
"""Tissue within this distance (r0) of the sides and bottom of its layer is held."""

SPARE = 128
"""Slots for new particles to begin with."""


@dataclass(frozen=True, eq=False)
class Ground:
    """What surrounds a lesion on the host; None throughout for a free cluster.

    Attributes:
        organ: the whole organ.
        site: where the lesion grows.
        patch: the piece of surface that is simulated.
        walls: the rest of the organ's surface, as far as the lesion may meet it.
        radius: of the patch along the surface, in r0.
        thickness: of the layer of tissue under it, in r0.
    """

    organ: Organ
    site: Site
    patch: Patch
    walls: Walls
    radius: float
    thickness: float


@dataclass(frozen=True, eq=False)
class Layout:
    """Patch and tissue before they are relaxed, on the host.

    Attributes:
        ground: what is around.
        surface: of the patch, with the source of a polyp.
        organ_index: of each of its vertices the organ's vertex that it is, or -1.
        tissue: the particles.
        species: of each of them.
    """

    ground: Ground
    surface: Surface
    organ_index: Int[np.ndarray, " m"]
    tissue: Tissue
    species: Int[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Planted:
    """The start of a growth.

    Attributes:
        state: relaxed, springs at rest.
        layout: None for a free cluster.
        outcome: of the relaxation of the tissue; None for a free cluster.
        border: what is held around the patch; None for a free cluster.
    """

    state: State
    layout: Layout | None
    outcome: Relaxation | None
    border: Border | None

    @property
    def ground(self) -> Ground | None:
        """What is around; None for a free cluster."""
        return None if self.layout is None else self.layout.ground

    @property
    def organ_index(self) -> Int[np.ndarray, " m"]:
        """Of each vertex the organ's vertex that it is, or -1."""
        return np.zeros(0, int) if self.layout is None else self.layout.organ_index


def find_organ(scene: Scene) -> Organ | None:
    """The scene's organ, made or read."""
    if scene.organ is None or isinstance(scene.organ, Organ):
        return scene.organ
    if scene.organ == "uterus":
        return uterus()
    path = Path(scene.organ)
    return load_organ(path, unit_mm=scene.unit_mm, tissue=scene.tissue)


def plant(
    scene: Scene,
    parameters: Parameters,
    *,
    tolerance: float,
    rng: np.random.Generator,
    terms: ExtraTerms = (),
) -> Planted:
    """The start of a growth: patch cut out, tissue filled in and relaxed, first tumour.

    Args:
        scene: what to grow.
        parameters: of the mechanics.
        tolerance: of the relaxation of the tissue, in F(0).
        rng: draws the tissue.
        terms: of the energy, besides those of jaxgrow.

    Raises:
        OrganError: the organ or the site cannot be used.
        SceneError: the tissue lifts the surface by itself.
    """
    organ = find_organ(scene)
    if organ is None:
        return plant_free(scene)
    site = locate_site(organ, scene.lesion.site)
    layout = lay_out(scene, organ, site, get_number(parameters.contact_range), rng)
    planted = plant_layout(scene, layout, parameters, tolerance, terms=terms)
    if isinstance(scene.lesion, Polyp) and scene.lesion.target_mm is not None:
        check_lift(planted.state, scene.surroundings.density)
    return planted


def plant_free(scene: Scene) -> Planted:
    """The start of a free cluster: one particle."""
    divisions = scene.lesion.divisions
    spare = SPARE if divisions is None else divisions
    particles = put_particles(
        np.zeros((1, 3)), np.array([int(Species.TUMOUR)]), np.array([False]), 1 + spare
    )
    frame = Frame(
        jnp.zeros(3), jnp.array([0.0, 0.0, 1.0]), jnp.asarray(scene.r0_mm), None
    )
    state = State(particles, None, frame)
    return Planted(state, None, None, None)


def _extent(scene: Scene) -> tuple[float, float]:
    """Radius of the patch and thickness of the tissue, in r0.

    A polyp rises out of a patch that is little wider than its base. A myoma pushes
    tissue aside: its radius and two particles more on every side.
    """
    lesion, around = scene.lesion, scene.surroundings
    target = lesion.target_mm
    if target is None:
        across = 10.0 if lesion.divisions is None else 2 * lesion.divisions ** (1 / 3)
    else:
        across = target / scene.r0_mm
    if isinstance(lesion, Myoma):
        radius = across / 2 + 2.5
        thickness = depth_of(lesion, scene.r0_mm) + across / 2 + 2.0
    else:
        radius, thickness = max(6.5, 0.5 * across), 3.0
    return around.radius or radius, around.thickness or thickness


def _rounded(count: int) -> int:
    """A capacity that other seeds have too, so that they use the same programs."""
    return -(-count // SPARE) * SPARE


def check_lift(state: State, density: float) -> None:
    """Refuse tissue that lifts the surface as a polyp would, before anything has grown.

    The size of a myoma is that of its body, so it may do so there.

    Raises:
        SceneError: a lesion's size would be that of the lift.
    """
    membrane, former = state.membrane, state.frame.former
    assert membrane is not None
    assert former is not None
    surface = get_surface(membrane)
    height = height_above(surface.vertices, get(former.vertices), get(former.faces))
    if height.max() > RAISED:
        raise SceneError(
            f"tissue of density {density:g} per r0³ lifts the surface by "
            f"{height.max():.2g} r0 before anything grows, as much as counts as a "
            "lesion; ask for less density or softer springs (the defaults are 1.7 and "
            "0.04)."
        )


def meeting_distance(scene: Scene, radius: float) -> float:
    """Distance from the site, in r0, beyond which a lesion meets nothing."""
    target = scene.lesion.target_mm
    if target is None:
        return float("inf")
    return radius + target / scene.r0_mm + 5.0


def depth_of(lesion: Myoma, r0_mm: float) -> float:
    """Depth of the first particle of a myoma under the surface, in r0."""
    if lesion.depth_mm is not None:
        return lesion.depth_mm / r0_mm
    target = lesion.target_mm
    return 2.0 if target is None else 0.25 * target / r0_mm


def lay_out(
    scene: Scene,
    organ: Organ,
    site: Site,
    contact_range: float,
    rng: np.random.Generator,
) -> Layout:
    """Cut the patch out of the organ, and fill in the tissue under it."""
    around, r0_mm = scene.surroundings, scene.r0_mm
    radius, thickness = _extent(scene)
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
    species = np.full(len(tissue.points), int(Species.TISSUE))
    if isinstance(scene.lesion, Myoma):
        seed = -depth_of(scene.lesion, r0_mm) * site.normal
        free = np.flatnonzero(~tissue.held)
        distance = np.linalg.norm(tissue.points[free] - seed, axis=1)
        species[free[distance.argmin()]] = int(Species.TUMOUR)
    else:
        inner = np.flatnonzero(~surface.fixed)
        source = inner[np.linalg.norm(surface.vertices[inner], axis=1).argmin()]
        surface = Surface(surface.vertices, surface.faces, surface.fixed, int(source))
    walls = walls_around(organ, patch, meeting_distance(scene, radius))
    ground = Ground(organ, site, patch, walls, radius, thickness)
    return Layout(ground, surface, organ_index, tissue, species)


def plant_layout(
    scene: Scene,
    layout: Layout,
    parameters: Parameters,
    tolerance: float,
    start: Positions | None = None,
    terms: ExtraTerms = (),
) -> Planted:
    """Relax patch and tissue.

    Args:
        scene: what grows.
        layout: of both.
        parameters: of the mechanics.
        tolerance: of the equilibrium, in F(0).
        start: where to begin, of a growth that is replayed; None for the layout.
        terms: of the energy, besides those of jaxgrow.
    """
    tissue = layout.tissue
    capacity = _rounded(len(layout.species) + (scene.lesion.divisions or SPARE))
    particles = put_particles(tissue.points, layout.species, tissue.held, capacity)
    membrane = put_membrane(layout.surface)
    if start is not None:
        particles, membrane = put_positions(particles, membrane, start)
    outcome = relax(
        particles,
        membrane,
        parameters=parameters,
        tolerance=tolerance,
        terms=terms,
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
    state = State(particles, reset_springs(membrane), frame)
    return Planted(state, layout, outcome, border_of(outcome))
