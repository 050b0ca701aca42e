r"""Shape metrics of a lesion, computed from the state alone.

*Height* is measured along the normal of the former surface at the site, lengths and
widths along and across the lesion's own axis, from its base ring to its tip
(`jaxgrow.metrics.axis`). The *raised* surface lies more than half an r0 above the
former surface; the part between a quarter and half an r0 above it counts in part, so
that metrics are continuous in the positions. All that is raised on a patch is taken for
one lesion.

The volume is the one enclosed between the grown and the former surface of the patch:
they share their rim, so the difference of their cone volumes
:math:`\frac16 \sum_t x_a \cdot (x_b \times x_c)` is exact.
"""

import math
from dataclasses import fields
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.equilibrium.transformations import (
    check_undifferentiated,
    is_differentiated,
)
from jaxgrow.metrics.axis import angle_between, Axis, axis_of, length_of, Raised
from jaxgrow.metrics.body import body_of, gyration_diameter, tumour_of
from jaxgrow.metrics.curvature import mean_and_spread, mean_curvature
from jaxgrow.metrics.elevation import (
    height_above,
    height_and_direction,
    RAISED,
    raisedness,
    smoothstep,
)
from jaxgrow.metrics.extent import height_of
from jaxgrow.metrics.extremes import largest, temperature
from jaxgrow.metrics.field import Patches, patches_of, rise
from jaxgrow.metrics.profile import lengths_of, profile_of
from jaxgrow.metrics.ring import contact_angle, Ring, ring_of
from jaxgrow.metrics.sections import diameters, Sections, sections_of
from jaxgrow.numerics.capacity import capacity_for
from jaxgrow.numerics.guards import check_precision, safe_divide, safe_norm
from jaxgrow.state import FormerSurface, Membrane, Particles, replaced, State


