"""Ambient occlusion and soft shadow by a few short rays for each pixel.

Every pixel of a 4 x 4 block casts other directions of one low-discrepancy set, and the
block's mean is taken over neighbours that see the same object ("interleaved sampling",
Keller and Heidrich 2001): smooth pictures from few rays, with no random numbers.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Float32, Int

from jaxgrow.render.view import chunks, EVERY, View


_BLOCK = 4
_RAYS = 4


def occlusion(
    view: View,
    light: Float[np.ndarray, "3"],
    *,
    reach: float,
) -> tuple[Float32[np.ndarray, " p"], Float32[np.ndarray, " p"]]:
    """Compute the openness of the sky and of the key light at each sample.

    Args:
        view: The view of the samples.
        light: Unit vector towards the key light.
        reach: Largest distance at which an object darkens another, mm.

    Returns:
        Openness to the sky and to the light, both from 0 to 1; 1 throughout if the
        tracer cannot cast such rays.
    """
    side = view.camera.pixels
    # The first sample of every pixel casts rays; the others take over its result.
    probe = np.arange(side * side).reshape(side, side)[::EVERY, ::EVERY]
    seen = np.flatnonzero(view.thing[probe.ravel()] >= 0)
    rays = _cast(view, probe, seen, light, reach)
    if rays is None:
        one = np.ones(side * side, np.float32)
        return one, one
    grid = np.ones((2, probe.size), np.float32)
    grid[:, seen] = rays
    grid = _block_mean(grid.reshape(2, *probe.shape), view, probe, reach)
    sky, key = (_spread(level, view, reach) for level in grid)
    return sky, key


def _cast(
    view: View,
    probe: Int[np.ndarray, "a a"],
    seen: Int[np.ndarray, " h"],
    light: Float[np.ndarray, "3"],
    reach: float,
) -> Float32[np.ndarray, "2 h"] | None:
    """Cast the rays of the probes that see something."""
    block = seen // probe.shape[1] % _BLOCK * _BLOCK + seen % probe.shape[1] % _BLOCK
    result = np.zeros((2, len(seen)), np.float32)
    for part in chunks(np.arange(len(seen))):
        at = probe.ravel()[seen[part]]
        normal = view.normal[at]
        lift = np.float32(0.75 * view.camera.pitch + 2e-3 * reach)
        start = view.points(at) + lift * normal
        beams = [*_sky_beams(normal, block[part]), _light_beam(light, block[part])]
        for number, beam in enumerate(beams):
            length = 4 * reach if number == _RAYS else reach
            hit = view.tracer.blocked(start, beam, _room(view, at, beam, length))
            if hit is None:
                return None
            result[number // _RAYS, part] += ~hit
    result[0] /= _RAYS
    return result


def _room(
    view: View,
    at: Int[np.ndarray, " h"],
    beam: Float32[np.ndarray, "h 3"],
    length: float,
) -> Float32[np.ndarray, " h"]:
    """Return the lengths of rays, cut off where the camera's rays begin.

    Objects in front of that plane are cut away, so they cast no shadow either.
    """
    approach = -(beam @ view.camera.forward.astype(np.float32))
    depth = view.hits.distance[at]
    return np.minimum(
        np.float32(length),
        np.where(approach > 1e-6, depth / np.maximum(approach, 1e-6), np.inf),
    ).astype(np.float32)


def _sky_beams(
    normal: Float32[np.ndarray, "h 3"], block: Int[np.ndarray, " h"]
) -> Iterator[Float32[np.ndarray, "h 3"]]:
    """Yield directions around normals, one set for each place in a block."""
    tangent, bitangent = _frame(normal)
    directions = _hemisphere(_BLOCK**2 * _RAYS)
    for ray in range(_RAYS):
        x, y, z = directions[block + ray * _BLOCK**2].T[..., None]
        yield x * tangent + y * bitangent + z * normal


def _light_beam(
    light: Float[np.ndarray, "3"], block: Int[np.ndarray, " h"]
) -> Float32[np.ndarray, "h 3"]:
    """Return directions to places on the disc of the key light."""
    disc = 0.22 * _hemisphere(_BLOCK**2)[block][:, :2]
    side, across = _frame(light[None].astype(np.float32))
    return light.astype(np.float32) + disc[:, :1] * side + disc[:, 1:] * across


def _hemisphere(count: int) -> Float32[np.ndarray, "k 3"]:
    """Return directions with density cos θ: a Hammersley set on the disc."""
    index = np.arange(count)
    turn = np.zeros(count)
    for bit in range(16):
        turn += (index >> bit & 1) / 2.0 ** (bit + 1)
    radius = np.sqrt((index + 0.5) / count)
    x, y = radius * np.cos(2 * np.pi * turn), radius * np.sin(2 * np.pi * turn)
    return np.stack([x, y, np.sqrt(1 - radius**2)], axis=1).astype(np.float32)


def _frame(
    normal: Float32[np.ndarray, "h 3"],
) -> tuple[Float32[np.ndarray, "h 3"], Float32[np.ndarray, "h 3"]]:
    """Return two unit vectors perpendicular to each normal (Duff et al. 2017)."""
    x, y, z = normal.T
    sign = np.copysign(np.float32(1), z)
    a = -1 / (sign + z)
    b = x * y * a
    first = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1)
    return first, np.stack([b, sign + y * y * a, -y], axis=1)


def _block_mean(
    grid: Float32[np.ndarray, "2 a a"],
    view: View,
    probe: Int[np.ndarray, "a a"],
    reach: float,
) -> Float32[np.ndarray, "2 a a"]:
    """Average over 4 x 4 neighbours with the same object at similar depth."""
    thing, distance = view.thing[probe], _finite(view.hits.distance[probe])
    total, weight = np.zeros_like(grid), np.zeros(probe.shape, np.float32)
    for down in range(-1, _BLOCK - 1):
        for across in range(-1, _BLOCK - 1):
            here, there = _overlap(probe.shape[0], down, across)
            near = np.abs(distance[here] - distance[there]) < 0.3 * reach
            same = near & (thing[here] == thing[there])
            total[:, *here] += same * grid[:, *there]
            weight[here] += same
    return np.where(weight > 0, total / np.maximum(weight, 1), grid)


def _spread(
    level: Float32[np.ndarray, "a a"], view: View, reach: float
) -> Float32[np.ndarray, " p"]:
    """Give traced samples the mean of nearby probes with the same object."""
    side, last = view.camera.pixels, len(level) - 1
    spread = np.ones(side * side, np.float32)
    for at in chunks(view.seeing(view.thing >= 0)):
        row, column = at // side, at % side
        thing, distance = view.thing[at], view.hits.distance[at]
        total = np.zeros(len(at), np.float32)
        weight = np.zeros(len(at), np.float32)
        for down, across in np.ndindex(2, 2):
            y = np.minimum(row // EVERY + down, last)
            x = np.minimum(column // EVERY + across, last)
            probe = EVERY * (y * side + x)
            near = np.abs(_finite(view.hits.distance[probe]) - distance) < 0.3 * reach
            same = near & (view.thing[probe] == thing)
            total += same * level[y, x]
            weight += same
        own = level[row // EVERY, column // EVERY]
        spread[at] = np.where(weight > 0, total / np.maximum(weight, 1), own)
    return spread


def _finite(distance: Float32[np.ndarray, "..."]) -> Float32[np.ndarray, "..."]:
    return np.where(np.isfinite(distance), distance, np.float32(-1e30))


def _overlap(
    side: int, down: int, across: int
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return slices of a square and of the same square shifted."""

    def cut(move: int) -> slice:
        return slice(max(move, 0), side + min(move, 0))

    return (cut(-down), cut(-across)), (cut(down), cut(across))
