"""Small organs for hard cases; lengths in mm. The tissue lies around the cavity."""

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float

import jaxgrow as jg
from jaxgrow.organ.implicit_surface import project, round_cone, smooth_union
from jaxgrow.organ.tessellation import tessellate


@functools.cache
def ellipsoid(
    x: float = 8.0, y: float = 8.0, z: float = 8.0, subdivisions: int = 3
) -> jg.Organ:
    """An ellipsoidal cavity; "beside" is half a radius from the site "bottom"."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    vertices = np.asarray(ball.vertices) * [x, y, z]
    directions = {
        "bottom": (0.0, 0.0, -1.0),
        "top": (0.0, 0.0, 1.0),
        "side": (1.0, 0.0, 0.0),
        "beside": (np.sin(0.55), 0.0, -np.cos(0.55)),
    }
    sites = {
        name: vertices[np.argmax(np.asarray(ball.vertices) @ direction)]
        for name, direction in directions.items()
    }
    faces = np.asarray(ball.faces, dtype=np.int64)
    return jg.Organ(f"ellipsoid {x:g} x {y:g} x {z:g}", vertices, faces, sites=sites)


def moved(organ: jg.Organ, shift: float) -> jg.Organ:
    """The same organ elsewhere."""
    sites = {name: point + shift for name, point in organ.sites.items()}
    return jg.Organ(
        organ.name, organ.vertices + shift, organ.faces, organ.tissue, sites
    )


def scaled(organ: jg.Organ, factor: float) -> jg.Organ:
    """The same organ in another unit of length."""
    sites = {name: factor * point for name, point in organ.sites.items()}
    return jg.Organ(
        organ.name, factor * organ.vertices, organ.faces, organ.tissue, sites
    )


@functools.cache
def hourglass(
    width: float, upper: float, lower: float, length: float = 2.0, edge: float = 0.9
) -> jg.Organ:
    """Two round chambers joined by a canal, as the womb and the cervix by the os.

    The site "opposite" is the top of the upper chamber, on the axis.

    Args:
        width: inner diameter of the canal.
        upper: radius of the upper chamber.
        lower: radius of the lower chamber.
        length: of the canal.
        edge: of the triangles.
    """
    radius = width / 2
    top = length / 2 + np.sqrt(upper**2 - radius**2)
    bottom = -length / 2 - np.sqrt(lower**2 - radius**2)
    parts = [
        (top, top + 0.01, upper, upper),
        (bottom, bottom + 0.01, lower, lower),
        (bottom, top, radius, radius),
    ]

    def cavity(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        distances = [
            round_cone(points, np.array([0, 0, a]), np.array([0, 0, b]), r, s)
            for a, b, r, s in parts
        ]
        return smooth_union(np.stack(distances), 0.2)

    half = max(upper, lower) + 1.0
    low, high = (
        np.array([-half, -half, bottom - half]),
        np.array([half, half, top + half]),
    )
    end = project(cavity, np.array([[0, 0, top + upper]]), step=1e-4, iterations=8)
    rng = np.random.default_rng(0)
    vertices, faces = tessellate(cavity, low, high, edge, rng, end)
    sites = {"opposite": vertices[0]}
    return jg.Organ(f"hourglass {width:g} mm", vertices, faces, sites=sites)


def solid(organ: jg.Organ) -> jg.Organ:
    """The same surface with the tissue inside of it."""
    return dataclasses.replace(organ, tissue="inside")


def with_slivers(organ: jg.Organ, aspect: float) -> jg.Organ:
    """The same organ with the site's triangles made slivers.

    A vertex beside the site "bottom" is moved along its edge until it almost meets it.
    """
    start = int(np.linalg.norm(organ.vertices - organ.sites["bottom"], axis=1).argmin())
    faces = organ.faces[(organ.faces == start).any(axis=1)]
    other = int(faces[faces != start][0])
    vertices = organ.vertices.copy()
    vertices[other] = vertices[start] + (vertices[other] - vertices[start]) / aspect
    return dataclasses.replace(organ, vertices=vertices)


def with_lesion(growth: jg.Growth, sites: Mapping[str, np.ndarray]) -> jg.Organ:
    """The organ of a growth with its lesion, for the next one."""
    vertices, faces, _ = growth.surface()
    assert growth.organ is not None
    return jg.Organ(
        "an organ with a lesion", vertices, faces, growth.organ.tissue, dict(sites)
    )


def in_file(organ: jg.Organ, unit_mm: float, folder: Path) -> Path:
    """The organ in a file whose unit of length is so many mm."""
    path = folder / "organ.ply"
    mesh = trimesh.Trimesh(organ.vertices / unit_mm, organ.faces, process=False)
    mesh.export(path, vertex_normal=False)
    return path
