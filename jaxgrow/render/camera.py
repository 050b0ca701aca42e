"""Orthographic camera: the same scale everywhere in the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int


@dataclass(frozen=True)
class Camera:
    """Orthographic camera: parallel rays through a square field.

    Attributes:
        centre: Point in the middle of the picture, mm.
        right: Unit vector towards the right of the picture.
        up: Unit vector towards the top of the picture.
        width: Side of the square field, mm.
        pixels: Samples along one side.
        reach: Distance in front of the centre at which the rays start, mm; objects
            nearer to the viewer are not seen. Zero cuts the scene through the centre.
    """

    centre: Float[np.ndarray, "3"]
    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    width: float
    pixels: int
    reach: float

    @property
    def forward(self) -> Float[np.ndarray, "3"]:
        """Direction in which the camera looks."""
        return np.cross(self.up, self.right)

    @property
    def pitch(self) -> float:
        """Distance between two samples, mm."""
        return self.width / self.pixels

    def to_view(self, points: Float[np.ndarray, "*_ 3"]) -> Float[np.ndarray, "*_ 3"]:
        """Compute column, row (in samples) and depth (mm) of points."""
        offset = points - self.centre
        column = (offset @ self.right) / self.pitch + self.pixels / 2
        row = self.pixels / 2 - (offset @ self.up) / self.pitch
        return np.stack([column, row, offset @ self.forward + self.reach], axis=-1)

    def points(
        self, at: Int[np.ndarray, " h"], distance: Float32[np.ndarray, " h"]
    ) -> Float32[np.ndarray, "h 3"]:
        """Return points on the rays of samples, relative to the centre, mm."""
        place = np.zeros((len(at), 3), np.float32)
        row, column = np.divmod(at, self.pixels)
        place[:, 0] = (column + 0.5) * self.pitch - self.width / 2
        place[:, 1] = self.width / 2 - (row + 0.5) * self.pitch
        place[:, 2] = distance - self.reach
        frame = np.stack([self.right, self.up, self.forward])
        return place @ frame.astype(np.float32)


def look(
    centre: Float[np.ndarray, "3"],
    forward: Float[np.ndarray, "3"],
    upward: Float[np.ndarray, "3"],
    *,
    width: float,
    pixels: int,
    reach: float,
) -> Camera:
    """Aim a camera.

    Args:
        centre: Point in the middle of the picture, mm.
        forward: Direction in which to look, any length.
        upward: Direction that points up in the picture, as far as possible.
        width: Side of the square field, mm.
        pixels: Samples along one side.
        reach: Distance in front of the centre at which the rays start, mm.

    Returns:
        The camera. If ``upward`` is parallel to ``forward`` another upward direction is
        taken.
    """
    forward = unit(forward)
    right = np.cross(forward, upward)
    if np.linalg.norm(right) < 1e-9 * max(float(np.linalg.norm(upward)), 1e-300):
        right = np.cross(forward, perpendicular(forward))
    right = unit(right)
    return Camera(centre, right, np.cross(right, forward), width, pixels, reach)


def unit(vector: Float[np.ndarray, "*_ 3"]) -> Float[np.ndarray, "*_ 3"]:
    """Normalise vectors to length 1; a zero vector stays zero."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector / np.where(length > 0, length, 1)


def perpendicular(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return a unit vector perpendicular to a direction, deterministically."""
    axis = np.eye(3)[np.argmin(np.abs(direction))]
    return unit(axis - (axis @ direction) * direction / (direction @ direction))
