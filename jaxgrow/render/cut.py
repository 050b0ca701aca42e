"""Cut of a scene by the plane on which the camera's rays start."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from jaxgrow.render.camera import Camera
from jaxgrow.render.scene import Balls, DrawnSurface
from jaxgrow.render.zbuffer import samples_of_boxes


def cut_line(
    surface: DrawnSurface, camera: Camera
) -> tuple[Float[np.ndarray, "s 2 2"], Bool[np.ndarray, " s"]]:
    """Compute the line in which the plane cuts the surface.

    A vertex that lies on the plane counts as behind it, so that every cut triangle
    has exactly two cut edges.

    Args:
        surface: The mesh.
        camera: Its rays start on the plane.

    Returns:
        Segments as columns and rows in samples, and which of them are the lesion's.
    """
    view = camera.to_view(surface.vertices)
    behind = (view[:, 2] >= 0)[surface.faces]
    crossed = np.flatnonzero(behind.any(axis=1) & ~behind.all(axis=1))
    faces, behind = surface.faces[crossed], behind[crossed]
    # The corner that is alone on its side of the plane comes first.
    lone = np.argmax(behind == (behind.sum(axis=1) == 1)[:, None], axis=1)
    turn = (lone[:, None] + np.arange(3)) % 3
    corner = view[np.take_along_axis(faces, turn, axis=1)]
    apex, base = corner[:, :1], corner[:, 1:]
    share = apex[..., 2:] / (apex[..., 2:] - base[..., 2:])
    segments = (apex + share * (base - apex))[..., :2]
    lesion = surface.label[faces].mean(axis=1) > 0.5
    return segments, lesion


def behind_plane(balls: Balls, camera: Camera) -> Balls:
    """Select the balls that reach behind the plane."""
    return balls.part(camera.to_view(balls.centre)[:, 2] > -balls.radius)


def cut_faces_of_balls(
    balls: Balls, camera: Camera
) -> tuple[Int[np.ndarray, " c"], Int[np.ndarray, " c"], Float[np.ndarray, " c"]]:
    """Compute the discs in which the plane cuts balls.

    Where discs overlap each sample belongs to the ball with the nearest centre, which
    gives the straight border of two pressed cells.

    Returns:
        Samples covered by a disc, the ball that each belongs to, and its distance to
        that disc's border, in samples.
    """
    view = camera.to_view(balls.centre)
    radius = balls.radius / camera.pitch
    depth = view[:, 2] / camera.pitch
    disc = np.sqrt(np.maximum(radius**2 - depth**2, 0))
    box = np.where(disc > 0, disc, -1.0)[:, None]
    low, size = _boxes(view[:, :2] - box, view[:, :2] + box, camera.pixels)
    owner, column, row = samples_of_boxes(low, size)
    sample = row * camera.pixels + column
    place = np.stack([column, row], axis=1) + 0.5
    within = np.linalg.norm(place - view[owner, :2], axis=1)
    order = np.lexsort((owner, within**2 + depth[owner] ** 2, sample))
    order = order[within[order] < disc[owner[order]]]
    lead = np.ones(len(order), bool)
    lead[1:] = sample[order][1:] != sample[order][:-1]
    best = order[lead]
    return sample[best], owner[best], disc[owner[best]] - within[best]


def stroke(
    segments: Float[np.ndarray, "s 2 2"], width: float, side: int
) -> Float32[np.ndarray, " p"]:
    """Compute samples' coverage by segments of a width, with round ends."""
    cover = np.zeros(side * side, np.float32)
    reach = width / 2 + 0.5
    low, size = _boxes(segments.min(axis=1) - reach, segments.max(axis=1) + reach, side)
    owner, column, row = samples_of_boxes(low, size)
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    square = np.maximum((along**2).sum(axis=1), 1e-12)
    offset = np.stack([column, row], axis=1) + 0.5 - start[owner]
    share = np.clip((offset * along[owner]).sum(axis=1) / square[owner], 0, 1)
    distance = np.linalg.norm(offset - share[:, None] * along[owner], axis=1)
    inside = np.clip(reach - distance, 0, 1).astype(np.float32)
    np.maximum.at(cover, row * side + column, inside)
    return cover


def _boxes(
    low: Float[np.ndarray, "n 2"], high: Float[np.ndarray, "n 2"], side: int
) -> tuple[Int[np.ndarray, "n 2"], Int[np.ndarray, "n 2"]]:
    """Return first sample and number of samples of boxes, within the picture."""
    first = np.clip(np.floor(low), 0, side).astype(int)
    last = np.clip(np.ceil(high), 0, side).astype(int)
    return first, np.maximum(last - first, 0)
