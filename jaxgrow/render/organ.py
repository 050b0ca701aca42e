"""Picture of a whole organ."""

from __future__ import annotations

import os

import numpy as np
from jaxtyping import Float, Float32, Integer, UInt8

from jaxgrow.render import annotate, shading
from jaxgrow.render.camera import Camera, look
from jaxgrow.render.checks import check_mesh, check_size
from jaxgrow.render.panels import lit
from jaxgrow.render.scene import Balls, DrawnSurface, Labels, make_surface
from jaxgrow.render.view import EVERY, see


_VIEWS = {
    "front": ((0, 1, 0), (0, 0, 1)),
    "back": ((0, -1, 0), (0, 0, 1)),
    "left": ((1, 0, 0), (0, 0, 1)),
    "right": ((-1, 0, 0), (0, 0, 1)),
    "top": ((0, 0, -1), (0, 1, 0)),
    "bottom": ((0, 0, 1), (0, 1, 0)),
}


def render_surface(
    path: str | os.PathLike[str],
    vertices: Float[np.ndarray, "m 3"],
    faces: Integer[np.ndarray, "f 3"],
    label: Labels | None = None,
    *,
    view: str | Float[np.ndarray, "3"] = "front",
    inside: bool = False,
    wireframe: bool = True,
    caption: str | None = None,
    size: int = 900,
) -> None:
    """Write a PNG of a whole organ.

    Args:
        path: The PNG file, written atomically.
        vertices: The organ's vertices, mm.
        faces: Its triangles, normals outward.
        label: 1 for vertices of a lesion; None: all healthy.
        view: ``front`` (looking along y, z up), ``back``, ``left``, ``right``, ``top``,
            ``bottom``, or the direction in which to look.
        inside: Show the near wall as a transparent shell, and the inner surface behind
            it, where the lesions of a hollow organ are.
        wireframe: Draw the triangles' edges.
        caption: A line under the picture.
        size: Side of the picture, pixels.

    Raises:
        ValueError: The view is unknown, or the arrays are not a mesh.
    """
    check_size(size)
    label = np.zeros(len(vertices), np.int64) if label is None else np.asarray(label)
    check_mesh(vertices, faces, label)
    surface = make_surface(vertices, faces, label)
    camera = _whole(surface, view, size * EVERY)
    line = 0.7 * EVERY if wireframe else 0.0
    light = _shell(surface, camera, line) if inside else _lit(surface, camera, line)
    panel = _trimmed(shading.encode(light, camera))
    annotate.write_page(path, [panel], field=camera.width, entries=[], caption=caption)


def _whole(
    surface: DrawnSurface, view: str | Float[np.ndarray, "3"], pixels: int
) -> Camera:
    """Make a camera that sees the whole surface."""
    if isinstance(view, str):
        if view not in _VIEWS:
            raise ValueError(f"unknown view {view!r}; use one of {', '.join(_VIEWS)}.")
        forward, upward = (np.array(vector, float) for vector in _VIEWS[view])
    else:
        forward, upward = np.asarray(view, float), np.array([0.0, 0.0, 1.0])
        if not np.linalg.norm(forward) > 0:
            raise ValueError("the view's direction must not be zero.")
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    centre = (low + high) / 2
    camera = look(centre, forward, upward, width=1.0, pixels=pixels, reach=0.0)
    offset = np.abs(surface.vertices - centre)
    frame = np.stack([camera.right, camera.up])
    field = 2.15 * np.abs((surface.vertices - centre) @ frame.T).max()
    reach = float(offset.sum(axis=1).max()) + 1.0
    return look(centre, forward, upward, width=float(field), pixels=pixels, reach=reach)


def _lit(
    surface: DrawnSurface, camera: Camera, line: float
) -> Float32[np.ndarray, "p 3"]:
    view = see(surface, _no_balls(), camera)
    light = lit(view, surface, _no_balls(), reach=0.08 * camera.width, line=line)
    view.spread(light)
    return light


def _shell(
    surface: DrawnSurface, camera: Camera, line: float
) -> Float32[np.ndarray, "p 3"]:
    """Shade the far wall behind a shell that is opaque only edge-on."""
    near = surface.area_vectors @ camera.forward < 0
    light = _lit(surface.part(~near), camera, line)
    view = see(surface.part(near), _no_balls(), camera)
    at = view.seeing(view.thing == 0)
    facing = np.clip(-(view.normal[at] @ camera.forward.astype(np.float32)), 0, 1)
    cover = np.zeros((len(light), 3), np.float32)
    cover[at] = (0.06 + 0.5 * (1 - facing) ** 3)[:, None]
    view.spread(cover)
    return light + cover * (shading.linear(shading.MUCOSA) - light)


def _trimmed(panel: UInt8[np.ndarray, "a a 3"]) -> UInt8[np.ndarray, "b a 3"]:
    """Crop the white rows above and below a picture, except a margin."""
    inked = np.flatnonzero((panel < 255).any(axis=(1, 2)))
    margin = len(panel) // 40
    first, last = (inked[0], inked[-1]) if len(inked) else (0, len(panel))
    return panel[max(first - margin, 0) : last + margin]


def _no_balls() -> Balls:
    return Balls(np.zeros((0, 3)), np.zeros(0, np.int64), 1.0)
