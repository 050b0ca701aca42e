r"""Metrics of a lesion's shape, as differentiable scalars with units.

They are taken from the state alone. *Height* is measured along the axis, the normal
of the former surface at the site; the *raised* surface is what lies more than half an
r0 above the former surface.

The volume is the one enclosed between the grown and the former surface of the patch:
they share their rim, so the difference of their cone volumes
:math:`\frac16 \sum_t x_a \cdot (x_b \times x_c)` is exact. The area of the
cross-section at a height h is the flux of the axis through the raised surface above h,
:math:`A(h) = \sum_t \int_{t,\, z > h} n \cdot a \, dA`, exact for triangles.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgrow.energy.distance import closest_weights
from jaxgrow.numerics import safe_norm
from jaxgrow.state import FormerSurface, Species, State


_RAISED = 0.5
_DIRECTIONS = 32
_LEVELS = 48


class ShapeMetrics(eqx.Module):
    r"""Shape of a lesion. What needs a surface is NaN for a free cluster.

    Attributes:
        height_mm: of the highest raised vertex over the site, along the axis.
        width_mm: largest extent of the raised surface across the axis.
        neck_width_mm: diameter of the circle with the area of the narrowest
            cross-section between half an r0 and the level of the widest one.
        volume_mm3: enclosed between the grown and the former surface of the patch.
        area_mm2: of the raised surface above half an r0 along the axis.
        sphericity: :math:`\pi^{1/3} (6 V)^{2/3} / A` with the raised volume V and its
            surface A, the cross-section at its base included; 1 for a ball.
        intracavitary_fraction: share of the tumour particles above the former surface.
        tumour_diameter_mm: of the ball with the tumour's radius of gyration.
    """

    height_mm: Float[Array, ""]
    width_mm: Float[Array, ""]
    neck_width_mm: Float[Array, ""]
    volume_mm3: Float[Array, ""]
    area_mm2: Float[Array, ""]
    sphericity: Float[Array, ""]
    intracavitary_fraction: Float[Array, ""]
    tumour_diameter_mm: Float[Array, ""]


def shape_metrics(state: State) -> ShapeMetrics:
    """Metrics of a grown lesion.

    Args:
        state: at the end of a growth, or at any time in it.

    Returns:
        Scalars with the units in their names. Maxima and minima are exact, so they are
        differentiable except where two candidates tie.
    """
    return _shape_metrics(state)


@eqx.filter_jit
def _shape_metrics(state: State) -> ShapeMetrics:
    mm = state.frame.particle_mm
    tumour_diameter = _gyration_diameter(state)
    if state.membrane is None or state.frame.former is None:
        nan = jnp.full_like(mm, jnp.nan)
        return ShapeMetrics(*[nan] * 7, tumour_diameter_mm=mm * tumour_diameter)
    membrane, former, axis = state.membrane, state.frame.former, state.frame.axis
    vertices = membrane.vertices
    above = height_above(vertices, former)
    high = membrane.vertex_alive & (above > _RAISED)
    z = vertices @ axis
    height = jnp.max(jnp.where(high, z, 0))
    corners = vertices[membrane.faces]
    vector = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    raised = membrane.face_alive & jnp.any(high[membrane.faces], axis=1)
    levels = _RAISED + (height - _RAISED) * jnp.arange(_LEVELS, dtype=z.dtype) / _LEVELS
    flux = jnp.where(raised, vector @ axis, 0)
    section = _sections(z[membrane.faces], flux, levels)
    size = jnp.where(raised, safe_norm(vector), 0)
    area = _sections(z[membrane.faces], size, levels[:1])[0]
    volume = _cone_volume(corners, membrane.face_alive) - _former_volume(former)
    raised_volume = jnp.sum(section) * (height - _RAISED) / _LEVELS
    surface = area + section[0]
    return ShapeMetrics(
        height_mm=mm * height,
        width_mm=mm * _width(vertices, high, axis),
        neck_width_mm=mm * _neck(section),
        volume_mm3=mm**3 * volume,
        area_mm2=mm**2 * area,
        sphericity=_sphericity(raised_volume, surface),
        intracavitary_fraction=_fraction_above(state, former),
        tumour_diameter_mm=mm * tumour_diameter,
    )


def height_above(
    points: Float[Array, "n 3"], former: FormerSurface
) -> Float[Array, " n"]:
    """Exact distance to the former surface, positive on the lumen's side, in r0."""
    corners = former.vertices[former.faces]
    normal = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    def one(point: Float[Array, "3"]) -> Float[Array, ""]:
        spread = jnp.broadcast_to(point, (corners.shape[0], 3))
        weights = closest_weights(spread, corners)
        offset = point[None, :] - jnp.sum(weights[..., None] * corners, axis=1)
        square = jnp.sum(offset**2, axis=1)
        nearest = jnp.argmin(square)
        side = jnp.sign(jnp.sum(offset[nearest] * normal[nearest]))
        return side * safe_norm(offset[nearest])

    return jax.lax.map(one, points, batch_size=64)


