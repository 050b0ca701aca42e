"""Colours and light: key light, fill light, rim light and sky."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from jaxgrow.render.camera import Camera
from jaxgrow.render.scene import Balls, DrawnSurface
from jaxgrow.render.view import chunks, EVERY, interpolate, View


MUCOSA = (233, 168, 152)
LESION = (196, 56, 66)
TISSUE_TINT = (250, 241, 235)
CUT_HEALTHY = (96, 62, 56)
CUT_LESION = (176, 0, 58)
# Pale tissue and a dark, saturated tumour differ in lightness as much as in hue, so the
# two species are distinct for colour-blind readers and in grey print. The others are
# Okabe and Ito's.
SPECIES = (
    (236, 219, 190),
    (200, 70, 14),
    (0, 114, 178),
    (0, 158, 115),
    (204, 121, 167),
)


def linear(colour: tuple[int, int, int]) -> Float32[np.ndarray, "3"]:
    """Convert an sRGB colour to linear light."""
    return ((np.array(colour, np.float32) / 255) ** 2.2).astype(np.float32)


def encode(
    light: Float32[np.ndarray, "p 3"], camera: Camera
) -> UInt8[np.ndarray, "a a 3"]:
    """Average each pixel's samples and encode them as 8-bit sRGB."""
    small = camera.pixels // EVERY
    pixel = np.clip(light, 0, 1).reshape(small, EVERY, small, EVERY, 3)
    mean = sum(pixel[:, i, :, j] for i, j in np.ndindex(EVERY, EVERY)) / EVERY**2
    return np.round(255 * mean ** (1 / 2.2)).astype(np.uint8)


def key_light(camera: Camera) -> Float[np.ndarray, "3"]:
    """Return the unit vector towards the key light, at the upper left."""
    return _towards(camera, -0.45, 0.62, 0.64)


def _towards(
    camera: Camera, right: float, up: float, back: float
) -> Float[np.ndarray, "3"]:
    vector = right * camera.right + up * camera.up - back * camera.forward
    return vector / np.linalg.norm(vector)


def shade(
    view: View,
    albedo: Float32[np.ndarray, "h 3"],
    at: Int[np.ndarray, " h"],
    sky: Float32[np.ndarray, " p"],
    key: Float32[np.ndarray, " p"],
    *,
    gloss: float,
) -> Float32[np.ndarray, "h 3"]:
    """Compute the light that samples send to the viewer.

    Args:
        view: The view.
        albedo: Diffuse reflectance of the samples that are shaded.
        at: The samples to shade.
        sky: Openness to the sky of all samples.
        key: Visibility of the key light of all samples.
        gloss: Strength of the highlight.
    """
    light = np.zeros((len(at), 3), np.float32)
    for part in chunks(np.arange(len(at))):
        one = at[part]
        light[part] = _lit(
            view.camera, view.normal[one], albedo[part], sky[one], key[one], gloss
        )
    return light


def _lit(
    camera: Camera,
    normal: Float32[np.ndarray, "k 3"],
    albedo: Float32[np.ndarray, "k 3"],
    sky: Float32[np.ndarray, " k"],
    key: Float32[np.ndarray, " k"],
    gloss: float,
) -> Float32[np.ndarray, "k 3"]:
    main = key_light(camera).astype(np.float32)
    fill = _towards(camera, 0.8, 0.05, 0.6).astype(np.float32)
    half = (main - camera.forward).astype(np.float32)
    half /= np.linalg.norm(half)
    upward = 0.5 + 0.5 * (normal @ camera.up.astype(np.float32))
    facing = np.clip(-(normal @ camera.forward.astype(np.float32)), 0, 1)
    # Light wraps slightly around the edge of shadow, as in wet, soft tissue.
    wrapped = np.clip((normal @ main + 0.2) / 1.2, 0, 1) * (0.35 + 0.65 * key)
    filled = np.clip(normal @ fill, 0, 1) * sky
    diffuse = 0.66 * wrapped + 0.16 * filled + sky * (0.26 + 0.12 * upward)
    # Interreflected light takes on the colour of the neighbours.
    bounced = albedo * (0.10 * (1 - sky))[:, None] * albedo
    rim = 0.10 * (1 - facing) ** 3 * sky * upward
    shine = gloss * np.clip(normal @ half, 0, 1) ** 48 * key
    # Dim light is redder: tissue transmits red light from its surroundings.
    warm = np.clip(diffuse, 0.05, 1)[:, None] ** np.array([0, 0.28, 0.3], np.float32)
    return albedo * warm * diffuse[:, None] + bounced + (rim + shine)[:, None]


