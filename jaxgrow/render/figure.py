"""Picture of a growth: surface view and inner view side by side."""

from __future__ import annotations

import os

import numpy as np
from jaxtyping import Float, Integer

from jaxgrow.render import annotate, shading
from jaxgrow.render.checks import check_frame, check_mesh, check_particles, check_size
from jaxgrow.render.panels import inner_panel, surface_panel
from jaxgrow.render.scene import Balls, DrawnSurface, Labels, make_surface
from jaxgrow.render.subject import make_subject, Subject


_SPECIES_NAMES = ("tissue", "tumour")


def render_growth(
    path: str | os.PathLike[str],
    *,
    vertices: Float[np.ndarray, "m 3"] | None,
    faces: Integer[np.ndarray, "f 3"] | None,
    label: Labels | None,
    particles: Float[np.ndarray, "n 3"],
    species: Integer[np.ndarray, " n"],
    site: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    particle_diameter: float,
    extent: float | None = None,
    caption: str | None = None,
    size: int = 900,
) -> None:
    """Write one PNG with the two views of the paper's Fig. 1.

    Left the surface view: the lesion on the organ's free surface. Walls that stand
    between it and the viewer are left out. Right the inner view: cut by the plane that
    contains the axis, the site, and the direction in which the lesion leans or is
    widest. Particles in front of the plane are removed, those that it cuts are drawn as
    flat discs, those behind it as spheres.

    Without an organ (``vertices``, ``faces``, ``label`` all None) the left panel shows
    all particles and the right one the cut cluster.

    Args:
        path: The PNG file, written atomically.
        vertices: The whole organ's vertices, mm.
        faces: Its triangles, oriented consistently, in either way: the side to which
            ``axis`` points is the free one.
        label: 1 for vertices of the lesion, 0 for healthy ones, or a smooth label
            between them.
        particles: Positions, mm; there may be none.
        species: 0 tissue, 1 tumour, further species beyond.
        site: Point of the healthy surface where the lesion grew, mm.
        axis: Direction from the tissue into the lumen at the site, any length.
        particle_diameter: Diameter at which particles are drawn, mm.
        extent: Side of the square field that each panel shows, mm. None: a little
            under twice the lesion's size.
        caption: A line under the pictures.
        size: Side of a panel, pixels.

    Raises:
        ValueError: An argument is invalid; the message names it.
    """
    check_size(size)
    check_frame(site, axis, extent)
    check_particles(particles, species, particle_diameter)
    surface = _surface(vertices, faces, label)
    balls = Balls(
        np.asarray(particles, np.float64),
        np.asarray(species, np.int64),
        particle_diameter / 2,
    )
    subject = make_subject(
        surface, balls, np.asarray(site, float), np.asarray(axis, float), extent
    )
    annotate.write_page(
        path,
        [surface_panel(subject, size), inner_panel(subject, size)],
        field=subject.field,
        entries=_entries(subject),
        caption=caption,
    )


def _surface(
    vertices: np.ndarray | None, faces: np.ndarray | None, label: np.ndarray | None
) -> DrawnSurface:
    if vertices is None and faces is None and label is None:
        return make_surface(
            np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
        )
    if vertices is None or faces is None or label is None:
        raise ValueError("give vertices, faces and label, or none of the three.")
    check_mesh(vertices, faces, label)
    return make_surface(vertices, faces, np.asarray(label))


def _entries(subject: Subject) -> list[tuple[str, tuple[int, int, int], str]]:
    """Return the inner view's legend, for the objects that are visible."""
    entries = []
    for species in np.unique(subject.balls.species).tolist():
        known = species < len(_SPECIES_NAMES)
        name = _SPECIES_NAMES[species] if known else f"species {species}"
        entries.append(("disc", shading.species_colour(species), name))
    if not subject.free:
        entries.append(("line", shading.CUT_HEALTHY, "surface"))
        entries.append(("line", shading.CUT_LESION, "lesion's surface"))
    return entries
