"""Subject of a growth's picture, and its cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jaxgrow.render.camera import Camera, look, perpendicular, unit
from jaxgrow.render.scene import Balls, DrawnSurface
from jaxgrow.render.view import see


_ELEVATION = np.deg2rad(32.0)
_SCOUT = 96


@dataclass(frozen=True)
class Subject:
    """Lesion in its organ, or free cluster.

    Attributes:
        surface: The organ; without triangles for a free cluster.
        balls: The particles.
        site: Point where the lesion grew, mm.
        axis: Unit vector of its growth direction; up in the pictures.
        middle: Centre of the lesion's box, mm.
        side: Unit vector perpendicular to the axis, from the lesion to the viewer of
            the inner view; the cut plane's normal.
        field: Side of the pictured square, mm.
        lumen: +1 if the surface's normals point to the free side, -1 if to the tissue.
    """

    surface: DrawnSurface
    balls: Balls
    site: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    middle: Float[np.ndarray, "3"]
    side: Float[np.ndarray, "3"]
    field: float
    lumen: int

    @property
    def free(self) -> bool:
        """Whether there is no organ."""
        return len(self.surface.faces) == 0

    @property
    def embedded(self) -> bool:
        """Whether tissue fills the space around the surface: a hollow organ."""
        return not self.free and self.lumen * self.surface.volume < 0


def make_subject(
    surface: DrawnSurface,
    balls: Balls,
    site: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    extent: float | None,
) -> Subject:
    """Frame a lesion and choose the cut.

    The cut plane contains the axis and the direction across it in which the lesion's
    points have their largest second moment about the site: there it leans, or is wide.

    Args:
        surface: The organ; without triangles for a free cluster.
        balls: The particles.
        site: Point where the lesion grew, mm.
        axis: Direction from the tissue into the lumen.
        extent: Side of the pictured square, mm; None: from the lesion's size.
    """
    axis = unit(axis)
    points = _lesion_points(surface, balls, site)
    across = _widest(points - site, axis)
    frame = np.stack([across, axis, np.cross(across, axis)])
    places = (points - site) @ frame.T
    low, high = places.min(axis=0), places.max(axis=0)
    room = 1.9 if len(surface.faces) else 1.15
    field = extent or max(room * float((high - low).max()), 4 * balls.radius)
    middle = site + (low + high) / 2 @ frame
    subject = Subject(
        surface,
        balls,
        site,
        axis,
        middle,
        frame[2],
        field,
        _free_side(surface, axis, site),
    )
    return _turned_to_the_better_side(subject)


def oblique_camera(subject: Subject, pixels: int) -> Camera:
    """Aim a camera down at the lesion from the free side of the surface.

    The view is taken from the cut's side, so that both panels show the same face of the
    lesion, unless walls hide it there and another side shows much more of it.
    """
    sides = [subject.side]
    if not subject.free:
        frame = (subject.side, np.cross(subject.axis, subject.side))
        turns = np.arange(8) * np.pi / 4
        sides = [np.cos(t) * frame[0] + np.sin(t) * frame[1] for t in turns]
        scores = [_visible_lesion(subject, side) for side in sides]
        scores[0] *= 1.3
        sides = [sides[int(np.argmax(scores))]]
    return _oblique(subject, sides[0], pixels)


def cut_camera(subject: Subject, pixels: int) -> Camera:
    """Aim a camera straight at the cut; its rays start on the plane."""
    before = (subject.middle - subject.site) @ subject.side
    centre = subject.middle - before * subject.side
    return look(
        centre,
        -subject.side,
        subject.axis,
        width=subject.field,
        pixels=pixels,
        reach=0.0,
    )


def open_surface(surface: DrawnSurface, camera: Camera, lumen: int) -> DrawnSurface:
    """Remove the walls that turn their tissue side to the camera.

    This removes all walls between the viewer and the lumen. The lesion stays whole: its
    far side casts shadows.
    """
    facing = lumen * (surface.area_vectors @ camera.forward) < 0
    return surface.part(facing | surface.lesion_faces)


def _oblique(subject: Subject, side: Float[np.ndarray, "3"], pixels: int) -> Camera:
    back = np.cos(_ELEVATION) * side + np.sin(_ELEVATION) * subject.axis
    return look(
        subject.middle,
        -back,
        subject.axis,
        width=subject.field,
        pixels=pixels,
        reach=1.2 * subject.field,
    )


def _visible_lesion(subject: Subject, side: Float[np.ndarray, "3"]) -> float:
    """Count the samples of a small picture that see the lesion."""
    camera = _oblique(subject, side, _SCOUT)
    surface = open_surface(subject.surface, camera, subject.lumen)
    none = subject.balls.part(np.zeros(len(subject.balls.centre), bool))
    face = see(surface, none, camera).hits.face
    return float(surface.lesion_faces[face[face >= 0]].sum())


def _turned_to_the_better_side(subject: Subject) -> Subject:
    """Choose the side of the cut from which more of the lesion is seen."""
    if subject.free:
        return subject
    here = _visible_lesion(subject, subject.side)
    there = _visible_lesion(subject, -subject.side)
    if there <= 1.02 * here:
        return subject
    return replace(subject, side=-subject.side)


def _lesion_points(
    surface: DrawnSurface, balls: Balls, site: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "k 3"]:
    """Return the points to frame: the lesion, or else the particles."""
    lesion = surface.vertices[surface.label > 0.5]
    if len(lesion):
        return lesion
    chosen = balls.centre[balls.species > 0] if len(surface.faces) else balls.centre
    return chosen if len(chosen) else site[None]


def _widest(
    offset: Float[np.ndarray, "k 3"], axis: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Return the direction across the axis with the largest second moment."""
    first = perpendicular(axis)
    second = np.cross(axis, first)
    flat = offset @ np.stack([first, second], axis=1)
    moment, direction = np.linalg.eigh(flat.T @ flat)
    if moment[1] - moment[0] <= 1e-9 * moment[1]:
        return first
    x, y = direction[:, 1]
    across = x * first + y * second
    # An eigenvector has no sign; choose the one in which the lesion leans to the right.
    return across if (offset @ across).sum() >= 0 else -across


def _free_side(
    surface: DrawnSurface, axis: Float[np.ndarray, "3"], site: Float[np.ndarray, "3"]
) -> int:
    """Return +1 if normals point to where the axis points, else -1.

    A lesion bulges, overhangs and leans, but the sum of its area vectors is that of the
    patch of healthy surface that it replaced.
    """
    if len(surface.faces) == 0:
        return 1
    inner = (surface.label[surface.faces] > 0.5).all(axis=1)
    total = surface.area_vectors[inner].sum(axis=0)
    if not inner.any():
        nearest = np.argmin(np.linalg.norm(surface.vertices - site, axis=1))
        total = surface.normal[nearest]
    return 1 if total @ axis >= 0 else -1
