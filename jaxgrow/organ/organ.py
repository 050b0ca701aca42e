"""Organ, sites on its surface, and free room of its lumen."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from jaxgrow.mesh.proximity import nearest_on_mesh
from jaxgrow.mesh.quality import area_vectors, lengths
from jaxgrow.organ.validity import OrganError, place


REACH_MM = 1.0
"""Largest distance from the surface of a site given by coordinates."""


@dataclass(frozen=True, eq=False)
class Organ:
    """Closed surface with tissue on one of its sides.

    Attributes:
        name: For messages and reports.
        vertices: In mm.
        faces: Vertex indices; the surface is closed, of one component, a manifold, and
            its normals point out of it.
        tissue: ``outside`` for a hollow organ (the surface bounds the lumen),
            ``inside`` for a solid one (the lumen is the space around it).
        sites: Named points on the surface, in mm.
    """

    name: str
    vertices: Float[np.ndarray, "m 3"]
    faces: Int[np.ndarray, "f 3"]
    tissue: Literal["outside", "inside"] = "outside"
    sites: Mapping[str, Float[np.ndarray, "3"]] = field(default_factory=dict)

    @property
    def lumen_sign(self) -> int:
        """Sign that turns an outward normal into one that points into the lumen."""
        return -1 if self.tissue == "outside" else 1

    def __repr__(self) -> str:
        """Describe name, size of the mesh, side of the tissue and sites in a line."""
        sites = ", ".join(self.sites) or "none"
        return (
            f"Organ({self.name!r}, {len(self.vertices)} vertices, {len(self.faces)} "
            f"faces, tissue {self.tissue}, sites: {sites})"
        )


@dataclass(frozen=True, eq=False)
class Site:
    """Point on an organ's surface.

    Attributes:
        name: The site's name, or its coordinates as text.
        point: In mm, on the surface.
        face: The triangle that it lies on.
        normal: Unit normal into the lumen, averaged by area over the triangles that
            touch the corners of ``face``.
    """

    name: str
    point: Float[np.ndarray, "3"]
    face: int
    normal: Float[np.ndarray, "3"]


def locate_site(organ: Organ, site: str | tuple[float, float, float]) -> Site:
    """Find a site by its name or its coordinates.

    Args:
        organ: The organ.
        site: A name in ``organ.sites``, or coordinates in mm, as three numbers or as
            the text ``X,Y,Z``. Coordinates are moved to the nearest point of the
            surface if that is at most ``REACH_MM`` away.

    Returns:
        The site.

    Raises:
        OrganError: If there is no such name or no such point on the surface.
    """
    if isinstance(site, str) and "," not in site:
        if site not in organ.sites:
            raise OrganError(_unknown_name(organ, site))
        name, wanted = site, np.asarray(organ.sites[site], dtype=float)
    else:
        wanted = _coordinates(site)
        name = ",".join(f"{value:g}" for value in wanted)
    local = organ.vertices - wanted
    distance, face, closest = nearest_on_mesh(np.zeros((1, 3)), local, organ.faces)
    if distance[0] > REACH_MM:
        msg = (
            f"the site {place(wanted)} is {distance[0]:.4g} mm off the surface of "
            f"{organ.name}, but it may be at most {REACH_MM:g} mm off: the nearest "
            f"point on the surface is {place(wanted + closest[0])}."
        )
        raise OrganError(msg)
    index = int(face[0])
    around = np.isin(organ.faces, organ.faces[index]).any(axis=1)
    total = area_vectors(local[organ.faces[around]]).sum(axis=0)
    normal = organ.lumen_sign * total / np.linalg.norm(total)
    return Site(name=name, point=wanted + closest[0], face=index, normal=normal)


def room(organ: Organ, site: Site) -> float:
    """Return the free distance along the site's normal to the opposite wall.

    A ray from the site into the lumen is intersected with all triangles. The first 10⁻⁶
    of the organ's diagonal is ignored, and so are the triangles around the site.

    Args:
        organ: The organ.
        site: Start of the ray.

    Returns:
        The distance in mm, infinite if the ray meets nothing (a solid organ).
    """
    local = organ.vertices - site.point
    own = np.isin(organ.faces, organ.faces[site.face]).any(axis=1)
    a, b, c = (local[organ.faces[~own, k]] for k in range(3))
    # Möller & Trumbore 1997: a + u (b - a) + v (c - a) = t normal
    normal = np.broadcast_to(site.normal, a.shape)
    across = np.cross(normal, c - a)
    determinant = np.einsum("fi,fi->f", b - a, across)
    parallel = np.abs(determinant) < np.finfo(float).tiny
    determinant = np.where(parallel, 1.0, determinant)
    u = np.einsum("fi,fi->f", -a, across) / determinant
    turned = np.cross(-a, b - a)
    v = np.einsum("fi,fi->f", normal, turned) / determinant
    t = np.einsum("fi,fi->f", c - a, turned) / determinant
    # a tolerance, so that a ray through an edge does not miss both triangles
    slack = 1e-12
    hit = ~parallel & (u >= -slack) & (v >= -slack) & (u + v <= 1 + slack)
    hit &= t > 1e-6 * float(lengths(np.ptp(local, axis=0)[None])[0])
    return float(t[hit].min()) if hit.any() else float("inf")


def _unknown_name(organ: Organ, site: str) -> str:
    if not organ.sites:
        return (
            f"{organ.name} has no named sites, so {site!r} means nothing there: give "
            "the site as three coordinates X,Y,Z in mm."
        )
    close = difflib.get_close_matches(site.lower(), organ.sites, n=1)
    hint = f" did you mean {close[0]!r}?" if close else ""
    return (
        f"{organ.name} has no site {site!r}:{hint} choose one of "
        f"{', '.join(sorted(organ.sites))}, or give X,Y,Z in mm."
    )


def _coordinates(site: str | tuple[float, float, float]) -> Float[np.ndarray, "3"]:
    parts = site.split(",") if isinstance(site, str) else list(site)
    try:
        numbers = np.array([float(part) for part in parts])
    except ValueError:
        numbers = np.array([])
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        msg = (
            f"the site {site!r} is neither a name nor three finite coordinates: give "
            "it as X,Y,Z in mm, for example 0,0,32."
        )
        raise OrganError(msg)
    return numbers
