r"""Body of a tumour: the convex hull of its particles as balls.

Its support function :math:`h(e) = \max_i x_i \cdot e + 1/2`, from the middle of the
particles, is computed in the directions of an icosahedron that is subdivided three
times. The body is the polyhedron whose corners lie in these directions, at the
distances :math:`\min_e h(e) / (e \cdot d)` at which the planes of support cut them off.
So its sphericity is at most 1, by the isoperimetric inequality, and changes
continuously; that of a ball is 0.996, and its diameter is 0.25 % too small.
"""

import functools
import itertools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgrow.metrics.extremes import largest, temperature
from jaxgrow.numerics.guards import safe_norm
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Particles, Species


_SUBDIVISIONS = 3

_FACING = 0.1
"""Least cosine between a direction and a plane's normal for it to be cut off there."""


class Body(NamedTuple):
    """Body of a tumour; lengths in r0, 0 without a tumour.

    Attributes:
        diameter: its largest extent.
        volume: of its convex hull.
        area: of that hull's surface.
    """

    diameter: Float[Array, ""]
    volume: Float[Array, ""]
    area: Float[Array, ""]

    @property
    def equivalent_diameter(self) -> Float[Array, ""]:
        """Diameter of the ball with its volume."""
        some = self.volume > 0
        return jnp.where(
            some, jnp.cbrt(6 * jnp.where(some, self.volume, 1) / jnp.pi), 0
        )

    @property
    def sphericity(self) -> Float[Array, ""]:
        """π^⅓ (6 V)^⅔ / A, at most 1; 0 without a tumour."""
        some = self.area > 0
        ball = jnp.pi * self.equivalent_diameter**2
        return jnp.where(some, ball / jnp.where(some, self.area, 1), 0)


def body_of(particles: Particles, smoothing: Scalar | None) -> Body:
    """Compute the body of a tumour.

    Args:
        particles: all.
        smoothing: largest error of the diameter in r0; None for the exact maximum.
    """
    tumour = tumour_of(particles)
    some = jnp.any(tumour)
    dtype = particles.position.dtype
    number = jnp.sum(tumour.astype(dtype))
    position = jnp.where(tumour[:, None], particles.position, 0)
    middle = jnp.sum(position, axis=0) / jnp.maximum(number, 1)
    real = tumour | ~some  # a maximum needs a value
    directions, faces = _icosphere()
    # behind a barrier, since XLA takes seconds to multiply constants when it compiles
    way = jax.lax.optimization_barrier(jnp.asarray(directions, dtype))
    half = way.shape[0] // 2
    along = way[:half] @ (position - middle[None]).T
    ends = [largest(x, real[None, :], None) + 0.5 for x in (along, -along)]
    support = jnp.concatenate(ends)

    extent = ends[0] + ends[1]
    if smoothing is not None:
        # pairs of particles and a direction are the candidates
        warmth = temperature(smoothing, half * number**2)
        one, other = (largest(x, real[None, :], warmth) for x in (along, -along))
        extent = 1 + (one + other)
        diameter = largest(extent, jnp.ones(half, bool), warmth)
    else:
        diameter = jnp.max(extent)

    facing = way @ way.T
    cut = support[None, :] / jnp.where(facing > _FACING, facing, 1)
    radius = jnp.min(jnp.where(facing > _FACING, cut, jnp.inf), axis=1)
    a, b, c = (radius[:, None] * way)[jnp.asarray(faces).T]
    double = jnp.cross(b - a, c - a)
    volume = jnp.sum(a * double) / 6
    area = jnp.sum(safe_norm(double)) / 2
    return Body(*(jnp.where(some, x, 0) for x in (diameter, volume, area)))


def tumour_of(particles: Particles) -> Bool[Array, " n"]:
    """Return which particles belong to the tumour."""
    return particles.alive & (particles.species == int(Species.TUMOUR))


def gyration_diameter(particles: Particles) -> Float[Array, ""]:
    """Compute the diameter of the ball with the tumour's radius of gyration.

    It is 2 √(5/3) R_g + 1, with one particle added.
    """
    tumour = tumour_of(particles)[:, None]
    position = particles.position
    number = jnp.maximum(jnp.sum(tumour.astype(position.dtype)), 1)
    centre = jnp.sum(jnp.where(tumour, position, 0), axis=0) / number
    square = jnp.sum(jnp.where(tumour, position - centre[None, :], 0) ** 2) / number
    some = square > 0
    root = jnp.where(some, jnp.sqrt(jnp.where(some, square, 1)), 0)
    return jnp.where(jnp.any(tumour), 2 * jnp.sqrt(5 / 3) * root + 1, 0)


@functools.cache
def _icosphere() -> tuple[list[tuple[float, float, float]], list[tuple[int, int, int]]]:
    """Build a subdivided icosahedron's corners and triangles.

    The second half of the corners are opposite to the first, in the same order.
    """
    corners = _icosahedron()
    faces = [
        _outwards(corners, trio)
        for trio in itertools.combinations(range(12), 3)
        if all(
            math.isclose(math.dist(corners[i], corners[j]), _SIDE)
            for i, j in itertools.combinations(trio, 2)
        )
    ]
    for _ in range(_SUBDIVISIONS):
        corners, faces = _subdivided(corners, faces)
    upper = [k for k, corner in enumerate(corners) if corner > (0.0, 0.0, 0.0)]
    opposite = {
        tuple(round(-x, 9) + 0.0 for x in corner): k for k, corner in enumerate(corners)
    }
    lower = [opposite[tuple(round(x, 9) + 0.0 for x in corners[k])] for k in upper]
    place = {k: new for new, k in enumerate([*upper, *lower])}
    return (
        [corners[k] for k in [*upper, *lower]],
        [(place[a], place[b], place[c]) for a, b, c in faces],
    )


_SIDE = 4 / math.sqrt(10 + 2 * math.sqrt(5))
"""Side of the icosahedron in the unit sphere."""


def _icosahedron() -> list[tuple[float, float, float]]:
    golden = (1 + math.sqrt(5)) / 2
    found: list[tuple[float, float, float]] = []
    for one, other in itertools.product((-1.0, 1.0), (-golden, golden)):
        found += [(0.0, one, other), (one, other, 0.0), (other, 0.0, one)]
    return [_normalised(corner) for corner in found]


def _subdivided(
    corners: list[tuple[float, float, float]], faces: list[tuple[int, int, int]]
) -> tuple[list[tuple[float, float, float]], list[tuple[int, int, int]]]:
    """Divide each triangle into four, with the new corners on the sphere."""
    corners, between = list(corners), dict[tuple[int, int], int]()

    def halfway(i: int, j: int) -> int:
        key = min(i, j), max(i, j)
        if key not in between:
            between[key] = len(corners)
            x, y, z = (p + q for p, q in zip(corners[i], corners[j], strict=True))
            corners.append(_normalised((x, y, z)))
        return between[key]

    finer: list[tuple[int, int, int]] = []
    for a, b, c in faces:
        ab, bc, ca = halfway(a, b), halfway(b, c), halfway(c, a)
        finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    return corners, finer


def _outwards(
    corners: list[tuple[float, float, float]], trio: tuple[int, ...]
) -> tuple[int, int, int]:
    i, j, k = trio
    (a, b, c), (d, e, f), (g, h, m) = corners[i], corners[j], corners[k]
    volume = a * (e * m - f * h) - b * (d * m - f * g) + c * (d * h - e * g)
    return (i, j, k) if volume > 0 else (i, k, j)


def _normalised(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    size = math.hypot(*vector)
    x, y, z = (component / size for component in vector)
    return x, y, z
