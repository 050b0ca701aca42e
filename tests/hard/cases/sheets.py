"""Hard cases of particles under a sheet: a patch of membrane with its rim pinned.

Normals point up, the tissue is below. Sheets have their room for 256 vertices and the
particles for 64, so that all cases share their compiled programs.
"""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

import jaxgrow as jg
from jaxgrow.growth.collision_broad_phase import CollisionFinder
from jaxgrow.mesh.fairing import fair
from jaxgrow.mesh.intersection import intersecting_pairs
from jaxgrow.mesh.quality import radius_ratio
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.topology import build_topology
from jaxgrow.transfer.device import (
    get_particles,
    get_surface,
    put_membrane,
    put_particles,
)

from .case import Case, Found
from .clusters import SLOTS
from .examine import crossed, of_relaxation, spacing


Height: TypeAlias = Callable[[np.ndarray, np.ndarray], np.ndarray]
Points: TypeAlias = Float[np.ndarray, "n 3"]


def grid(
    side: int = 7,
    spacing: float = 1.0,
    height: Height | None = None,
    stretch: float = 1,
) -> Surface:
    """A square grid around the origin; its middle vertex is the source."""
    line = spacing * (np.arange(side) - (side - 1) / 2)
    x, y = np.meshgrid(line, stretch * line)
    z = np.zeros_like(x) if height is None else height(x, y)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    index = np.arange(side * side).reshape(side, side)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return pinned_at_rim(vertices, faces, int(index[side // 2, side // 2]))


def pinned_at_rim(
    vertices: Points, faces: Int[np.ndarray, "f 3"], source: int = -1
) -> Surface:
    """A surface whose rim is held."""
    rim = build_topology(faces, len(vertices)).rim_vertices
    return Surface(vertices, faces, rim, source)


def below(count: int, low: float, high: float, half: float = 2.2) -> Points:
    """Particles at random between two heights."""
    rng = np.random.default_rng(2)
    return rng.uniform([-half, -half, low], [half, half, high], (count, 3))


def bed(count: int = 50) -> Points:
    return below(count, -2.0, -0.5)


def relaxed(
    surface: Surface,
    position: Points,
    held_below: float = -1.6,
    tumour: int = 0,
    crossed_at_the_start: int = 0,
    collide: bool = False,
    **call: Any,
) -> Found:
    """Relax a sheet with particles.

    Args:
        surface: the sheet.
        position: of the particles.
        held_below: height below which they are held.
        tumour: how many of them, from the first one, are tumour.
        crossed_at_the_start: how many may lie on the wrong side.
        collide: whether the sheet repels itself.
        call: further arguments of `jaxgrow.relax`.
    """
    species = (np.arange(len(position)) < tumour).astype(np.int64)
    held = position[:, 2] < held_below
    vertices, faces = surface.vertices, surface.faces
    assert crossed(position, vertices, faces) == crossed_at_the_start
    meeting = sum(map(len, intersecting_pairs(vertices, faces)))
    particles = put_particles(position, species, held, max(SLOTS, len(position)))
    membrane = put_membrane(surface)
    if collide:
        names = np.full(len(vertices), -1)
        parameters = call.get("parameters", jg.Parameters())
        call["collide"] = CollisionFinder.of(membrane, names, None, parameters)
    outcome = jg.relax(particles, membrane, **call)
    assert outcome.state[0] is not None
    after, _ = get_particles(outcome.state[0])
    start = radius_ratio(surface.vertices[surface.faces]).min()
    found = of_relaxation(
        outcome, spacing=round(spacing(after), 3), quality_at_the_start=float(start)
    )
    found.defects["intersections at the start"] = meeting
    return found


# starts


def heap_under_the_sheet() -> Found:
    """40 particles at exactly one point, and tissue below them."""
    heap = np.tile([0.1, 0.2, -0.05], (40, 1))
    return relaxed(grid(), np.concatenate([heap, below(20, -2.0, -0.8)]))


def nearly_at_one_point() -> Found:
    rng = np.random.default_rng(0)
    heap = 1e-6 * rng.normal(size=(40, 3)) + np.array([0.1, 0.2, -0.05])
    return relaxed(grid(), np.concatenate([heap, below(20, -2.0, -0.8)]))


def daughter(depth: float, at: tuple[float, float] = (0.0, 0.0)) -> Found:
    """One particle so far under the sheet, tissue at rest below it."""
    return relaxed(grid(), np.concatenate([[[*at, -depth]], bed(49)]), tumour=1)


PROFILE = np.array(
    [(-3, 0), (-2, 0), (-1.2, 0), (-0.5, 0.3), (-0.4, 1.0), (-0.5, 1.7), (0, 2.2)]
)
"""Half of a fold that is wider at its top than at its neck, in r0."""


def fold(sign: float = 1.0) -> Surface:
    """A ridge, or a groove, whose walls lean towards each other at the neck."""
    profile = np.concatenate([PROFILE, PROFILE[-2::-1] * [-1, 1]])
    along = np.linspace(-3, 3, 13)
    vertices = np.array([(x, y, sign * z) for y in along for x, z in profile])
    return pinned_at_rim(vertices, grid(13).faces)


def in_the_ridge() -> Points:
    """Tissue in the fold itself, one particle wide, and under it."""
    row = np.column_stack([np.zeros(6), np.linspace(-2.2, 2.2, 6), np.full(6, 1.4)])
    return np.concatenate([row, below(40, -1.6, -0.5)])


def beside_the_groove() -> Points:
    """Tissue on both sides of a groove, pressing its walls together."""
    rng = np.random.default_rng(4)
    left = rng.uniform([-2.2, -2.2, -2.0], [-0.8, 2.2, -0.3], (22, 3))
    right = rng.uniform([0.8, -2.2, -2.0], [2.2, 2.2, -0.3], (22, 3))
    return np.concatenate([left, right, below(15, -3.2, -2.5)])


def division_in_a_fold() -> Found:
    """A daughter at the narrow top of a ridge."""
    daughter = [[0.03, 0.05, 2.1]]
    position = np.concatenate([daughter, in_the_ridge()])
    return relaxed(fold(), position, -1.2, tumour=1, collide=True)


def division_beside_a_groove() -> Found:
    """A daughter by the wall of a groove that is 0.8 r0 wide."""
    daughter = [[-0.55, 0.05, -1.0]]
    position = np.concatenate([daughter, beside_the_groove()])
    return relaxed(fold(-1.0), position, -2.8, tumour=1, collide=True)


def slivers(aspect: float) -> Found:
    """A grid with two rows of vertices pushed together to triangles of this aspect."""
    surface = grid(7)
    vertices = surface.vertices.copy()
    rows = np.abs(vertices[:, 1] - 1.0) < 1e-9
    vertices[rows, 1] = 1 / aspect
    return relaxed(Surface(vertices, surface.faces, surface.fixed, -1), bed())


def fair_slivers(aspect: float) -> Found:
    """Fairing of the same grid, then relaxation of what it leaves."""
    surface = grid(7, 0.9)
    vertices = surface.vertices.copy()
    rows = np.abs(vertices[:, 1] - 0.9) < 1e-9
    vertices[rows, 1] = 1 / aspect
    surface = Surface(vertices, surface.faces, surface.fixed, -1)
    position = bed()
    fairer, _ = fair(surface, position)
    found = relaxed(fairer, position)
    found.figures["quality_at_the_start"] = float(
        radius_ratio(vertices[surface.faces]).min()
    )
    return found


def roof(degrees: float, sign: float) -> Surface:
    """Two planes that meet at an angle along y, its ridge up (+1) or down (-1)."""
    half = np.deg2rad(degrees) / 2
    width = 2.0 * np.sin(half) / 3
    along = np.linspace(-3, 3, 7)
    steps = np.arange(-3, 4)
    x, y = np.meshgrid(width * steps, along)
    z = sign * (2.0 * np.cos(half)) * (1 - np.abs(steps) / 3) * np.ones_like(x)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    return pinned_at_rim(vertices, grid(7).faces)


def wedge(degrees: float) -> Found:
    """Tissue inside of a sharp ridge, much narrower than a particle."""
    surface = roof(degrees, 1.0)
    inside = np.column_stack([np.zeros(9), np.linspace(-2, 2, 9), np.full(9, 1.0)])
    return relaxed(surface, inside, held_below=-1.0, collide=True)


def crease(degrees: float) -> Found:
    """Tissue around a sharp valley."""
    surface = roof(degrees, -1.0)
    return relaxed(surface, below(50, -3.4, -2.2, 1.5), held_below=-3.1, collide=True)


def twelve_triangles() -> Found:
    """The smallest patch: a hexagon of six, each halved at its rim."""
    angle = np.pi * np.arange(12) / 6
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(12)])
    vertices = np.concatenate([[[0.0, 0.0, 0.0]], ring])
    after = np.arange(12) % 12 + 1
    faces = np.column_stack([np.zeros(12, int), after, np.roll(after, -1)])
    surface = pinned_at_rim(vertices, faces, 0)
    position = np.concatenate([[[0.0, 0.0, -0.1]], below(12, -2.0, -0.6, 0.5)])
    return relaxed(surface, position, tumour=1)


def crowd_under_a_tight_sheet() -> Found:
    """Far more tissue than fits under a sheet that is held by stiff springs."""
    return relaxed(
        grid(),
        below(64, -0.8, -0.1, 1.0),
        held_below=-2.0,
        parameters=jg.Parameters(spring_stiffness=40.0),
    )


def on_the_sheet() -> Found:
    """A particle at distance 0: no side is its own, so it is not counted as crossed."""
    position = np.concatenate([[[0.2, 0.1, 0.0]], bed(49)])
    found = relaxed(grid(), position, crossed_at_the_start=1)
    return dataclasses.replace(found, penetrations=found.penetrations - 1)


def in_float32() -> Found:
    with jax.enable_x64(False):
        return relaxed(grid(), bed(), tolerance=1e-3)


def far_from_the_origin() -> Found:
    """A sheet and its particles 10⁶ r0 from the origin, where a digit is 10⁻¹⁰ r0."""
    surface, shift = grid(), np.array([1e6, -1e6, 1e6])
    moved = Surface(surface.vertices + shift, surface.faces, surface.fixed, -1)
    position = bed()
    held = position[:, 2] < -1.6
    species = np.zeros(len(position), np.int64)
    particles = put_particles(position + shift, species, held, SLOTS)
    return of_relaxation(jg.relax(particles, put_membrane(moved), tolerance=1e-6))


def under_a_load(force: float) -> Found:
    """One vertex of a sheet without particles is pulled this hard."""
    load = jnp.zeros((256, 3)).at[24, 2].set(force)
    return of_relaxation(jg.relax(None, put_membrane(grid()), load=load))


def soft(**parameters: float) -> Callable[[], Found]:
    """The common start with other parameters."""
    position = np.concatenate([[[0.0, 0.0, -0.1]], bed(49)])
    return lambda: relaxed(
        grid(), position, tumour=1, parameters=jg.Parameters(**parameters)
    )


def relaxed_and_faired() -> Found:
    """Relax and fair the ridge in turns, as growth does."""
    surface, position = fold(), in_the_ridge()
    held = position[:, 2] < -1.2
    species = np.zeros(len(position), np.int64)
    # nothing lists collisions here, and bending would draw the folds through each other
    springs = jg.Parameters(bending_stiffness=0.0)
    outcome = jg.relax(
        put_particles(position, species, held, SLOTS),
        put_membrane(surface),
        parameters=springs,
    )
    steps = outcome.stats.steps
    for _ in range(2):
        particles, membrane = outcome.state
        assert particles is not None
        assert membrane is not None
        surface, _ = fair(get_surface(membrane), get_particles(particles)[0])
        outcome = jg.relax(particles, put_membrane(surface), parameters=springs)
        steps += outcome.stats.steps
    return of_relaxation(outcome, steps_in_all=steps)


def cases() -> Iterator[Case]:
    """Particles under a sheet."""
    ok = ("CONVERGED",)
    yield Case(
        "40-at-one-point-under-a-sheet",
        "40 particles at exactly one point 0.05 r0 under the membrane",
        heap_under_the_sheet,
        ok,
    )
    yield Case(
        "40-within-1e-6-under-a-sheet",
        "40 particles within 1e-6 r0, 0.05 r0 under the membrane",
        nearly_at_one_point,
        ok,
    )
    for depth in (1e-6, 1e-9, 1e-12):
        yield Case(
            f"daughter-{depth:g}-under-a-vertex",
            f"a particle {depth:g} r0 under a vertex of the membrane",
            lambda depth=depth: daughter(depth),
            ok,
        )
    yield Case(
        "daughter-1e-6-under-a-triangle",
        "a particle 1e-6 r0 under the middle of a triangle",
        lambda: daughter(1e-6, (0.6, 0.3)),
        ok,
    )
    yield Case(
        "particle-on-the-sheet",
        "a particle at distance 0 of the membrane",
        on_the_sheet,
        ("ON_MEMBRANE",),
    )
    yield Case(
        "division-in-a-fold",
        "a daughter at the narrow top of a folded membrane",
        division_in_a_fold,
        ok,
    )
    yield Case(
        "division-beside-a-groove",
        "a daughter by the wall of a groove 0.8 r0 wide",
        division_beside_a_groove,
        ok,
        slow=True,
    )
    yield Case(
        "fold-relaxed-and-faired",
        "a folded membrane relaxed and faired in turns",
        relaxed_and_faired,
        ok,
    )
    for aspect in (1e2, 1e4):
        yield Case(
            f"slivers-{aspect:g}",
            f"a membrane with slivers of aspect {aspect:g}",
            lambda aspect=aspect: slivers(aspect),
            ok,
        )
    yield Case(
        "slivers-1e4-faired",
        "slivers of aspect 1e4, faired before they are relaxed",
        lambda: fair_slivers(1e4),
        ok,
    )
    yield Case(
        "wedge-of-5-degrees",
        "tissue inside of a ridge with a dihedral of 5°",
        lambda: wedge(5.0),
        ok,
    )
    yield Case(
        "crease-of-5-degrees",
        "tissue around a valley with a dihedral of 5°",
        lambda: crease(5.0),
        ok,
    )
    yield Case(
        "patch-of-12-triangles",
        "a membrane of twelve triangles with one free vertex",
        twelve_triangles,
        ok,
    )
    yield Case(
        "crowd-under-a-tight-sheet",
        "64 particles squeezed under springs a thousand times as stiff",
        crowd_under_a_tight_sheet,
        ok,
    )
    yield Case("float32-sheet", "particles and membrane in 32 bits", in_float32, ok)
    yield Case(
        "sheet-far-from-the-origin",
        "particles and membrane 1e6 r0 from the origin",
        far_from_the_origin,
        ok,
    )
    yield Case(
        "load-of-1e3",
        "a vertex pulled with 1000 F(0)",
        lambda: under_a_load(1e3),
        ("CONVERGED", "STEP_LIMIT"),
    )
    yield Case(
        "load-that-is-infinite",
        "a vertex pulled with an infinite force",
        lambda: under_a_load(np.inf),
        ("NON_FINITE",),
    )
    for name, parameters in {
        "springs-1e-3-sheet": {"spring_stiffness": 0.04e-3},
        "springs-1e3-sheet": {"spring_stiffness": 0.04e3},
        "springs-0-sheet": {"spring_stiffness": 0.0},
        "no-pretension": {"pretension": 0.0},
        "contact-stiffness-0": {"contact_stiffness": 0.0},
        "barrier-1e4": {"barrier_stiffness": 1e5},
        "barrier-0": {"barrier_stiffness": 0.0},
        "contact-sharpness-1000": {"contact_sharpness": 1000.0},
        "smoothing-0-sheet": {"smoothing": 0.0},
        "contact-range-2": {"contact_range": 2.0},
        "contact-range-0.1": {"contact_range": 0.1},
    }.items():
        words = ", ".join(f"{k} {v:g}" for k, v in parameters.items())
        yield Case(name, f"the parameter {words}", soft(**parameters), ok)