def _cone_volume(
    corners: Float[Array, "f 3 3"], alive: Bool[Array, " f"]
) -> Float[Array, ""]:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    each = jnp.sum(a * jnp.cross(b, c), axis=1) / 6
    return jnp.sum(jnp.where(alive, each, 0))


def _former_volume(former: FormerSurface) -> Float[Array, ""]:
    corners = former.vertices[former.faces]
    return _cone_volume(corners, jnp.ones(corners.shape[0], bool))


def _sections(
    z: Float[Array, "f 3"], flux: Float[Array, " f"], levels: Float[Array, " h"]
) -> Float[Array, " h"]:
    """Sum of a quantity of triangles over their parts above each level.

    Of the flux of the axis it is the area of the cross-section there.
    """
    low, middle, high = jnp.sort(z, axis=1).T

    def at(level: Float[Array, ""]) -> Float[Array, ""]:
        tiny = 1e-12
        below = (level - low) ** 2 / jnp.maximum((middle - low) * (high - low), tiny)
        top = (high - level) ** 2 / jnp.maximum((high - middle) * (high - low), tiny)
        share = jnp.where(level < middle, 1 - below, top)
        share = jnp.where(level <= low, 1, jnp.where(level >= high, 0, share))
        return jnp.sum(share * flux)

    return jax.vmap(at)(levels)


def _neck(section: Float[Array, " h"]) -> Float[Array, ""]:
    widest = jnp.argmax(section)
    below = jnp.arange(section.shape[0]) <= widest
    narrowest = jnp.min(jnp.where(below, section, jnp.inf))
    positive = narrowest > 0
    safe = jnp.where(positive, narrowest, 1)
    return jnp.where(positive, 2 * jnp.sqrt(safe / jnp.pi), 0)


def _width(
    vertices: Float[Array, "m 3"], high: Bool[Array, " m"], axis: Float[Array, "3"]
) -> Float[Array, ""]:
    """Largest extent over directions across the axis, every 180°/32."""
    away = jnp.eye(3, dtype=axis.dtype)[jnp.argmin(jnp.abs(axis))]
    first = jnp.cross(axis, away)
    first = first / safe_norm(first)
    second = jnp.cross(axis, first)
    angle = jnp.pi * jnp.arange(_DIRECTIONS, dtype=axis.dtype) / _DIRECTIONS
    turn = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    along = vertices @ (jnp.stack([first, second], axis=1) @ turn)
    most = jnp.max(jnp.where(high[:, None], along, -jnp.inf), axis=0)
    least = jnp.min(jnp.where(high[:, None], along, jnp.inf), axis=0)
    return jnp.where(jnp.any(high), jnp.max(most - least), 0)


def _sphericity(
    volume: Float[Array, ""], surface: Float[Array, ""]
) -> Float[Array, ""]:
    some = (volume > 0) & (surface > 0)
    ball = jnp.pi ** (1 / 3) * (6 * jnp.where(some, volume, 1)) ** (2 / 3)
    return jnp.where(some, ball / jnp.where(some, surface, 1), 0)


def _is_tumour(state: State) -> Bool[Array, " n"]:
    particles = state.particles
    return particles.alive & (particles.species == int(Species.TUMOUR))


def _fraction_above(state: State, former: FormerSurface) -> Float[Array, ""]:
    """Share of the tumour above, each particle counted by the part of its diameter."""
    tumour = _is_tumour(state)
    height = height_above(state.particles.position, former)
    share = jnp.clip(height + 0.5, 0, 1)
    number = jnp.maximum(jnp.sum(tumour.astype(share.dtype)), 1)
    return jnp.sum(jnp.where(tumour, share, 0)) / number


def _gyration_diameter(state: State) -> Float[Array, ""]:
    """2 √(5/3) R_g + 1: a ball of the same radius of gyration, and one particle."""
    tumour = _is_tumour(state)[:, None]
    position = state.particles.position
    number = jnp.maximum(jnp.sum(tumour.astype(position.dtype)), 1)
    centre = jnp.sum(jnp.where(tumour, position, 0), axis=0) / number
    square = jnp.sum(jnp.where(tumour, position - centre[None, :], 0) ** 2) / number
    some = square > 0
    root = jnp.where(some, jnp.sqrt(jnp.where(some, square, 1)), 0)
    return jnp.where(jnp.any(tumour), 2 * jnp.sqrt(5 / 3) * root + 1, 0)