_TIP = 1.0  # r0 below the tip to which the surface belongs to it
_NECK = 0.5  # r0 above and below a section of the neck to which it belongs to that
_NECKED = 1.0  # r0 above which a height makes necks count, in full one r0 higher
_NARROW = 0.1  # a section this much wider (r0) than the neck counts 1/e as neck
_LOCATING = 0.25  # smoothing in r0 of where the neck is, in all versions
_STEEPEST = 0.5  # least cosine of the lean at which the foot is extended along the axis


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
        height_mm: of the highest raised vertex over the site, along the normal.
        length_mm: of the axis, from the former surface to the tip; in part as long as
            the lesion is not an r0 high.
        width_mm: diameter of the circle with the area of the head's widest
            cross-section, across the axis; without a neck that is the base
            (`jaxgrow.metrics.profile`).
        neck_width_mm: the same of the narrowest cross-section below the head; of a
            sessile lesion that is its base. It counts in full where the lesion is 2 r0
            high, and not at all up to one r0, where the base ring is ragged: such a
            lesion is as wide as its base.
        base_width_mm: diameter of the circle with the area of the base ring, half an
            r0 above the former surface.
        head_length_mm: length of the axis above the stalk; of all of it without one.
        stalk_length_mm: length of the axis below the head where cross-sections are at
            most as wide as halfway between neck and head. It counts in full where the
            neck is at most 0.85 of the width, and not at all from 0.95 on.
        height_to_width: height over width, dimensionless; 0 without a width.
        length_to_width: length over width, dimensionless; 0 without a width.
        neck_to_width: neck width over width, dimensionless; 0 without a width.
        lean_deg: angle of the chord from base to tip with the normal.
        bend_deg: turning of the axis from base to tip; 3/2 of the angle between its
            first and last third.
        contact_angle_deg: between the lesion's and the former surface at the contact
            line, in the cavity: under 90 the lesion overhangs, 180 is flat
            (`jaxgrow.metrics.ring.contact_angle`).
        volume_mm3: enclosed between the grown and the former surface of the patch.
        area_mm2: of the raised surface.
        sphericity: :math:`\pi^{1/3} (6 V)^{2/3} / A` with the volume V that the raised
            surface and its base ring close off, and the area A of that body; at most 1,
            0 if nothing is raised.
        intracavitary_fraction: share of the tumour's volume above the former surface,
            the measure of FIGO's types 0 (all), 1 (at least half) and 2. Each tumour
            particle is a ball with a diameter of r0, of which the plane through its
            nearest point of the former surface cuts off :math:`h^2 (3 - 2h)`.
        intracavitary_diameter_fraction: share of the tumour's extent across the former
            surface, from its deepest to its highest ball, that is above it.
        tip_curvature_per_mm: near the tip, down to one r0 below it along the axis.
        tip_curvature_spread_per_mm: its spread.
        neck_curvature_per_mm: near the neck, up to half an r0 above and below it; all
            sections are the neck in proportion to :math:`e^{-10 c}`, with their
            diameter c as a neck in r0 (`jaxgrow.metrics.profile`).
        neck_curvature_spread_per_mm: its spread.
        tumour_diameter_mm: of the ball with the tumour's radius of gyration.
        body_diameter_mm: largest extent of the tumour's particles, as balls with a
            diameter of r0 (`jaxgrow.metrics.body`).
        body_equivalent_diameter_mm: of the ball with the volume of their convex hull.
        body_sphericity: of their convex hull, at most 1.
    """

    height_mm: Float[Array, ""]
    length_mm: Float[Array, ""]
    width_mm: Float[Array, ""]
    neck_width_mm: Float[Array, ""]
    base_width_mm: Float[Array, ""]
    head_length_mm: Float[Array, ""]
    stalk_length_mm: Float[Array, ""]
    height_to_width: Float[Array, ""]
    length_to_width: Float[Array, ""]
    neck_to_width: Float[Array, ""]
    lean_deg: Float[Array, ""]
    bend_deg: Float[Array, ""]
    contact_angle_deg: Float[Array, ""]
    volume_mm3: Float[Array, ""]
    area_mm2: Float[Array, ""]
    sphericity: Float[Array, ""]
    intracavitary_fraction: Float[Array, ""]
    intracavitary_diameter_fraction: Float[Array, ""]
    tip_curvature_per_mm: Float[Array, ""]
    tip_curvature_spread_per_mm: Float[Array, ""]
    neck_curvature_per_mm: Float[Array, ""]
    neck_curvature_spread_per_mm: Float[Array, ""]
    tumour_diameter_mm: Float[Array, ""]
    body_diameter_mm: Float[Array, ""]
    body_equivalent_diameter_mm: Float[Array, ""]
    body_sphericity: Float[Array, ""]

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

    Height, length, width, neck width and body diameter are maxima and minima over
    vertices, cross-sections and particles. Exact, they are continuous and have a kink
    where two candidates tie. Smooth, the candidates near the extreme share its
    derivative (`jaxgrow.metrics.extremes`), at an error that is bounded: with the
    smoothing :math:`\epsilon`, in r0, height, length, width and body diameter are

    .. math::
        0 \le \tilde h - h \le \epsilon, \qquad
        -\tfrac23 \epsilon \le \tilde n - n \le \epsilon

    with the neck width n. Ratios, the lengths of head and stalk, and the share of the
    diameter follow from the smooth lengths. The other metrics do not depend on the
    smoothing; what is undefined as long as nothing is raised (widths, lengths along
    the axis, ratios, sphericity, angles and curvatures) begins with a jump, and the
    lengths of head and stalk jump where another section becomes the neck. Kinks remain
    where a point has two nearest points on the former surface.

    Derivatives are those of the axis too: nothing is held fixed.

    On meshes as fine as membranes (sides of 0.8 r0) lengths, widths, areas and volumes
    of sphere caps, cylinders, mushrooms and tori, upright, leaning or bent, are within
    3 % of their closed forms; a lean is within 2°. The bend of an arc is within 12°; of
    a bend in the stalk alone only a part is seen. The curvature of the neck, a mean
    over its surroundings, is within 12 % on a cylinder and within 0.025 per r0 on a
    torus.

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
    state, copies = _with_few_shapes(state)
    smooth = jnp.asarray(smoothing, dtype) if smoothing else None
    return _shape_metrics(state, smooth, jnp.asarray(copies))


def _with_few_shapes(state: State) -> tuple[State, int]:
    """Pad the former surface, so that lesions share their compiled programs.

    Returns:
        The state, and the number of copies of the first face at the end of the former
        surface's, which change no distance.
    """
    particles = _with_slots(state.particles)
    former = state.frame.former
    if former is None:
        return State(particles, state.membrane, state.frame), 0
    rows, count = former.vertices.shape[0], former.faces.shape[0]
    vertices = capacity_for(rows, 256) - rows
    copies = capacity_for(count, 512) - count
    first = jnp.broadcast_to(former.faces[:1], (copies, 3))
    padded = FormerSurface(
        jnp.pad(former.vertices, ((0, vertices), (0, 0))),
        jnp.concatenate([former.faces, first]),
    )
    frame = replaced(state.frame, former=padded)
    return State(particles, state.membrane, frame), copies


def _with_slots(particles: Particles) -> Particles:
    """Pad particles to a capacity that many lesions have."""
    count = particles.position.shape[0]
    more = capacity_for(count, 512) - count
    return jax.tree.map(
        lambda rows: jnp.pad(rows, ((0, more),) + ((0, 0),) * (rows.ndim - 1)),
        particles,
    )


def _shape_metrics(
    state: State, smoothing: Float[Array, ""] | None, copies: Int[Array, ""]
) -> ShapeMetrics:
    mm, former = state.frame.particle_mm, state.frame.former
    of_tumour = _of_tumour(state.particles, former, mm, smoothing)
    if state.membrane is None or former is None:
        names = {field.name for field in fields(ShapeMetrics)} - set(of_tumour)
        nan = jnp.full_like(mm, jnp.nan)
        return ShapeMetrics(**dict.fromkeys(names, nan), **of_tumour)
    form = _form_of(state.membrane, former, state.frame.axis)
    of_surface = _of_surface(form, former, copies, mm, smoothing)
    return ShapeMetrics(**of_surface, **of_tumour)


class _Form(NamedTuple):
    """Lesion's surface with its axis.

    Attributes:
        above: height of each vertex above the former surface.
        gradient: of the height.
        patches: areas of the triangles.
        ring: round the base.
        lesion: raised part of the surface.
        axis: of the lesion.
    """

    above: Float[Array, " m"]
    gradient: Float[Array, "m 3"]
    patches: Patches
    ring: Ring
    lesion: Raised
    axis: Axis


# Three programs compile in half the time of one.
@eqx.filter_jit
def _form_of(
    membrane: Membrane, former: FormerSurface, normal: Float[Array, "3"]
) -> _Form:
    above, gradient = height_and_direction(membrane.vertices, former)
    raised = jnp.where(membrane.vertex_alive, raisedness(above), 0)
    patches = patches_of(membrane)
    ring = ring_of(membrane, patches, above)
    risen = rise(membrane, patches.share, raised)
    lesion = Raised(membrane, raised, risen, ring.area, ring.centre, normal)
    return _Form(above, gradient, patches, ring, lesion, axis_of(lesion))


@eqx.filter_jit
def _of_tumour(
    particles: Particles,
    former: FormerSurface | None,
    mm: Float[Array, ""],
    smoothing: Float[Array, ""] | None,
) -> dict[str, Float[Array, ""]]:
    """Compute the metrics of the tumour's particles."""
    body = body_of(particles, smoothing)
    found = {
        "tumour_diameter_mm": mm * gyration_diameter(particles),
        "body_diameter_mm": mm * body.diameter,
        "body_equivalent_diameter_mm": mm * body.equivalent_diameter,
        "body_sphericity": body.sphericity,
    }
    if former is not None:
        fraction, linear_fraction = _above(particles, former, smoothing)
        found["intracavitary_fraction"] = fraction
        found["intracavitary_diameter_fraction"] = linear_fraction
    return found


