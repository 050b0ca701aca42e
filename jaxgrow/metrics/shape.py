r"""Shape metrics of a lesion, computed from the state alone.

*Height* is measured along the axis, the normal of the former surface at the site. The
*raised* surface lies more than half an r0 above the former surface; the part between a
quarter and half an r0 above it counts in part, so that all metrics are continuous in
the positions.

The volume is the one enclosed between the grown and the former surface of the patch:
they share their rim, so the difference of their cone volumes
:math:`\frac16 \sum_t x_a \cdot (x_b \times x_c)` is exact.
"""

import math
from dataclasses import fields

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgrow.equilibrium.transformations import (
    check_undifferentiated,
    is_differentiated,
)
from jaxgrow.metrics.curvature import mean_and_spread, mean_curvature
from jaxgrow.metrics.elevation import height_above, RAISED, raisedness, smoothstep
from jaxgrow.metrics.extent import height_of, width_of
from jaxgrow.metrics.sections import (
    diameters,
    LEVELS,
    mean_above,
    necks,
    section_areas,
    section_heights,
    share_above,
)
from jaxgrow.numerics.guards import check_precision, safe_divide, safe_norm
from jaxgrow.state import FormerSurface, Membrane, Particles, Species, State


_TIP = 1.0  # r0 below the tip to which the surface belongs to it
_NECK = 0.5  # r0 above and below a section of the neck to which it belongs to that
_NARROW = 0.1  # a section this much wider (r0) than the neck counts 1/e as neck
_LOCATING = 0.25  # smoothing in r0 of where tip and neck are, in all versions


class ShapeMetrics(eqx.Module):
    r"""Shape metrics of a lesion, with their units in the names.

    Metrics that need a surface are NaN for a free cluster.

    Curvatures are mean curvatures, half the sum of the two principal ones, positive
    for a ball seen from the lumen, and means over the area near a place:
    :math:`\sum_v w_v M_v / \sum_v w_v A_v` with the integral :math:`M_v` of the
    curvature around a vertex and its area :math:`A_v`
    (`jaxgrow.metrics.curvature`). The weight :math:`w_v` falls as
    :math:`(1 - u^2)^2` with the height from the place, in units of the reach given
    below. Spreads are standard deviations over the same area.

    Attributes:
        height_mm: of the highest raised vertex over the site, along the axis.
        width_mm: largest extent of the raised surface across the axis.
        neck_width_mm: diameter of the circle with the area of the narrowest
            cross-section between half an r0 and the level of the widest one
            (`jaxgrow.metrics.sections.necks`); of a sessile lesion that is its base.
        height_to_width: height over width, dimensionless; 0 without a width.
        neck_to_width: neck width over width, dimensionless; 0 without a width.
        volume_mm3: enclosed between the grown and the former surface of the patch.
        area_mm2: of the raised surface above half an r0 along the axis.
        sphericity: :math:`\pi^{1/3} (6 V)^{2/3} / A` with the raised volume V and its
            surface A, the cross-section at its base included; 1 for a ball, 0 if
            nothing is raised.
        intracavitary_fraction: share of the tumour's volume above the former surface,
            the measure of FIGO's types 0 (all), 1 (at least half) and 2. Each tumour
            particle is a ball with a diameter of r0, of which the plane through its
            nearest point of the former surface cuts off :math:`h^2 (3 - 2h)`.
        tip_curvature_per_mm: near the tip, down to one r0 below it.
        tip_curvature_spread_per_mm: its spread.
        neck_curvature_per_mm: near the neck, up to half an r0 above and below it; all
            sections are the neck in proportion to :math:`e^{-10 c}`, with their
            diameter c as a neck in r0 (`jaxgrow.metrics.sections.necks`).
        neck_curvature_spread_per_mm: its spread.
        tumour_diameter_mm: of the ball with the tumour's radius of gyration.
    """

    height_mm: Float[Array, ""]
    width_mm: Float[Array, ""]
    neck_width_mm: Float[Array, ""]
    height_to_width: Float[Array, ""]
    neck_to_width: Float[Array, ""]
    volume_mm3: Float[Array, ""]
    area_mm2: Float[Array, ""]
    sphericity: Float[Array, ""]
    intracavitary_fraction: Float[Array, ""]
    tip_curvature_per_mm: Float[Array, ""]
    tip_curvature_spread_per_mm: Float[Array, ""]
    neck_curvature_per_mm: Float[Array, ""]
    neck_curvature_spread_per_mm: Float[Array, ""]
    tumour_diameter_mm: Float[Array, ""]

    def as_dict(self) -> dict[str, float]:
        """Return the metrics as plain floats, by name: a row of a table.

        Raises:
            ValueError: a derivative is being taken.
        """
        check_undifferentiated(self, "a plain number", "use the metrics themselves")
        return {field.name: float(getattr(self, field.name)) for field in fields(self)}

    def __repr__(self) -> str:
        """The metrics with their values, where they have some."""
        if is_differentiated(self):
            return super().__repr__()
        rows = (f"{name}={value:.4g}" for name, value in self.as_dict().items())
        return f"ShapeMetrics({', '.join(rows)})"


