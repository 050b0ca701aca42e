"""Tissue particles in the layer under a patch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from jaxgrow.organ.layer_points import Addition, Layer
from jaxgrow.organ.organ import Organ, OrganError
from jaxgrow.organ.patch import Patch


HOLD = 1.0
"""Tissue within this distance (r0) of the sides and bottom of its layer is held."""

DISTANCE = 0.8
"""Smallest distance of two particles over the spacing, if the density allows it.

Random sequential packing of equal spheres jams at a volume fraction of 0.384.
"""

JAMMED = 1.43
"""Particles per spacing³ at which random packing jams for that distance."""

SHRINK = 0.95
"""Factor on the smallest distance if no more particles fit."""

MOST_SHRINKS = 2
"""Number of such factors by which the distance may fall below that of the density, if
particles are added around others."""

PATIENCE = 20
"""Batches of candidates in a row that may place less than a hundredth of the missing
particles before the distance shrinks."""

BATCH = 2000
"""Darts per batch."""

LATEST = 0.1
"""Share of new darts from which on the tree of the others is rebuilt."""

CELL = 0.7
"""Side, over the spacing, of the cells that the layer is surveyed with."""

FEWEST_CELLS, MOST_CELLS = 12_000, 40_000
"""Bounds of the cells of a survey: enough for the volume of a small layer to a per cent
or two, and few enough to survey a large one in a second."""


@dataclass(frozen=True, eq=False)
class Tissue:
    """Particles of healthy tissue under a patch.

    Attributes:
        points: Local positions in r0 (``Patch.to_local``).
        held: Those near the bottom or the sides of the layer, which stay in place.
        depth: Distance of each to the organ's surface in r0.
        distance: The smallest distance of two points that was enforced, in r0.
        volume: Estimated volume of the layer, in r0³.
    """

    points: Float[np.ndarray, "n 3"]
    held: Bool[np.ndarray, "n"]
    depth: Float[np.ndarray, "n"]
    distance: float
    volume: float


def fill_tissue(
    organ: Organ,
    patch: Patch,
    *,
    spacing: float,
    density: float,
    thickness: float,
    gap: float,
    hold: float,
    rng: np.random.Generator,
) -> Tissue:
    """Fill the layer under a patch with random particles (dart throwing).

    The layer is that of `Layer`: between ``gap`` and ``thickness`` under the patch.
    Darts are thrown at it; one that lands within 0.8 ``spacing`` of an earlier one is
    discarded (paper section 3: tissue is distributed randomly; the minimum distance is
    ours, so that relaxation takes few steps). If no more fit, the distance shrinks. All
    lengths are in r0.

    Args:
        organ: The organ.
        patch: A patch of it.
        spacing: Distance of neighbours that the particles are to have.
        density: Particles per spacing³.
        thickness: Of the layer.
        gap: Free depth just under the surface.
        hold: Particles within this distance of the layer's bottom or sides are held.
        rng: Draws the darts; the same generator state gives the same particles.

    Returns:
        The particles.

    Raises:
        OrganError: If a length is invalid or the layer has no room.
    """
    _check_lengths(spacing, density, thickness, gap, hold)
    layer = Layer(organ, patch, gap, thickness)
    survey = _survey(layer, CELL * spacing, rng)
    wanted = round(density * survey.volume / spacing**3)
    if wanted < 1:
        msg = (
            f"the tissue layer under the patch has a volume of only "
            f"{survey.volume:.3g} r0³ between the depths {gap:g} and {thickness:g} r0, "
            "no room for a particle: the wall is too thin there for this lesion, "
            "choose another site."
        )
        raise OrganError(msg)
    points, depth, distance = _throw_darts(
        layer, survey, wanted, DISTANCE * spacing, rng
    )
    held = layer.near_edge(points, depth, hold)
    return Tissue(points, held, depth, distance, survey.volume)


def extend_tissue(
    space: Addition,
    points: Float[np.ndarray, "n 3"],
    *,
    spacing: float,
    density: float,
    hold: float,
    rng: np.random.Generator,
) -> Tissue:
    """Fill the added part of a layer, around the particles present.

    Darts are thrown as in ``fill_tissue``, none near a particle. Particles that have
    moved into the new space count for its density. So that none is placed too close to
    one of them, the distance shrinks at most ``MOST_SHRINKS`` times below that at which
    random packing has the density; the particles that do not fit then are left out.

    Args:
        space: The added part of the layer.
        points: The particles, wherever they have moved.
        spacing: Distance of neighbours that the particles are to have.
        density: Particles per spacing³.
        hold: Particles within this distance of the layer's bottom or sides are held.
        rng: Draws the darts.

    Returns:
        The new particles; there may be none.

    Raises:
        OrganError: If a length is invalid.
    """
    layer = space.layer
    _check_lengths(spacing, density, layer.thickness, layer.gap, hold)
    survey = _survey(space, CELL * spacing, rng)
    moved_in = len(space.inside(points).points)
    wanted = max(round(density * survey.volume / spacing**3) - moved_in, 0)
    dense = min(1.0, np.cbrt(JAMMED / density))
    new, depth, distance = _throw_darts(
        space,
        survey,
        wanted,
        DISTANCE * spacing,
        rng,
        around=points,
        least=DISTANCE * spacing * dense * SHRINK**MOST_SHRINKS,
    )
    held = layer.near_edge(new, depth, hold)
    return Tissue(new, held, depth, distance, survey.volume)


def _check_lengths(
    spacing: float, density: float, thickness: float, gap: float, hold: float
) -> None:
    if not (0 <= gap < thickness and spacing > 0 and density > 0 and hold >= 0):
        msg = (
            f"a tissue layer with spacing {spacing:g}, density {density:g}, thickness "
            f"{thickness:g}, gap {gap:g} and hold {hold:g} (in r0) cannot be filled: "
            "spacing and density must be positive, hold not negative, and the gap "
            "smaller than the thickness."
        )
        raise OrganError(msg)


@dataclass(frozen=True, eq=False)
class _Survey:
    """Random points of a layer, one per grid cell, that measure its volume.

    Stratified points measure the volume much better than independent ones, and they
    give the targets of darts. Cells whose point is outside have none.
    """

    points: Float[np.ndarray, "n 3"]
    depth: Float[np.ndarray, "n"]
    cell: Float[np.ndarray, "3"]
    volume: float


def _survey(space: Layer | Addition, side: float, rng: np.random.Generator) -> _Survey:
    size = space.high - space.low
    coarsest, finest = np.cbrt(np.prod(size) / [FEWEST_CELLS, MOST_CELLS])
    side = float(np.clip(side, finest, coarsest))
    cells = np.ceil(size / side).astype(np.int64)
    corner = np.stack(
        np.meshgrid(*(np.arange(number) for number in cells), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    cell = size / cells
    tried = space.low + (corner + rng.uniform(size=corner.shape)) * cell
    points, depth, _ = space.inside(tried)
    volume = float(np.prod(cell) * len(points))
    order = rng.permutation(len(points))
    return _Survey(points[order], depth[order], cell, volume)


def _throw_darts(
    space: Layer | Addition,
    survey: _Survey,
    wanted: int,
    distance: float,
    rng: np.random.Generator,
    *,
    around: Float[np.ndarray, "a 3"] | None = None,
    least: float = 0.0,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n"], float]:
    """Place particles at random, at the largest distance that allows enough.

    The survey's points are the first darts; further ones fall within one cell of those,
    which covers the whole space and seldom misses it.

    Args:
        space: To be filled.
        survey: Of the space.
        wanted: Number of particles.
        distance: Initial least distance of any two of them.
        rng: Draws the darts.
        around: Particles already present.
        least: Bound of the distance; if it is reached, fewer particles are placed.

    Returns:
        The particles, their depths, and the distance in the end.
    """
    taken = _Taken(np.zeros((0, 3)) if around is None else around)
    far = np.flatnonzero(taken.apart(survey.points, distance))
    first = far[_greedy(survey.points[far], distance)[:wanted]]
    points, depth = survey.points[first], survey.depth[first]
    taken.add(points)
    idle = 0
    while len(points) < wanted:
        missing = wanted - len(points)
        near = survey.points[rng.integers(len(survey.points), size=BATCH)]
        darts = near + rng.uniform(-1, 1, size=(BATCH, 3)) * survey.cell
        apart = taken.apart(darts, distance)
        new, new_depth, _ = space.inside(darts[apart])
        free = _greedy(new, distance)[:missing]
        taken.add(new[free])
        points = np.concatenate([points, new[free]])
        depth = np.concatenate([depth, new_depth[free]])
        idle = 0 if 100 * len(free) >= missing else idle + 1
        if idle >= PATIENCE:
            if distance * SHRINK < least:
                break
            idle, distance = 0, distance * SHRINK
    return points, depth, distance


class _Taken:
    """Points in two trees: most of them, and the latest, rebuilt each time."""

    def __init__(self, points: Float[np.ndarray, "n 3"]) -> None:
        self._most, self._latest = points, points[:0]
        self._trees = KDTree(points), KDTree(points[:0])

    def add(self, points: Float[np.ndarray, "k 3"]) -> None:
        """Add points."""
        self._latest = np.concatenate([self._latest, points])
        if len(self._latest) > LATEST * len(self._most):
            self._most = np.concatenate([self._most, self._latest])
            self._latest = self._latest[:0]
            self._trees = KDTree(self._most), KDTree(self._latest)
        else:
            self._trees = self._trees[0], KDTree(self._latest)

    def apart(
        self, points: Float[np.ndarray, "n 3"], distance: float
    ) -> Bool[np.ndarray, "n"]:
        """Return whether points have no taken point within a distance."""
        apart = np.ones(len(points), dtype=bool)
        for tree in self._trees:
            near, _ = tree.query(points[apart], distance_upper_bound=distance)
            apart[apart] = np.isinf(near)
        return apart


def _greedy(points: Float[np.ndarray, "n 3"], distance: float) -> Int[np.ndarray, "k"]:
    """Select points in order, none closer than ``distance`` to a selected one."""
    free = np.ones(len(points), dtype=bool)
    if len(points):
        pairs = KDTree(points).query_pairs(distance, output_type="ndarray")
        for first, second in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]:
            if free[first]:
                free[second] = False
    return np.flatnonzero(free)