@eqx.filter_jit
def _of_surface(
    form: _Form,
    former: FormerSurface,
    copies: Int[Array, ""],
    mm: Float[Array, ""],
    smoothing: Float[Array, ""] | None,
) -> dict[str, Float[Array, ""]]:
    """Compute the metrics of the surface."""
    lesion, axis, ring, above = form.lesion, form.axis, form.ring, form.above
    membrane, normal = lesion.membrane, lesion.normal
    sections = sections_of(membrane, form.patches, axis, above, lesion.raised)
    profile = profile_of(sections.diameter, smoothing)

    begins = axis.tangent[0]
    highest = jnp.max(jnp.where(membrane.vertex_alive, above, 0))
    whole = jnp.clip(highest / RAISED - 1, 0, 1)
    foot = whole * RAISED / jnp.maximum(begins @ normal, _STEEPEST)
    reach = whole * length_of(lesion, axis, smoothing)
    necked = smoothstep(highest - _NECKED)
    neck = profile.width - necked * (profile.width - profile.neck)
    profile = profile._replace(neck=neck)
    lengths = lengths_of(profile, sections.diameter, reach, foot)
    height = height_of(membrane, above, normal, smoothing)
    length, width = reach + foot, profile.width
    lean = angle_between(axis.tip - (ring.centre - foot * begins), normal)

    weights = _near_tip_and_neck(lesion, axis, sections)
    curved = mean_curvature(membrane.vertices, membrane.faces, membrane.face_alive)
    tip, tip_spread = mean_and_spread(*curved, weights[0])
    at_neck, neck_spread = mean_and_spread(*curved, weights[1])
    enclosed = _cone_volume(membrane.vertices[membrane.faces], membrane.face_alive)
    angle = contact_angle(membrane, form.patches, above, form.gradient)
    return {
        "height_mm": mm * height,
        "length_mm": mm * length,
        "width_mm": mm * width,
        "neck_width_mm": mm * profile.neck,
        "base_width_mm": mm * diameters(safe_norm(ring.vector)),
        "head_length_mm": mm * lengths.head,
        "stalk_length_mm": mm * lengths.stalk,
        "height_to_width": safe_divide(height, width, width > 0),
        "length_to_width": safe_divide(length, width, width > 0),
        "neck_to_width": safe_divide(profile.neck, width, width > 0),
        "lean_deg": jnp.degrees(lean),
        "bend_deg": jnp.degrees(axis.bend),
        "contact_angle_deg": angle,
        "volume_mm3": mm**3 * (enclosed - _under(former, copies)),
        "area_mm2": mm**2 * ring.area,
        "sphericity": ring.sphericity,
        "tip_curvature_per_mm": tip / mm,
        "tip_curvature_spread_per_mm": tip_spread / mm,
        "neck_curvature_per_mm": at_neck / mm,
        "neck_curvature_spread_per_mm": neck_spread / mm,
    }


