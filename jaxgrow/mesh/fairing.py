"""Surface fairing (paper section 4): subdivide, swap, collapse, repair."""

from __future__ import annotations

from typing import TypedDict

import numpy as np
from jaxtyping import Float

from jaxgrow.mesh.collapse import collapse
from jaxgrow.mesh.quality import areas
from jaxgrow.mesh.repair import repair
from jaxgrow.mesh.subdivide import subdivide, subdivide_all
from jaxgrow.mesh.surface import Remeshing, Surface
from jaxgrow.mesh.swap import swap


LONG_EDGE = 1.5
"""Edges longer than this many sides of the equilateral triangle of the largest area
are split (long thin triangles; the paper leaves them open)."""

SHORT_EDGE = 0.25
"""Edges shorter than this many such sides are collapsed (needles)."""


class _Bounds(TypedDict):
    """Obstacles that no operation may cross or come too near to; see `fair`."""

    walls: Float[np.ndarray, "w 3 3"] | None
    clearance: float
    gap: float


def equilateral_side(area: float) -> float:
    """Return the side of the equilateral triangle of an area: √(4 A / √3)."""
    return float(np.sqrt(4.0 * area / np.sqrt(3.0)))


def fair(
    surface: Surface,
    particles: Float[np.ndarray, "n 3"],
    *,
    max_area: float = 0.7,
    min_area: float = 0.1,
    walls: Float[np.ndarray, "w 3 3"] | None = None,
    clearance: float = 0.15,
    gap: float = 0.05,
) -> tuple[Surface, Remeshing]:
    """Fair the surface: subdivide, swap and collapse (paper §4), and repair.

    The paper's phases in the paper's order: subdivision of the triangles that are too
    large (until none is left), edge swaps, and collapse of those that are too small.
    Then the remaining pleats and slivers are repaired. After a collapse or repair the
    edges are swapped again, as it leaves vertices of high valence; the paper does so in
    its next iteration.

    Lengths are in r0, areas in r0². The lower bound must leave room under the upper
    one: a T-shape cuts a triangle just over ``max_area`` into halves.

    Args:
        surface: The live patch of membrane, pinned at its rim.
        particles: Live particles, all on one side of it, which they keep.
        max_area: Triangles above it are subdivided.
        min_area: Triangles below it are collapsed, if that is safe.
        walls: Static triangles that the surface must not cross, the rest of the organ
            near the patch, oriented as it is; None for none.
        clearance: Least distance of particle and surface that an operation may leave;
            if they are nearer already, it must not decrease.
        gap: The same between triangles of the surface that face each other, or a wall.

    Returns:
        The new surface, and what was done as data: `Remeshing.apply` of the old
        vertices gives the new ones exactly.

    Raises:
        ValueError: The area bounds leave no room between them, or the surface is not
            an oriented manifold.
    """
    if not 0 <= 4 * min_area <= max_area:
        raise ValueError(
            f"min_area {min_area} and max_area {max_area} must satisfy "
            "0 <= 4 min_area <= max_area, or fairing would undo its own work."
        )
    side = equilateral_side(max_area)
    surface, subdivided = subdivide_all(surface, max_area, LONG_EDGE * side)
    bounds: _Bounds = {"walls": walls, "clearance": clearance, "gap": gap}
    surface, swapped = swap(surface, particles, **bounds)
    surface, collapsed = collapse(
        surface,
        particles,
        min_area=min_area,
        max_area=max_area,
        min_edge=SHORT_EDGE * side,
        max_edge=LONG_EDGE * side,
        **bounds,
    )
    surface, repaired = repair(
        surface,
        particles,
        max_area=max_area,
        max_edge=LONG_EDGE * side,
        **bounds,
    )
    done = subdivided.then(swapped).then(collapsed).then(repaired)
    if collapsed.counts["collapsed"] or repaired.counts["repaired"]:
        surface, again = swap(surface, particles, **bounds)
        refused = {n: c for n, c in again.counts.items() if n != "swapped"}
        done = done.then(again)
        done.counts.update(refused)
    return surface, done


def refine(
    surface: Surface, max_area: float, *, max_swap_rounds: int = 8
) -> tuple[Surface, Remeshing]:
    """Refine a coarse patch to the particles' scale, before particles exist.

    Subdivision passes with swaps between them, and a last subdivision that reaches the
    bound. Rim edges are never split, so beside one that is long against sqrt(max_area)
    triangles stay larger: they are graded to the organ's edges
    (`jaxgrow.mesh.subdivide`).

    It terminates: swaps follow only as many passes as the largest triangle needs to get
    under the bound, and every later pass halves the triangles over it.

    Args:
        surface: An oriented manifold with or without rim.
        max_area: Area bound (length²), positive.
        max_swap_rounds: Bound on the rounds of swaps between two passes.

    Returns:
        The refined surface, and the map to it.

    Raises:
        ValueError: The bound is not positive.
    """
    if not max_area > 0:
        raise ValueError(f"max_area is {max_area}; the area bound must be positive.")
    nobody = np.zeros((0, 3))
    done = Remeshing.unchanged(surface)
    largest = areas(surface.vertices[surface.faces]).max(initial=0.0)
    for _ in range(int(np.ceil(np.log2(max(largest / max_area, 1.0))))):
        faces = len(surface.faces)
        surface, step = subdivide(surface, max_area)
        if len(surface.faces) == faces:
            break
        surface, swaps = swap(surface, nobody, max_rounds=max_swap_rounds)
        done = done.then(step).then(swaps)
    surface, step = subdivide_all(surface, max_area)
    return surface, done.then(step)