def shape_metrics(state: State, *, smoothing: float = 0.0) -> ShapeMetrics:
    r"""Compute the metrics of a grown lesion, differentiable in the positions.

    Height, width and neck width are maxima and minima over vertices, directions and
    cross-sections. Exact, they are continuous and have a kink where two candidates tie.
    Smooth, the candidates near the extreme share its derivative
    (`jaxgrow.metrics.extremes`), at an error that is bounded: with the smoothing
    :math:`\epsilon`, in r0,

    .. math::
        0 \le \tilde h - h \le \epsilon, \qquad
        0 \le \tilde w - w \le \epsilon, \qquad
        -\tfrac23 \epsilon \le \tilde n - n \le \epsilon.

    The ratios are those of the smooth lengths. The other metrics are integrals and do
    not depend on the smoothing; ratios, sphericity and curvatures, which are undefined
    as long as nothing is raised, are 0 there and begin with a jump. Kinks remain where
    a point has two nearest points on the former surface.

    On meshes as fine as membranes (sides of 0.8 r0) all metrics of sphere caps,
    cylinders and tori are within 3 % of their closed forms, but the curvature of the
    neck, which is a mean over its surroundings, within 12 % on a cylinder and within
    0.025 per r0 on a torus.

    Args:
        state: at the end of a growth, or at any time during it.
        smoothing: the largest error :math:`\epsilon` in r0 by which smooth maxima and
            minima may differ from the exact ones; 0 for the exact ones. For a loss,
            0.1 is a tenth of a particle.

    Returns:
        Scalars with the units in their names.

    Raises:
        ValueError: the smoothing is negative or not finite, or the state has 64 bits
            and JAX computes in 32.
    """
    if not 0 <= smoothing < math.inf:
        raise ValueError(
            f"smoothing is {smoothing}; give a length in r0, or 0 for exact metrics."
        )
    dtype = state.frame.particle_mm.dtype
    check_precision(dtype)
    return _shape_metrics(state, jnp.asarray(smoothing, dtype) if smoothing else None)


@eqx.filter_jit
def _shape_metrics(state: State, smoothing: Float[Array, ""] | None) -> ShapeMetrics:
    mm = state.frame.particle_mm
    tumour_diameter = mm * _gyration_diameter(state.particles)
    if state.membrane is None or state.frame.former is None:
        nan = jnp.full_like(mm, jnp.nan)
        return ShapeMetrics(*[nan] * 13, tumour_diameter_mm=tumour_diameter)
    membrane, former, axis = state.membrane, state.frame.former, state.frame.axis
    above = height_above(membrane.vertices, former)
    height = height_of(membrane, above, axis, smoothing)
    width = width_of(membrane, above, axis, smoothing)

    corners = membrane.vertices[membrane.faces]
    vector = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    vector = jnp.where(membrane.face_alive[:, None], vector, 0)
    z = section_heights(membrane.vertices @ axis, above)[membrane.faces]
    flux = vector @ axis
    top = jnp.maximum(height_of(membrane, above, axis, _LOCATING), RAISED)
    levels = RAISED + (top - RAISED) * jnp.arange(LEVELS, dtype=z.dtype) / LEVELS
    section = section_areas(z, flux, levels)
    diameter = diameters(section)
    _, neck = necks(diameter, smoothing)
    area = jnp.sum(safe_norm(vector) * share_above(z, levels[0]))
    raised_volume = jnp.sum(flux * mean_above(z, levels[0]))

    weights = _near_tip_and_neck(membrane, above, axis, top, levels, diameter)
    curved = mean_curvature(membrane.vertices, membrane.faces, membrane.face_alive)
    tip, tip_spread = mean_and_spread(*curved, weights[0])
    at_neck, neck_spread = mean_and_spread(*curved, weights[1])
    return ShapeMetrics(
        height_mm=mm * height,
        width_mm=mm * width,
        neck_width_mm=mm * neck,
        height_to_width=safe_divide(height, width, width > 0),
        neck_to_width=safe_divide(neck, width, width > 0),
        volume_mm3=mm**3
        * (_cone_volume(corners, membrane.face_alive) - _under(former)),
        area_mm2=mm**2 * area,
        sphericity=_sphericity(raised_volume, area + section[0]),
        intracavitary_fraction=_fraction_above(state.particles, former),
        tip_curvature_per_mm=tip / mm,
        tip_curvature_spread_per_mm=tip_spread / mm,
        neck_curvature_per_mm=at_neck / mm,
        neck_curvature_spread_per_mm=neck_spread / mm,
        tumour_diameter_mm=tumour_diameter,
    )