def surface_albedo(
    view: View,
    surface: DrawnSurface,
    at: Int[np.ndarray, " h"],
    *,
    line: float,
) -> Float32[np.ndarray, "h 3"]:
    """Return mucosa and lesion colours, blended by label, with mesh edges.

    Args:
        view: The view.
        surface: The mesh.
        at: Samples that see it.
        line: Width of the edges in samples; 0 draws none.
    """
    corner = surface.label[surface.faces].astype(np.float32)
    height = _heights(view, surface) if line > 0 else None
    healthy, lesion = linear(MUCOSA), linear(LESION)
    colour = np.zeros((len(at), 3), np.float32)
    for part in chunks(np.arange(len(at))):
        label = interpolate(view.hits, at[part], corner)
        label = (label * label * (3 - 2 * label))[:, None]
        colour[part] = healthy + label * (lesion - healthy)
        if height is not None:
            edges = _edges(view, at[part], height, line)
            colour[part] *= 1 - 0.42 * edges[:, None]
    return colour


def _heights(view: View, surface: DrawnSurface) -> Float32[np.ndarray, "f 3"]:
    """Compute the heights of the triangles in the picture, in samples.

    There is one over each side.
    """
    corner = view.camera.to_view(surface.vertices)[surface.faces][..., :2]
    side = np.roll(corner, -1, axis=1) - np.roll(corner, -2, axis=1)
    area = np.abs(side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0])
    length = np.linalg.norm(side, axis=-1)
    return (area[:, None] / np.maximum(length, 1e-12)).astype(np.float32)


def _edges(
    view: View,
    at: Int[np.ndarray, " h"],
    height: Float32[np.ndarray, "f 3"],
    line: float,
) -> Float32[np.ndarray, " h"]:
    """Return the ink of edges: 1 on an edge, 0 away from it.

    It is fainter where triangles are tiny in the picture.
    """
    u, v = view.hits.u[at], view.hits.v[at]
    tall = height[view.hits.face[at]]
    distance = np.minimum((1 - u - v) * tall[:, 0], u * tall[:, 1])
    distance = np.minimum(distance, v * tall[:, 2])
    faint = np.clip(tall.min(axis=1) / (5 * line), 0.15, 1)
    # Within smooth patches a pixel has only one sample: blur the line over a pixel.
    return faint * np.clip((line / 2 - distance) / EVERY + 0.5, 0, 1)


def ball_albedo(
    view: View, balls: Balls, at: Int[np.ndarray, " h"]
) -> Float32[np.ndarray, "h 3"]:
    """Return the colours of the balls that samples see."""
    return species_light(balls.species[view.thing[at] - 1])


def species_light(species: Int[np.ndarray, " h"]) -> Float32[np.ndarray, "h 3"]:
    """Return the colours of species, as linear light."""
    palette = np.stack([linear(colour) for colour in SPECIES])
    return palette[_palette_index(species)]


def species_colour(species: int) -> tuple[int, int, int]:
    """Return the sRGB colour of a species."""
    return SPECIES[int(_palette_index(np.array([species]))[0])]


def _palette_index(species: Int[np.ndarray, " h"]) -> Int[np.ndarray, " h"]:
    """Return the palette index of species; it repeats after the tumour."""
    beyond = 2 + (species - 2) % (len(SPECIES) - 2)
    return np.where(species < 2, species, beyond)
