"""View of a scene: object, depth and normal at each sample."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int

from jaxgrow.render.camera import Camera, unit
from jaxgrow.render.scene import ball_triangles, Balls, DrawnSurface
from jaxgrow.render.trace import Hits, make_tracer, no_hits, Tracer


# Samples along a pixel's side.
EVERY = 2

_CHUNK = 1 << 16


@dataclass(frozen=True)
class View:
    """View of the samples of a picture, row by row.

    Attributes:
        camera: The camera.
        tracer: Casts further rays into the same scene.
        hits: Triangles and distances; triangles of balls follow those of the surface.
        thing: -1 nothing, 0 the surface, 1 + k ball k.
        normal: Unit normal that faces the viewer.
        inward: Whether the surface's normal points away from the viewer.
        traced: Which samples were traced. In a pixel within one smooth patch only the
            first is, and represents the others.
    """

    camera: Camera
    tracer: Tracer
    hits: Hits
    thing: Int[np.ndarray, " p"]
    normal: Float32[np.ndarray, "p 3"]
    inward: Bool[np.ndarray, " p"]
    traced: Bool[np.ndarray, " p"]

    def seeing(self, thing: Bool[np.ndarray, " p"]) -> Int[np.ndarray, " h"]:
        """Return the traced samples among some."""
        return np.flatnonzero(thing & self.traced)

    def points(self, at: Int[np.ndarray, " h"]) -> Float32[np.ndarray, "h 3"]:
        """Return the points that samples see, relative to the camera's centre, mm."""
        return self.camera.points(at, self.hits.distance[at])

    def spread(self, light: Float32[np.ndarray, "p 3"]) -> None:
        """Copy the light of a pixel's first sample to its untraced samples."""
        small = self.camera.pixels // EVERY
        pixel = light.reshape(small, EVERY, small, EVERY, 3)
        traced = self.traced.reshape(small, EVERY, small, EVERY)
        for down, across in np.ndindex(EVERY, EVERY):
            plain = ~traced[:, down, :, across]
            pixel[:, down, :, across][plain] = pixel[:, 0, :, 0][plain]


def see(surface: DrawnSurface, balls: Balls, camera: Camera) -> View:
    """Trace the samples of a camera.

    One sample of each pixel is traced first, and the others only where neighbouring
    pixels see different objects: at silhouettes, where steps would show.

    Args:
        surface: The mesh; it may have no triangles.
        balls: The particles; there may be none.
        camera: The camera. Objects in front of its rays' starts are not seen.
    """
    triangles, owner = ball_triangles(balls, camera)
    triangles = np.concatenate([surface.vertices[surface.faces], triangles])
    view = _blank(camera, make_tracer(triangles, camera.centre))
    things = np.concatenate([np.zeros(len(surface.faces), np.int64), 1 + owner])
    away = np.zeros(len(things), bool)
    away[: len(surface.faces)] = surface.area_vectors @ camera.forward > 0
    everything = np.arange(camera.pixels**2)
    if view.tracer.at_once:
        _trace(view, everything, things, away)
    else:
        grid = everything.reshape(camera.pixels, -1)
        _trace(view, grid[::EVERY, ::EVERY].ravel(), things, away)
        rough = _silhouettes(view).repeat(EVERY, axis=0).repeat(EVERY, axis=1)
        _trace(view, np.flatnonzero(rough.ravel() & ~view.traced), things, away)
    _surface_normals(view, surface)
    _ball_normals(view, balls)
    return view


def _blank(camera: Camera, tracer: Tracer) -> View:
    samples = camera.pixels**2
    return View(
        camera,
        tracer,
        no_hits(samples),
        np.full(samples, -1),
        np.zeros((samples, 3), np.float32),
        np.zeros(samples, bool),
        np.zeros(samples, bool),
    )


def _trace(
    view: View,
    at: Int[np.ndarray, " h"],
    things: Int[np.ndarray, " t"],
    away: Bool[np.ndarray, " t"],
) -> None:
    """Trace samples and store their hits in the view.

    Args:
        view: The view, changed in place.
        at: The samples.
        things: The object of each triangle.
        away: Which of the surface's triangles turn their back to the viewer.
    """
    found = view.tracer.first_hit(view.camera, at)
    view.hits.face[at], view.hits.distance[at] = found.face, found.distance
    view.hits.u[at], view.hits.v[at] = found.u, found.v
    hit = found.face >= 0
    view.thing[at[hit]] = things[found.face[hit]]
    view.inward[at[hit]] = away[found.face[hit]]
    view.traced[at] = True


def _silhouettes(view: View) -> Bool[np.ndarray, "a a"]:
    """Mark the pixels with a neighbour of other object, side, or depth."""
    side = view.camera.pixels
    thing, inward, distance = (
        values.reshape(side, side)[::EVERY, ::EVERY]
        for values in (view.thing, view.inward, view.hits.distance)
    )
    depth = np.where(thing < 0, 0, distance)
    step = 6 * EVERY * view.camera.pitch
    rough = np.zeros(thing.shape, bool)
    for here, there in (
        ((slice(1, None), slice(None)), (slice(-1), slice(None))),
        ((slice(None), slice(1, None)), (slice(None), slice(-1))),
    ):
        jump = (thing[here] != thing[there]) | (inward[here] != inward[there])
        jump |= np.abs(depth[here] - depth[there]) > step
        rough[here] |= jump
        rough[there] |= jump
    return rough


def _surface_normals(view: View, surface: DrawnSurface) -> None:
    """Interpolate vertex normals, and turn them to the viewer."""
    forward = view.camera.forward.astype(np.float32)
    # The flat normal decides on the side: near a silhouette the smooth one may already
    # point away although the triangle is seen from its front.
    corner = surface.normal[surface.faces].astype(np.float32)
    corner[surface.area_vectors @ view.camera.forward > 0] *= -1
    for at in chunks(view.seeing(view.thing == 0)):
        normal = interpolate(view.hits, at, corner)
        depth = normal @ forward
        normal -= np.maximum(depth, 0)[:, None] * forward
        view.normal[at] = unit(normal)


def _ball_normals(view: View, balls: Balls) -> None:
    centre = (balls.centre - view.camera.centre).astype(np.float32)
    for at in chunks(view.seeing(view.thing > 0)):
        view.normal[at] = unit(view.points(at) - centre[view.thing[at] - 1])


def chunks(at: Int[np.ndarray, " h"]) -> Iterator[Int[np.ndarray, " k"]]:
    """Split a list of samples into parts that fit into the CPU's cache."""
    return (at[start : start + _CHUNK] for start in range(0, len(at), _CHUNK))


def interpolate(
    hits: Hits, at: Int[np.ndarray, " h"], corner: Float32[np.ndarray, "f 3 *c"]
) -> Float32[np.ndarray, "h *c"]:
    """Interpolate values at hit points from the triangles' corners."""
    shape = (-1,) + (1,) * (corner.ndim - 2)
    face = hits.face[at]
    u, v = hits.u[at].reshape(shape), hits.v[at].reshape(shape)
    first, second, third = (corner[:, number][face] for number in range(3))
    return first + u * (second - first) + v * (third - first)