def _near_tip_and_neck(
    membrane: Membrane,
    above: Float[Array, " m"],
    axis: Float[Array, "3"],
    top: Float[Array, ""],
    levels: Float[Array, " h"],
    diameter: Float[Array, " h"],
) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """Compute the weight of each vertex as a part of tip and of neck."""
    z = membrane.vertices @ axis
    raised = jnp.where(membrane.vertex_alive, raisedness(above), 0)
    counted, _ = necks(diameter, _LOCATING)
    narrow = jax.nn.softmax(-counted / _NARROW)
    at_neck = _bump((z[:, None] - levels[None, :]) / _NECK) @ narrow
    return raised * _bump((z - top) / _TIP), raised * at_neck


def _bump(u: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Return (1 - u²)², cut off at 1: continuously differentiable."""
    return jnp.maximum(1 - u**2, 0) ** 2


def _cone_volume(
    corners: Float[Array, "f 3 3"], alive: Bool[Array, " f"]
) -> Float[Array, ""]:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    each = jnp.sum(a * jnp.cross(b, c), axis=1) / 6
    return jnp.sum(jnp.where(alive, each, 0))


def _under(former: FormerSurface) -> Float[Array, ""]:
    corners = former.vertices[former.faces]
    return _cone_volume(corners, jnp.ones(corners.shape[0], bool))


def _sphericity(
    volume: Float[Array, ""], surface: Float[Array, ""]
) -> Float[Array, ""]:
    some = (volume > 0) & (surface > 0)
    ball = jnp.pi ** (1 / 3) * (6 * jnp.where(some, volume, 1)) ** (2 / 3)
    return safe_divide(jnp.where(some, ball, 0), surface, some)


def _is_tumour(particles: Particles) -> Bool[Array, " n"]:
    return particles.alive & (particles.species == int(Species.TUMOUR))


def _fraction_above(particles: Particles, former: FormerSurface) -> Float[Array, ""]:
    """Return the share of the tumour's balls above the former surface."""
    tumour = _is_tumour(particles)
    share = smoothstep(height_above(particles.position, former) + 0.5)
    number = jnp.maximum(jnp.sum(tumour.astype(share.dtype)), 1)
    return jnp.sum(jnp.where(tumour, share, 0)) / number


def _gyration_diameter(particles: Particles) -> Float[Array, ""]:
    """Return the diameter of the ball with the tumour's radius of gyration.

    It is 2 √(5/3) R_g + 1, with one particle added.
    """
    tumour = _is_tumour(particles)[:, None]
    position = particles.position
    number = jnp.maximum(jnp.sum(tumour.astype(position.dtype)), 1)
    centre = jnp.sum(jnp.where(tumour, position, 0), axis=0) / number
    square = jnp.sum(jnp.where(tumour, position - centre[None, :], 0) ** 2) / number
    some = square > 0
    root = jnp.where(some, jnp.sqrt(jnp.where(some, square, 1)), 0)
    return jnp.where(jnp.any(tumour), 2 * jnp.sqrt(5 / 3) * root + 1, 0)
