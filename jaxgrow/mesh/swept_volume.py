"""Points in the volume that a remeshed surface swept over."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.winding import winding_number


def swept_points(
    before: Surface, after: Surface, points: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    """Mark the points on different sides of two surfaces with the same rim.

    The surface after, with the one before turned over, is a closed chain as long as
    both have the same rim. A point keeps its side exactly if that chain does not wind
    around it. Triangles that both have cancel and are left out.

    Args:
        before: The surface.
        after: The surface later, with the same rim, bit for bit.
        points: Positions in the same unit.

    Returns:
        True for points that changed sides, or that one of the surfaces touches.
    """
    old, new = before.vertices[before.faces], after.vertices[after.faces]
    gone, come = ~_among(old, new), ~_among(new, old)
    chain = np.concatenate([old[gone][:, ::-1], new[come]])
    swept = np.zeros(len(points), dtype=bool)
    if not len(chain):
        return swept
    low, high = chain.min(axis=(0, 1)), chain.max(axis=(0, 1))
    near = np.flatnonzero(np.all((points >= low) & (points <= high), axis=1))
    corners = chain.reshape(-1, 3)
    faces = np.arange(len(corners)).reshape(-1, 3)
    winding = winding_number(points[near], corners, faces)
    swept[near] = ~(np.abs(winding) < 0.25)
    return swept


def _among(
    triangles: Float[np.ndarray, "t 3 3"], others: Float[np.ndarray, "u 3 3"]
) -> Bool[np.ndarray, " t"]:
    """Return whether each triangle is one of the others, bit for bit.

    The first corner may differ, as remeshing may rotate an untouched triangle.
    """
    return np.isin(_key(triangles), _key(others))


def _key(triangles: Float[np.ndarray, "t 3 3"]) -> np.ndarray:
    """Return each triangle's bytes, from its lexicographically first corner."""
    order = np.lexsort(
        (triangles[..., 2], triangles[..., 1], triangles[..., 0]), axis=-1
    )
    turn = (order[:, :1] + np.arange(3)) % 3
    turned = np.take_along_axis(triangles, turn[:, :, None], axis=1) + 0.0
    flat = np.ascontiguousarray(turned.reshape(len(triangles), 9))
    return flat.view(np.dtype((np.void, flat.itemsize * 9))).ravel()
