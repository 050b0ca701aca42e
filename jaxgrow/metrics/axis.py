r"""Axis of a lesion: a curve from the centre of its base ring to its tip.

It is laid through the middles of bands between level lines of the rise
(`jaxgrow.metrics.field`), which go round the lesion. Each piece of a level line counts
by its length, so that a line that leans has its middle on the axis too.

The axis is the polynomial of third degree in its own length, from the centre of the
base ring, nearest to the middles in the mean of squares. Beyond the last of them it
goes on straight to the farthest point of the tip.

A lesion that is broader than long has no bend to speak of: its middles would give one
by chance. So :math:`\int |x''|^2` is added, times :math:`10^{-4} (b/l)^4` with the mean
width b (the raised area over π l) and the length l: that matters for domes only.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow.metrics.elevation import smoothstep
from jaxgrow.metrics.extremes import largest, temperature
from jaxgrow.numerics.guards import safe_divide, safe_norm
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Membrane, replaced


_BANDS = 16

_HALF = 1 / 8
"""Half the width of a band, as a share of the length."""

_DEGREE = 3

_STRAIGHT = 1e-4

_STEPS = 64
"""Pieces of the axis for its length and its turning."""

_LOCATING = 0.1
"""Smoothing in r0 of the length that places bands and sections, in all versions."""


class Raised(NamedTuple):
    """Raised surface of a lesion.

    Attributes:
        membrane: in r0.
        raised: raisedness of each vertex; 0 for padding.
        rise: w of each vertex, from 0 to 1.
        area: of the raised surface.
        base: centre of the base ring.
        normal: of the former surface at the site.
    """

    membrane: Membrane
    raised: Float[Array, " m"]
    rise: Float[Array, " m"]
    area: Float[Array, ""]
    base: Float[Array, "3"]
    normal: Float[Array, "3"]


class Axis(eqx.Module):
    """Axis of a lesion; lengths in r0.

    Attributes:
        point: points of the curve up to the last band, from the base ring.
        tangent: unit tangents there.
        along: lengths from the base ring to them.
        length: from the base ring to the tip, with a fixed smoothing.
        width: mean width of the lesion, its raised area over π times the length.
        coordinate: length along the axis to the level line through each vertex.
    """

    point: Float[Array, "k 3"]
    tangent: Float[Array, "k 3"]
    along: Float[Array, " k"]
    length: Float[Array, ""]
    width: Float[Array, ""]
    coordinate: Float[Array, " m"]

    @property
    def tip(self) -> Float[Array, "3"]:
        """The point at the tip."""
        return self.point[-1] + (self.length - self.along[-1]) * self.tangent[-1]

    @property
    def bend(self) -> Float[Array, ""]:
        """Turning from base to tip, in radians.

        It is 3/2 of the angle between the chords of the first and the last third: the
        turning of an arc. That of the tangent would count every bump of the course.
        """
        third = self.at(self.length * jnp.asarray([1 / 3, 2 / 3], self.length.dtype))[0]
        return 1.5 * angle_between(third[0] - self.point[0], self.tip - third[1])

    def at(
        self, length: Float[Array, " h"]
    ) -> tuple[Float[Array, "h 3"], Float[Array, "h 3"]]:
        """Return points and unit tangents at lengths from the base ring."""
        within = jnp.clip(length, 0, self.along[-1])
        rows = jnp.concatenate([self.point, self.tangent], axis=1)
        rows = _interpolated(within, self.along, rows)
        tangent = _unit(rows[:, 3:])
        return rows[:, :3] + (length - within)[:, None] * tangent, tangent

    def distances(
        self, vertices: Float[Array, "m 3"], length: Float[Array, " h"]
    ) -> Float[Array, "h m"]:
        """Compute the distance of each vertex from planes across the axis.

        A plane may meet a bent lesion again elsewhere. So far away along the axis, from
        one mean width of the lesion on, the distance from the level line replaces that
        from the plane.
        """
        point, tangent = self.at(length)
        plane = tangent @ vertices.T - jnp.sum(point * tangent, axis=1)[:, None]
        along = self.coordinate[None, :] - length[:, None]
        reach = jnp.maximum(self.width, 1)
        return plane + smoothstep(jnp.abs(along) / reach - 1) * (along - plane)


def axis_of(lesion: Raised) -> Axis:
    """Compute the axis of a lesion."""
    level = jnp.linspace(_HALF, 1 - _HALF, _BANDS, dtype=lesion.rise.dtype)
    middle = _middles(lesion, lesion.rise[None, :] - level[:, None], _HALF)
    first = _laid(lesion, middle, lesion.rise)
    # the level line of each band is as far along the axis as its middle
    chord = _chord(lesion, middle)
    share = safe_divide(chord, jnp.full_like(chord, chord[-1]), chord > 0)
    reached = jnp.append(share * first.along[-1], first.length)
    levels = jnp.concatenate(
        [jnp.zeros_like(level[:1]), level, jnp.ones_like(level[:1])]
    )
    coordinate = _interpolated(lesion.rise, levels, reached[:, None])[:, 0]
    return replaced(first, coordinate=coordinate)


def length_of(lesion: Raised, axis: Axis, smoothing: Scalar | None) -> Float[Array, ""]:
    """Compute the length from the base ring to the tip.

    Args:
        lesion: its surface.
        axis: its axis.
        smoothing: largest error in r0; None for the exact maximum.
    """
    ahead = _ahead(lesion, axis.point[-1], axis.tangent[-1], smoothing)
    return axis.along[-1] + ahead


def angle_between(
    vector: Float[Array, "3"], other: Float[Array, "3"]
) -> Float[Array, ""]:
    """Return the angle between two vectors, in radians; 0 for the null vector."""
    across, along = safe_norm(jnp.cross(vector, other)), vector @ other
    some = (across > 0) | (along != 0)
    return jnp.arctan2(across, jnp.where(some, along, 1))


def _middles(
    lesion: Raised, offset: Float[Array, "p m"], half: Scalar
) -> Float[Array, "p 3"]:
    """Compute the middles of bands around the zeros of functions."""
    membrane = lesion.membrane
    corners = membrane.vertices[membrane.faces]
    centre = jnp.mean(corners, axis=1)
    opposite = jnp.roll(corners, 1, axis=1) - jnp.roll(corners, -1, axis=1)
    part = jnp.mean(lesion.raised[membrane.faces], axis=1)
    part = jnp.where(membrane.face_alive, part, 0)

    def middle(offset: Float[Array, " m"]) -> Float[Array, "3"]:
        at_corners = offset[membrane.faces]
        # the gradient times the area: so each piece of a level line counts by length
        steep = safe_norm(jnp.sum(at_corners[:, :, None] * opposite, axis=1)) / 2
        off = jnp.mean(at_corners, axis=1) / jnp.where(half > 0, half, 1)
        weight = part * steep * jnp.maximum(1 - off**2, 0) ** 2
        total = jnp.sum(weight)
        share = safe_divide(weight, jnp.full_like(weight, total), weight > 0)
        return (
            jnp.where(total > 0, share @ (centre - lesion.base[None]), 0) + lesion.base
        )

    return jax.vmap(middle)(offset)


def _chord(lesion: Raised, middle: Float[Array, "p 3"]) -> Float[Array, " q"]:
    """Compute the lengths of chords from the base ring to each middle."""
    way = jnp.concatenate([lesion.base[None], middle])
    step = safe_norm(jnp.diff(way, axis=0))
    return jnp.concatenate([jnp.zeros_like(step[:1]), jnp.cumsum(step)])


def _laid(
    lesion: Raised, middle: Float[Array, "p 3"], share: Float[Array, " m"]
) -> Axis:
    """Fit the axis to middles of bands.

    Args:
        lesion: its surface.
        middle: of bands, from the base upwards.
        share: of the length at which the level line through each vertex is.
    """
    chord = _chord(lesion, middle)
    way = jnp.concatenate([lesion.base[None], middle])
    some = (lesion.area > 0) & (chord[-1] > 0)
    long = jnp.where(some, chord[-1], 1)
    bending = jnp.where(some, _STRAIGHT * (lesion.area / (jnp.pi * long**2)) ** 4, 1)
    slope = _fit(jnp.where(some, chord / long, 0), way - lesion.base[None], bending)

    grid = jnp.linspace(0, 1, _STEPS + 1, dtype=chord.dtype)
    curve = lesion.base[None] + _powers(grid) @ slope
    tangent = _unit(jnp.where(some, _slopes(grid) @ slope, lesion.normal[None]))
    pieces = safe_norm(jnp.diff(curve, axis=0))
    along = jnp.concatenate([chord[:1], jnp.cumsum(pieces)])
    length = along[-1] + _ahead(lesion, curve[-1], tangent[-1], _LOCATING)
    length = jnp.where(some, length, 0)
    return Axis(
        point=curve,
        tangent=tangent,
        along=along,
        length=length,
        width=safe_divide(lesion.area, jnp.pi * length, length > 0),
        coordinate=share * length,
    )


def _ahead(
    lesion: Raised,
    point: Float[Array, "3"],
    tangent: Float[Array, "3"],
    smoothing: Scalar | None,
) -> Float[Array, ""]:
    """Compute how far the tip reaches beyond a point of the axis."""
    alive = lesion.membrane.vertex_alive
    near = smoothstep((lesion.rise - (1 - 3 * _HALF)) / _HALF)
    beyond = near * ((lesion.membrane.vertices - point[None]) @ tangent)
    count = jnp.sum(alive.astype(near.dtype))
    return largest(beyond, alive, temperature(smoothing, count))


def _fit(
    share: Float[Array, " p"], offset: Float[Array, "p 3"], bending: Float[Array, ""]
) -> Float[Array, "d 3"]:
    """Return the coefficients 1 to 3 of the nearest smooth polynomial."""
    gap, end = jnp.diff(share), jnp.zeros_like(share[:1])
    weight = jnp.concatenate([gap, end]) + jnp.concatenate([end, gap])
    basis = _powers(share)
    k = jnp.arange(1, _DEGREE + 1, dtype=share.dtype)
    second = k * (k - 1)
    power = jnp.maximum(k[:, None] + k[None, :] - 3, 1)
    rough = second[:, None] * second[None, :] / power
    weighted = (basis * weight[:, None]).T
    # without a lesion the slope, which has no roughness, is any
    any_slope = jnp.where(share[-1] > 0, 0, 1) * jnp.eye(_DEGREE, dtype=share.dtype)
    normal = weighted @ basis + bending * rough + any_slope
    return jnp.linalg.solve(normal, weighted @ offset)


def _powers(share: Float[Array, " p"]) -> Float[Array, "p d"]:
    second = share**2
    return jnp.stack([share, second, share * second], axis=1)


def _slopes(share: Float[Array, " p"]) -> Float[Array, "p d"]:
    second = share**2
    one = jnp.ones_like(share)
    return jnp.stack([one, 2 * share, 3 * second], axis=1)


def _unit(vector: Float[Array, "k 3"]) -> Float[Array, "k 3"]:
    size = safe_norm(vector)[:, None]
    return vector / jnp.where(size > 0, size, 1)


def _interpolated(
    at: Float[Array, " h"], knots: Float[Array, " k"], rows: Float[Array, "k c"]
) -> Float[Array, "h c"]:
    """Interpolate rows, given at ascending knots, linearly."""
    place = jnp.sum(at[:, None] >= knots[None, 1:-1], axis=1)
    start, end = knots[place], knots[place + 1]
    share = safe_divide(at - start, end - start, end > start)[:, None]
    return rows[place] + share * (rows[place + 1] - rows[place])
