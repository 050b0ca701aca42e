"""Rasterisation of triangles in numpy: fragments, and nearest per sample."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Float32, Int


# Fragments in memory at a time: about 200 MB.
_CHUNK = 2_000_000

Fragments = tuple[
    Int[np.ndarray, " k"],
    Int[np.ndarray, " k"],
    Float32[np.ndarray, " k"],
    Float32[np.ndarray, " k"],
    Float32[np.ndarray, " k"],
]
Buffers = tuple[
    Int[np.ndarray, " p"],
    Float32[np.ndarray, " p"],
    Float32[np.ndarray, " p"],
    Float32[np.ndarray, " p"],
]


def rasterise(view: Float[np.ndarray, "f 3 3"], pixels: int) -> Iterator[Fragments]:
    """Rasterise triangles into fragments, one for each sample they cover.

    Args:
        view: Corners as column, row (in samples) and distance from the viewer.
        pixels: Samples along one side of the square picture.

    Yields:
        Sample, triangle, barycentric weights of its second and third corner, and
        distance, for the fragments of some of the triangles at a time. Fragments at
        negative distance are left out.
    """
    low = np.clip(np.ceil(view[..., :2].min(axis=1) - 0.5), 0, pixels).astype(int)
    high = np.clip(np.floor(view[..., :2].max(axis=1) - 0.5), -1, pixels - 1)
    size = np.maximum(high.astype(int) - low + 1, 0)
    size[view[..., 2].max(axis=1) < 0] = 0
    count = size[:, 0] * size[:, 1]
    chunk = np.cumsum(count) // _CHUNK
    for part in np.unique(chunk[count > 0]):
        chosen = np.flatnonzero((chunk == part) & (count > 0))
        yield _fragments(view, chosen, low[chosen], size[chosen], pixels)


def nearest_fragments(fragments: Iterator[Fragments], buffers: Buffers) -> Buffers:
    """Keep the nearest fragment of every sample (depth test).

    Args:
        fragments: Chunks as from `rasterise`.
        buffers: Triangle, both weights and distance of every sample; overwritten.

    Returns:
        The same buffers, filled. Of two fragments at the same distance the one with the
        lower triangle wins, so that a picture does not depend on the order of work.
    """
    face, first, second, distance = buffers
    for sample, triangle, u, v, depth in fragments:
        order = np.lexsort((triangle, depth, sample))
        lead = np.ones(len(order), bool)
        lead[1:] = sample[order][1:] != sample[order][:-1]
        best = order[lead]
        best = best[depth[best] < distance[sample[best]]]
        at = sample[best]
        face[at], first[at], second[at] = triangle[best], u[best], v[best]
        distance[at] = depth[best]
    return buffers


def samples_of_boxes(
    low: Int[np.ndarray, "n 2"], size: Int[np.ndarray, "n 2"]
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """List the box, column and row of every sample in every box.

    Args:
        low: First column and row of each box.
        size: Number of columns and rows of each box; none if one of them is zero.
    """
    count = size[:, 0] * size[:, 1]
    owner = np.repeat(np.arange(len(low)), count)
    within = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    column = low[owner, 0] + within % np.maximum(size[owner, 0], 1)
    row = low[owner, 1] + within // np.maximum(size[owner, 0], 1)
    return owner, column, row


def _fragments(
    view: np.ndarray,
    chosen: np.ndarray,
    low: np.ndarray,
    size: np.ndarray,
    pixels: int,
) -> Fragments:
    """Compute the fragments of the chosen triangles, from their boxes."""
    owner, column, row = samples_of_boxes(low, size)
    corner = view[chosen]
    edge_1, edge_2 = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = edge_1[:, 0] * edge_2[:, 1] - edge_1[:, 1] * edge_2[:, 0]
    inverse = np.divide(1.0, area, out=np.zeros_like(area), where=area != 0)
    x = column + 0.5 - corner[owner, 0, 0]
    y = row + 0.5 - corner[owner, 0, 1]
    u = (x * edge_2[owner, 1] - y * edge_2[owner, 0]) * inverse[owner]
    v = (y * edge_1[owner, 0] - x * edge_1[owner, 1]) * inverse[owner]
    depth = corner[owner, 0, 2] + u * edge_1[owner, 2] + v * edge_2[owner, 2]
    inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (depth >= 0) & (area[owner] != 0)
    return (
        (row * pixels + column)[inside],
        chosen[owner][inside],
        u[inside].astype(np.float32),
        v[inside].astype(np.float32),
        depth[inside].astype(np.float32),
    )
