"""Panels of a growth's picture: surface view and inner view."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from jaxgrow.render import shading
from jaxgrow.render.camera import Camera
from jaxgrow.render.cut import behind_plane, cut_faces_of_balls, cut_line, stroke
from jaxgrow.render.occlusion import occlusion
from jaxgrow.render.scene import Balls, DrawnSurface
from jaxgrow.render.subject import cut_camera, oblique_camera, open_surface, Subject
from jaxgrow.render.view import EVERY, see, View


# Width of the mesh's edges in samples: one pixel.
_LINE = float(EVERY)


def surface_panel(subject: Subject, size: int) -> UInt8[np.ndarray, "a a 3"]:
    """Draw the lesion on the organ's free surface, or a free cluster."""
    camera = oblique_camera(subject, size * EVERY)
    surface = open_surface(subject.surface, camera, subject.lumen)
    balls = subject.balls.part(np.full(len(subject.balls.centre), subject.free))
    view = see(surface, balls, camera)
    light = lit(view, surface, balls, reach=0.14 * subject.field, line=_LINE)
    if subject.embedded:
        light[view.thing < 0] = shading.linear(shading.TISSUE_TINT)
    view.spread(light)
    return shading.encode(light, camera)


def inner_panel(subject: Subject, size: int) -> UInt8[np.ndarray, "a a 3"]:
    """Draw the lesion cut open, with the particles in and behind the plane."""
    camera = cut_camera(subject, size * EVERY)
    balls = behind_plane(subject.balls, camera)
    view = see(subject.surface, balls, camera)
    light = lit(view, subject.surface, balls, reach=0.14 * subject.field, line=_LINE)
    _pale_walls(light, view, subject)
    view.spread(light)
    _cut_balls(light, balls, camera)
    _membrane(light, subject.surface, camera, width=0.006 * camera.pixels)
    return shading.encode(light, camera)


def lit(
    view: View, surface: DrawnSurface, balls: Balls, *, reach: float, line: float
) -> Float32[np.ndarray, "p 3"]:
    """Shade the traced samples of surface and balls, on white.

    Args:
        view: The view.
        surface: The mesh.
        balls: The particles.
        reach: Largest distance at which an object darkens another, mm.
        line: Width of the mesh's edges in samples; 0 draws none.
    """
    light = np.ones((len(view.thing), 3), np.float32)
    key_light = shading.key_light(view.camera)
    sky, key = occlusion(view, key_light, reach=reach)
    at = view.seeing(view.thing == 0)
    if len(at):
        albedo = shading.surface_albedo(view, surface, at, line=line)
        light[at] = shading.shade(view, albedo, at, sky, key, gloss=0.16)
    at = view.seeing(view.thing > 0)
    if len(at):
        albedo = shading.ball_albedo(view, balls, at)
        light[at] = shading.shade(view, albedo, at, sky, key, gloss=0.06)
    return light


def _pale_walls(
    light: Float32[np.ndarray, "p 3"], view: View, subject: Subject
) -> None:
    """Fade the walls behind the cut, and tint the tissue between them."""
    wall = view.thing == 0
    free = wall & (view.inward == (subject.lumen < 0))
    light[free] = 0.45 + 0.55 * light[free]
    tissue = wall & ~free
    if subject.embedded:
        tissue |= view.thing < 0
    light[tissue] = shading.linear(shading.TISSUE_TINT)


def _cut_balls(light: Float32[np.ndarray, "p 3"], balls: Balls, camera: Camera) -> None:
    """Draw the discs in which the plane cuts balls, with a thin dark border."""
    sample, owner, inside = cut_faces_of_balls(balls, camera)
    colour = shading.species_light(balls.species[owner])
    border = np.clip(1.1 * EVERY - inside, 0, 1)
    border = np.maximum(border, _between(sample, owner, camera.pixels))
    light[sample] = colour * (1 - 0.65 * border[:, None])


def _between(
    sample: Int[np.ndarray, " c"], owner: Int[np.ndarray, " c"], side: int
) -> Float[np.ndarray, " c"]:
    """Mark the samples of a disc that touch another disc."""
    whose = np.full((side, side), -1)
    whose.ravel()[sample] = owner
    other = np.zeros((side, side), bool)
    for axis in (0, 1):
        differs = np.diff(whose, axis=axis) != 0
        low = [slice(None), slice(None)]
        high = [slice(None), slice(None)]
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        other[tuple(low)] |= differs
        other[tuple(high)] |= differs
    return other.ravel()[sample].astype(np.float64)


def _membrane(
    light: Float32[np.ndarray, "p 3"],
    surface: DrawnSurface,
    camera: Camera,
    width: float,
) -> None:
    """Draw the line in which the plane cuts the surface."""
    segments, lesion = cut_line(surface, camera)
    inks = ((~lesion, shading.CUT_HEALTHY), (lesion, shading.CUT_LESION))
    for chosen, colour in inks:
        cover = stroke(segments[chosen], width, camera.pixels)[:, None]
        light *= 1 - cover
        light += cover * shading.linear(colour)
