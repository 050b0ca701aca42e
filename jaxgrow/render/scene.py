"""Objects of a picture: a labelled surface and balls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Integer

from jaxgrow.render.camera import Camera, unit


# Number of nearest balls that are drawn finely; the others are mostly hidden.
_FINE = 500


Labels = Integer[np.ndarray, " m"] | Bool[np.ndarray, " m"] | Float[np.ndarray, " m"]
"""Label of every vertex: 1 of a lesion, 0 healthy, or smooth between them."""


@dataclass(frozen=True)
class DrawnSurface:
    """Labelled triangle mesh.

    Attributes:
        vertices: Coordinates, mm.
        faces: Vertex indices of the triangles.
        label: 1 where the surface is a lesion's, 0 where it is healthy.
        normal: Unit normal of every vertex.
    """

    vertices: Float[np.ndarray, "m 3"]
    faces: Int[np.ndarray, "f 3"]
    label: Float[np.ndarray, " m"]
    normal: Float[np.ndarray, "m 3"]

    @property
    def area_vectors(self) -> Float[np.ndarray, "f 3"]:
        """Normals of the triangles, as long as twice their area."""
        corner = self.vertices[self.faces]
        return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])

    @property
    def volume(self) -> float:
        """Enclosed volume, mm³; negative if the normals point inward."""
        apex = self.vertices[self.faces[:, 0]] - self.vertices.mean(axis=0)
        return float((apex * self.area_vectors).sum()) / 6

    @property
    def lesion_faces(self) -> Bool[np.ndarray, " f"]:
        """Triangles with at least one corner on the lesion."""
        return np.asarray((self.label[self.faces] > 0.5).any(axis=1))

    def part(self, chosen: Bool[np.ndarray, " f"]) -> DrawnSurface:
        """Return the same vertices with some of the triangles."""
        return DrawnSurface(self.vertices, self.faces[chosen], self.label, self.normal)


@dataclass(frozen=True)
class Balls:
    """Particles, drawn as spheres of one size.

    Attributes:
        centre: Positions, mm.
        species: 0 tissue, 1 tumour, further ones beyond.
        radius: mm.
    """

    centre: Float[np.ndarray, "n 3"]
    species: Int[np.ndarray, " n"]
    radius: float

    def part(self, chosen: Bool[np.ndarray, " n"]) -> Balls:
        """Return some of the particles."""
        return Balls(self.centre[chosen], self.species[chosen], self.radius)


def make_surface(
    vertices: Float[np.ndarray, "m 3"],
    faces: Integer[np.ndarray, "f 3"],
    label: np.ndarray,
) -> DrawnSurface:
    """Make a surface with area-weighted vertex normals."""
    flat = DrawnSurface(
        np.asarray(vertices, np.float64),
        np.asarray(faces, np.int64),
        np.asarray(label, np.float64),
        np.zeros((len(vertices), 3)),
    )
    normal = np.zeros((len(vertices), 3))
    for column in range(3):
        np.add.at(normal, flat.faces[:, column], flat.area_vectors)
    return DrawnSurface(flat.vertices, flat.faces, flat.label, unit(normal))


def ball_triangles(
    balls: Balls, camera: Camera
) -> tuple[Float[np.ndarray, "t 3 3"], Int[np.ndarray, " t"]]:
    """Triangulate the balls within a camera's field, with the ball of each."""
    view = camera.to_view(balls.centre)
    margin = balls.radius / camera.pitch
    centred = np.abs(view[:, :2] - camera.pixels / 2).max(axis=1, initial=0)
    within = np.flatnonzero(
        (centred < camera.pixels / 2 + margin) & (view[:, 2] > -balls.radius)
    )
    nearest = within[np.argsort(view[within, 2], kind="stable")]
    triangles, owners = [np.zeros((0, 3, 3))], [np.zeros(0, np.int64)]
    for chosen, level in ((nearest[:_FINE], 3), (nearest[_FINE:], 2)):
        ball = balls.radius * _octasphere(level)
        placed = balls.centre[chosen][:, None, None] + ball
        triangles.append(placed.reshape(-1, 3, 3))
        owners.append(np.repeat(chosen, len(ball)))
    return np.concatenate(triangles), np.concatenate(owners)


def _octasphere(subdivisions: int) -> Float[np.ndarray, "f 3 3"]:
    """Triangulate a sphere by repeated subdivision of an octahedron.

    Its corners lie as far outside the unit sphere as the middles of its sides lie
    inside.
    """
    sign = np.array([[a, b, c] for a in (1, -1) for b in (1, -1) for c in (1, -1)])
    triangles = np.eye(3)[None] * sign[:, None, :].astype(np.float64)
    odd = sign.prod(axis=1) < 0
    triangles[odd] = triangles[odd][:, ::-1]
    for _ in range(subdivisions):
        a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        ab, bc, ca = unit(a + b), unit(b + c), unit(c + a)
        triangles = np.concatenate(
            [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c))]
            + [np.stack((ab, bc, ca), axis=1)]
        )
    return triangles * 2 / (1 + np.cos(np.pi / 4 / 2**subdivisions))
