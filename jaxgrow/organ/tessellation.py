"""Even triangulation of an implicit surface by restricted Delaunay.

Points are spread evenly over the surface, then joined by the faces of their Delaunay
tetrahedra that separate the inside of the body from its outside: a tetrahedron counts
as inside if the field is negative at its circumcentre, so these faces are the ones
whose dual Voronoi edge crosses the surface. For samples dense enough against the
curvature the result is homeomorphic to the surface (Amenta & Bern, Surface
reconstruction by Voronoi filtering, 1999), and a boundary of tetrahedra is closed by
construction.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import Delaunay, KDTree

from jaxgrow.organ.implicit_surface import Field, project


SEED_DENSITY = 12
"""Random candidates per kept point: enough for a blue-noise sample without gaps."""

SEED_DISTANCE = 0.72
"""Smallest distance of the starting points over the resulting edge length."""

ROUNDS = 8
"""Rounds of retriangulation."""

SWEEPS = 4
"""Smoothing sweeps per round."""


def scatter(
    field: Field,
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
    edge: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, "n 3"]:
    """Sample the surface at random, with a distance of about ``edge``.

    Candidates are drawn uniformly in the cells of a grid that the surface may cross,
    those in a thin shell around it are projected onto it, and of these, in random
    order, each without a kept one near is kept (Poisson disc sampling).
    """
    shell = 0.5 * edge
    cell = 2 * edge
    axes = [
        np.arange(a + cell / 2, b + cell / 2, cell)
        for a, b in zip(low, high, strict=True)
    ]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    # from a cell's centre its corners are √3 / 2 cells away
    centres = centres[np.abs(field(centres)) < shell + 0.87 * cell]
    # a point kept takes about 0.87 edge² of the surface, that is 0.87 edge² (2 shell)
    # of the space
    number = int(SEED_DENSITY * len(centres) * cell**3 / (0.87 * edge**2 * 2 * shell))
    candidates = centres[rng.integers(len(centres), size=number)]
    candidates += cell * rng.uniform(-0.5, 0.5, size=candidates.shape)
    candidates = candidates[np.abs(field(candidates)) < shell]
    candidates = project(field, candidates, step=1e-3 * edge, iterations=3)
    tree = KDTree(candidates)
    neighbours = tree.query_ball_point(candidates, SEED_DISTANCE * edge)
    free = np.ones(len(candidates), dtype=bool)
    kept = []
    for index, near in enumerate(neighbours):
        if free[index]:
            kept.append(index)
            free[near] = False
    return candidates[kept]


def circumcentres(
    points: Float[np.ndarray, "n 3"], tetrahedra: Int[np.ndarray, "t 4"]
) -> Float[np.ndarray, "t 3"]:
    """Compute the circumcentres of tetrahedra; far away for flat ones."""
    origin = points[tetrahedra[:, 0]]
    a, b, c = (points[tetrahedra[:, k]] - origin for k in (1, 2, 3))
    squares = [np.einsum("ij,ij->i", e, e)[:, None] for e in (a, b, c)]
    cross = np.cross(b, c), np.cross(c, a), np.cross(a, b)
    volume = np.einsum("ij,ij->i", a, cross[0])[:, None]
    tiny = np.finfo(float).tiny
    volume = np.where(np.abs(volume) < tiny, tiny, volume)
    numerator = sum(s * x for s, x in zip(squares, cross, strict=True))
    return origin + numerator / (2 * volume)


def restricted_delaunay(
    field: Field, points: Float[np.ndarray, "n 3"], reach: float
) -> Int[np.ndarray, "f 3"]:
    """Find the Delaunay faces between inside and outside.

    They are counter-clockwise seen from outside.

    Args:
        field: Negative inside.
        points: Points on the surface.
        reach: Circumcentres are clipped to this distance around the points' box before
            the field is evaluated (flat tetrahedra have them anywhere).
    """
    delaunay = Delaunay(points)
    tetrahedra = delaunay.simplices
    centres = circumcentres(points, tetrahedra)
    inside = field(np.clip(centres, points.min(0) - reach, points.max(0) + reach)) < 0
    # the face opposite to corner k of each inside tetrahedron with an outside neighbour
    neighbour = delaunay.neighbors
    outside = (neighbour < 0) | ~inside[neighbour]
    owner, corner = np.nonzero(outside & inside[:, None])
    others = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
    faces = np.take_along_axis(tetrahedra[owner], others[corner], axis=1)
    apex = points[tetrahedra[owner, corner]]
    a, b, c = (points[faces[:, k]] for k in range(3))
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), apex - a) > 0
    faces[turned] = faces[turned][:, ::-1]
    return faces.astype(np.int64)


def spread(
    points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "f 3"]
) -> Float[np.ndarray, "n 3"]:
    """Apply one sweep of mutual repulsion along the edges.

    An edge of length l pushes its ends apart by (l0 - l)+ / 5 each, with l0 = 1.2
    times the root mean square length (Persson & Strang, A simple mesh generator in
    MATLAB, SIAM Review 46, 2004). Averaging neighbours instead would draw the
    vertices away from the tips.
    """
    start, end = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    edge = points[end] - points[start]
    length = np.linalg.norm(edge, axis=1)
    rest = 1.2 * np.sqrt(np.mean(length**2))
    # each edge occurs once in either direction, so every end is pushed once
    push = 0.2 * np.maximum(rest - length, 0) / length
    moved = points.copy()
    for axis in range(3):
        moved[:, axis] -= np.bincount(
            start, weights=push * edge[:, axis], minlength=len(points)
        )
    return moved


def tessellate(
    field: Field,
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
    edge: float,
    rng: np.random.Generator,
    pinned: Float[np.ndarray, "k 3"] | None = None,
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "f 3"]]:
    """Triangulate the zero set of ``field`` with even triangles, closed.

    Args:
        field: Negative inside, about a distance near the surface.
        low: Lower corner of a box that contains the body.
        high: Upper corner of the box.
        edge: Typical edge length; must be small against the radii of curvature.
        rng: Draws the starting points.
        pinned: Points on the surface that must be vertices; they come first. They
            must be further apart than ``edge``.

    Returns:
        Vertices, on the surface to rounding, and faces, counter-clockwise from outside.
    """
    step = 1e-4 * edge
    points = scatter(field, low, high, edge, rng)
    if pinned is None:
        pinned = np.zeros((0, 3))
    else:
        points = points[KDTree(pinned).query(points)[0] > SEED_DISTANCE * edge]
        points = np.concatenate([pinned, points])
    faces = restricted_delaunay(field, points, edge)
    for _ in range(ROUNDS):
        for _ in range(SWEEPS):
            points = project(field, spread(points, faces), step=step, iterations=1)
            points[: len(pinned)] = pinned
        faces = restricted_delaunay(field, points, edge)
    used = np.unique(faces)
    renumber = np.full(len(points), -1)
    renumber[used] = np.arange(len(used))
    return project(field, points[used], step=step, iterations=3), renumber[faces]
