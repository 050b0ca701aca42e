"""Exact examination of the states that cases end with."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

import jaxgrow as jg
from jaxgrow.mesh.intersection import intersecting_pairs
from jaxgrow.mesh.quality import radius_ratio
from jaxgrow.mesh.winding import particles_outside
from jaxgrow.transfer.device import get, get_particles, get_surface

from .case import Found


SKIRT, FAR_BELOW = 30.0, 50.0
"""Half width of the skirt around a sheet, and depth of the body below it, in r0."""

COINCIDENT = 1e-6
"""Particles nearer to each other than this (in r0) repel each other by luck only."""


def coned(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    apex: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "g 3"]]:
    """A surface closed by a cone from its rim to a point."""
    start, end = rim(faces)
    cone = np.column_stack([end, start, np.full(len(start), len(vertices))])
    return np.concatenate([vertices, apex[None]]), np.concatenate([faces, cone])


def rim(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "2 e"]:
    """Start and end of every side of a face that no other face runs back."""
    half = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    start, end = half.T
    count = faces.max() + 1
    alone = ~np.isin(start * count + end, end * count + start)
    return half[alone].T


def closed(
    vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "g 3"]]:
    """A sheet made a closed body: a skirt around it, and a cone to a point far below.

    With the sheet's normals up, those of the body point outwards. The skirt is the rim
    stretched along x and y, so that who leaves sideways has not crossed anything.
    """
    start, end = rim(faces)
    count = len(vertices)
    low, high = vertices[start].min(axis=0), vertices[start].max(axis=0)
    centre = (low + high) / 2
    outer = vertices.copy()
    outer[:, :2] -= centre[:2]
    outer[:, :2] *= SKIRT / ((high - low) / 2)[:2]
    outer[:, :2] += centre[:2]
    skirt = [
        np.column_stack([end, start, start + count]),
        np.column_stack([end, start + count, end + count]),
    ]
    return coned(
        np.concatenate([vertices, outer]),
        np.concatenate([faces, *skirt]),
        apex=centre - [0.0, 0.0, FAR_BELOW],
    )


def coincident(position: Float[np.ndarray, "n 3"]) -> int:
    """Particles that have another one at their place."""
    if len(position) < 2 or not np.isfinite(position).all():
        return 0
    return int((KDTree(position).query(position, k=2)[0][:, 1] < COINCIDENT).sum())


def spacing(position: Float[np.ndarray, "n 3"]) -> float:
    """Smallest distance of two particles, in the unit of the positions."""
    if len(position) < 2 or not np.isfinite(position).all():
        return float("nan")
    return float(KDTree(position).query(position, k=2)[0][:, 1].min())


def crossed(
    position: Float[np.ndarray, "n 3"],
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
) -> int:
    """Particles that are not below a sheet, by the solid angle of a closed body."""
    return int(particles_outside(*closed(vertices, faces), position, "inside").sum())


def of_relaxation(outcome: jg.Relaxation, **figures: Any) -> Found:
    """Examine the end of a relaxation of particles, a sheet, or both."""
    particles, membrane = outcome.state
    defects: dict[str, int] = {}
    penetrations = intersections = 0
    quality = None
    position = np.zeros((0, 3))
    if particles is not None:
        position, _ = get_particles(particles)
        defects["non-finite particles"] = int((~np.isfinite(position)).any(1).sum())
        defects["coincident particles"] = coincident(position)
    if membrane is not None:
        surface = get_surface(membrane)
        vertices = np.asarray(surface.vertices, float)
        defects["non-finite vertices"] = int((~np.isfinite(vertices)).any(1).sum())
        if not defects["non-finite vertices"]:
            penetrations = crossed(position.astype(float), vertices, surface.faces)
            intersections = sum(map(len, intersecting_pairs(vertices, surface.faces)))
            quality = float(radius_ratio(vertices[surface.faces]).min())
    return Found(
        outcome=outcome.result.name,
        steps=outcome.stats.steps,
        residual=float(outcome.stats.residual),
        penetrations=penetrations,
        intersections=intersections,
        quality=quality,
        defects={name: count for name, count in defects.items() if count},
        figures={"overflows": outcome.stats.overflows, **figures},
    )


def of_growth(growth: jg.Growth, **figures: Any) -> Found:
    """Examine the end of a growth; the residual is that of accepted divisions."""
    audit = jg.audit(growth)
    defects = dict(audit.defects)
    penetrations = defects.pop("particles_outside", 0)
    meeting = ("self_intersections", "hinged_intersections", "folded_edges")
    intersections = sum(defects.pop(name, 0) for name in meeting)
    position, _ = get_particles(growth.state.particles)
    if twins := coincident(position):
        defects["coincident particles"] = twins
    quality = None
    if growth.state.membrane is not None:
        # of the patch: an organ's own triangles elsewhere are not our doing
        surface = get_surface(growth.state.membrane)
        quality = float(radius_ratio(surface.vertices[surface.faces]).min())
    accepted = [r.residual for r in growth.history if r.result == "CONVERGED"]
    mended: dict[str, int] = {}
    for record in growth.history:
        for name, count in record.mended.items():
            mended[name] = mended.get(name, 0) + count
    if growth.history and growth.history[-1].result != "CONVERGED":
        figures["residual_of_the_last"] = growth.history[-1].residual
    figures = {
        "divisions": growth.events.divisions,
        "size_mm": round(growth.size_mm, 2),
        "mended": mended,
        **figures,
    }
    return Found(
        outcome=growth.result.name,
        steps=sum(record.steps for record in growth.history),
        residual=max(accepted, default=None),
        penetrations=penetrations,
        intersections=intersections,
        quality=quality,
        defects=defects,
        figures=figures,
    )


def gyration(growth: jg.Growth) -> float:
    """Radius of gyration of the living particles, in r0."""
    position = get(growth.state.particles.position)[get(growth.state.particles.alive)]
    return float(np.sqrt(np.square(position - position.mean(0)).sum(1).mean()))