def _near_tip_and_neck(
    lesion: Raised, axis: Axis, sections: Sections
) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """Compute the weight of each vertex as a part of tip and of neck."""
    counted = profile_of(sections.diameter, _LOCATING).counted
    narrow = jax.nn.softmax(-counted / _NARROW)
    at_neck = narrow @ _bump(sections.distance / _NECK)
    at_tip = _bump(
        axis.distances(lesion.membrane.vertices, axis.length[None])[0] / _TIP
    )
    return lesion.raised * at_tip, lesion.raised * at_neck


def _bump(u: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Return (1 - u²)², cut off at 1: continuously differentiable."""
    return jnp.maximum(1 - u**2, 0) ** 2


def _cone_volume(
    corners: Float[Array, "f 3 3"], alive: Bool[Array, " f"]
) -> Float[Array, ""]:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    each = jnp.sum(a * jnp.cross(b, c), axis=1) / 6
    return jnp.sum(jnp.where(alive, each, 0))


def _under(former: FormerSurface, copies: Int[Array, ""]) -> Float[Array, ""]:
    corners = former.vertices[former.faces]
    real = jnp.arange(corners.shape[0]) < corners.shape[0] - copies
    return _cone_volume(corners, real)


def _above(
    particles: Particles, former: FormerSurface, smoothing: Float[Array, ""] | None
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return the shares of the tumour above the former surface.

    That of its balls' volume, and that of its extent across the surface.
    """
    tumour = tumour_of(particles)
    some = jnp.any(tumour)
    height = height_above(particles.position, former)
    share = smoothstep(height + 0.5)
    number = jnp.sum(tumour.astype(share.dtype))
    fraction = jnp.sum(jnp.where(tumour, share, 0)) / jnp.maximum(number, 1)
    warmth = temperature(smoothing, number)
    over, under = (
        jnp.maximum(largest(sign * height, tumour | ~some, warmth) + 0.5, 0)
        for sign in (1, -1)
    )
    return fraction, safe_divide(over, over + under, some & (over + under > 0))
