"""From a scene to the state that growth starts from."""

from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from jaxgrow.equilibrium.relax import relax, Relaxation
from jaxgrow.mesh.fairing import fair, refine
from jaxgrow.mesh.surface import Surface
from jaxgrow.organ import (
    cut_patch,
    fill_tissue,
    load_organ,
    locate_site,
    Organ,
    Patch,
    room,
    Site,
    uterus,
)
from jaxgrow.parameters import Parameters
from jaxgrow.scene import Myoma, Scene, SceneError
from jaxgrow.state import FormerSurface, Frame, Species, State
from jaxgrow.transfer import put_membrane, put_particles, reset_springs


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
    """

    organ: Organ
    site: Site
    patch: Patch


@dataclass(frozen=True, eq=False)
class Planted:
    """The start of a growth.

    Attributes:
        state: relaxed, springs at rest.
        ground: None for a free cluster.
        organ_index: for each membrane vertex the organ's vertex that it is, or -1.
        outcome: of the relaxation of the tissue; None for a free cluster.
    """

    state: State
    ground: Ground | None
    organ_index: Int[np.ndarray, " m"]
    outcome: Relaxation | None


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
) -> Planted:
    """The start of a growth: patch cut out, tissue filled in and relaxed, first tumour.

    Args:
        scene: what to grow.
        parameters: of the mechanics.
        tolerance: of the relaxation of the tissue, in F(0).
        rng: draws the tissue.

    Raises:
        OrganError: the organ or the site cannot be used.
        SceneError: the lesion does not fit.
    """
    organ = find_organ(scene)
    if organ is None:
        return _plant_free(scene)
    site = locate_site(organ, scene.lesion.site)
    check_room(scene, organ, site)
    return _plant_in(scene, organ, site, parameters, tolerance, rng)


def check_room(scene: Scene, organ: Organ, site: Site) -> None:
    """Refuse a polyp longer than the lumen is deep at its site."""
    size = scene.lesion.target_mm
    if size is None or isinstance(scene.lesion, Myoma):
        return
    depth = room(organ, site)
    if size > depth:
        raise SceneError(
            f"a polyp of {size:g} mm cannot fit at {site.name}: the lumen is "
            f"{depth:.1f} mm deep there; ask for less than that, or for another site."
        )


def _plant_free(scene: Scene) -> Planted:
    divisions = scene.lesion.divisions
    spare = SPARE if divisions is None else divisions
    particles = put_particles(
        np.zeros((1, 3)), np.array([int(Species.TUMOUR)]), np.array([False]), 1 + spare
    )
    frame = Frame(
        jnp.zeros(3), jnp.array([0.0, 0.0, 1.0]), jnp.asarray(scene.r0_mm), None
    )
    return Planted(State(particles, None, frame), None, np.zeros(0, int), None)


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
        thickness = depth_of(lesion, scene.r0_mm) + across / 2 + 1.5
    else:
        radius, thickness = max(6.5, 0.5 * across), 3.0
    return around.radius or radius, around.thickness or thickness


def depth_of(lesion: Myoma, r0_mm: float) -> float:
    """Depth of the first particle of a myoma under the surface, in r0."""
    if lesion.depth_mm is not None:
        return lesion.depth_mm / r0_mm
    target = lesion.target_mm
    return 2.0 if target is None else 0.25 * target / r0_mm


def _plant_in(
    scene: Scene,
    organ: Organ,
    site: Site,
    parameters: Parameters,
    tolerance: float,
    rng: np.random.Generator,
) -> Planted:
    around, r0_mm = scene.surroundings, scene.r0_mm
    radius, thickness = _extent(scene)
    patch = cut_patch(organ, site, radius * r0_mm, r0_mm=r0_mm)
    surface = Surface(patch.vertices, patch.faces, patch.rim)
    surface, refined = refine(surface, around.max_area)
    surface, faired = fair(
        surface, np.zeros((0, 3)), max_area=around.max_area, min_area=around.min_area
    )
    origin = refined.then(faired).origin()
    organ_index = np.where(origin >= 0, patch.organ_index[origin], -1)
    tissue = fill_tissue(
        organ,
        patch,
        spacing=1.0,
        density=around.density,
        thickness=thickness,
        gap=float(parameters.contact_range),
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
    capacity = len(species) + (scene.lesion.divisions or SPARE)
    particles = put_particles(tissue.points, species, tissue.held, capacity)
    outcome = relax(
        particles, put_membrane(surface), parameters=parameters, tolerance=tolerance
    )
    particles, membrane = outcome.state
    assert particles is not None
    assert membrane is not None
    membrane = reset_springs(membrane)
    former = FormerSurface(jnp.asarray(patch.vertices), jnp.asarray(patch.faces))
    frame = Frame(
        jnp.asarray(site.point), jnp.asarray(site.normal), jnp.asarray(r0_mm), former
    )
    state = State(particles, membrane, frame)
    return Planted(state, Ground(organ, site, patch), organ_index, outcome)
