"""Surface of the grown organ as files have it: labelled, cut, subdivided."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from jaxgrow.lesions.smooth_label import smooth_label
from jaxgrow.mesh.audit import audit_surface
from jaxgrow.mesh.cut import Cut, cut_along
from jaxgrow.mesh.isoline import polygon_length, trace_isolines
from jaxgrow.mesh.loop_subdivision import Refined, subdivide_loop
from jaxgrow.mesh.quality import areas
from jaxgrow.mesh.winding import particles_outside
from jaxgrow.organ.regions import find_regions, LESION, Region


if TYPE_CHECKING:
    import trimesh

    from jaxgrow.growth.result import Growth


class RefinementError(ValueError):
    """Error of a surface that cannot be subdivided, for the user."""


@dataclass(frozen=True, eq=False)
class LesionSurface:
    """Surface of a whole organ, with the lesion apart from the healthy part.

    Attributes:
        vertices: in mm.
        faces: its triangles, normals outward.
        lesion: smooth label of every vertex, from 0 (healthy) to 1 (lesion).
        region: a `jaxgrow.organ.regions.Region` of every vertex: 0 healthy, 1 base,
            2 stalk, 3 head; not 0 exactly where `lesion` is at least 1/2.
        ring: the base's ring in mm, a closed polygon in order: the longest line on
            which `lesion` is 1/2. Empty if no vertex belongs to the lesion.
        rings: number of such lines; more than one if the lesion has pits or parts.
        neck_mm: circumference of the stalk where it is narrowest; None without one.
        position: of the particles, in mm.
        tissue: the side of the surface that the particles are on.
        remeshed: figures of what was done to the surface, for the report.
    """

    vertices: Float[np.ndarray, "m 3"]
    faces: Int[np.ndarray, "f 3"]
    lesion: Float32[np.ndarray, " m"]
    region: UInt8[np.ndarray, " m"]
    ring: Float[np.ndarray, "k 3"]
    rings: int
    neck_mm: float | None
    position: Float[np.ndarray, "n 3"]
    tissue: str
    remeshed: dict[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Count vertices, faces and those of the lesion in one line."""
        lesion = int(np.count_nonzero(self.label))
        return (
            f"LesionSurface({len(self.vertices)} vertices, {lesion} of them lesion, "
            f"{len(self.faces)} faces)"
        )

    @property
    def label(self) -> UInt8[np.ndarray, " m"]:
        """1 for vertices of the lesion, 0 for healthy ones."""
        return (self.lesion >= LESION).astype(np.uint8)

    @property
    def attributes(self) -> dict[str, np.ndarray]:
        """Values of every vertex that files have besides the label."""
        return {"lesion": self.lesion, "region": self.region}

    def mesh(self) -> trimesh.Trimesh:
        """Make a trimesh, in mm; its `vertex_attributes` have label and values."""
        import trimesh

        return trimesh.Trimesh(
            self.vertices,
            self.faces,
            process=False,
            vertex_attributes={"label": self.label, **self.attributes},
        )

    def as_dict(self) -> dict[str, Any]:
        """Return all figures, for a report: lengths in mm, areas in mm²."""
        return {
            "triangles": len(self.faces),
            "ring_mm": polygon_length(self.ring),
            "ring_points": len(self.ring),
            "rings": self.rings,
            "neck_circumference_mm": self.neck_mm,
            "area_mm2": self._areas(),
            **self.remeshed,
        }

    def _areas(self) -> dict[str, float]:
        """Compute the area of each region; a face's vertices share it equally."""
        area = np.repeat(areas(self.vertices[self.faces]) / 3, 3)
        total = np.bincount(
            self.region[self.faces].ravel(), weights=area, minlength=len(Region)
        )
        return {part.name.lower(): float(total[part]) for part in Region if part}

    def refine(self, levels: int) -> LesionSurface:
        """Refine the lesion and a band around it by Loop's rule.

        See `jaxgrow.mesh.loop_subdivision`. Outside the band coordinates stay to the
        last bit. The smooth label is interpolated. Borders of regions stay half-way
        between vertices of the two, to a quarter of an edge.

        Args:
            levels: how often, from 1 to `jaxgrow.mesh.loop_subdivision.LEVELS`.

        Returns:
            The surface; it has no defect, and the particles are on the same side.

        Raises:
            ValueError: the levels are out of range.
            RefinementError: the subdivided surface has a defect or passes a particle.
        """
        found = subdivide_loop(self.vertices, self.faces, self.lesion >= LESION, levels)
        self._check(found, levels)
        lesion, region = self._interpolated(found)
        ring, rings = _base_ring(found.vertices, found.faces, lesion)
        return replace(
            self,
            vertices=found.vertices,
            faces=found.faces,
            lesion=lesion,
            region=region,
            ring=ring,
            rings=rings,
            remeshed={
                "levels": levels,
                "largest_displacement_mm": float(found.displacement.max()),
                "displaced_vertices": int(np.count_nonzero(found.displacement)),
            },
        )

    def _check(self, found: Refined, levels: int) -> None:
        """Raise if a subdivided surface cannot be used."""
        defects = audit_surface(found.vertices, found.faces).defects
        sides = (
            particles_outside(vertices, faces, self.position, self.tissue)
            for vertices, faces in (
                (self.vertices, self.faces),
                (found.vertices, found.faces),
            )
        )
        faults = dict(defects)
        if passed := int(np.count_nonzero(np.not_equal(*sides))):
            faults["particles_passed"] = passed
        if faults:
            listed = ", ".join(f"{name} {count}" for name, count in faults.items())
            raise RefinementError(
                f"the surface subdivided {levels} times has defects ({listed}); it was "
                "smoothed through itself or the particles: use the surface as it is."
            )

    def _interpolated(
        self, found: Refined
    ) -> tuple[Float32[np.ndarray, " k"], UInt8[np.ndarray, " k"]]:
        """Interpolate smooth label and region to a subdivided surface."""
        lesion, region = self.lesion, self.region
        for level, parents in enumerate(found.remeshing.parents):
            lesion = lesion[parents].mean(axis=1)
            low, high = np.sort(region[parents], axis=1).T
            # A border moves out by half an edge, then back by less and less of it.
            region = np.where((level == 0) | (low == 0), high, low)
            region = np.where(lesion >= LESION, region, 0)
        return lesion, region.astype(np.uint8)


def lesion_surface(growth: Growth, *, rim: bool = False) -> LesionSurface:
    """Make the grown organ's surface, with smooth label, regions and ring.

    Args:
        growth: the growth.
        rim: cut the surface along the base's ring, so that the lesion is bounded by a
            smooth closed line of edges; see `jaxgrow.mesh.cut`. Only triangles that the
            line crosses or touches change.

    Returns:
        The surface.

    Raises:
        ValueError: the cluster grew freely, so there is no organ, or a derivative is
            being taken.
    """
    merged = growth.merged()
    assert growth.organ is not None
    position, _ = growth.particles()
    tissue = growth.organ.tissue
    lesion = np.zeros(len(merged.vertices), dtype=np.float32)
    lesion[merged.placed] = smooth_label(growth.state)
    vertices, faces, remeshed = merged.vertices, merged.faces, {}
    if rim:
        cut = _cut_rim(vertices, faces, lesion, position, tissue)
        vertices, faces = cut.vertices, cut.faces
        lesion = cut.values.astype(np.float32)
        remeshed = {
            "rim": {
                "moved_vertices": len(cut.moved),
                "largest_shift_mm": float(cut.shift.max(initial=0.0)),
                "worst_triangle": cut.quality,
            }
        }
    ring, rings = _base_ring(vertices, faces, lesion)
    found = find_regions(
        vertices, faces, lesion.astype(np.float64), polygon_length(ring)
    )
    return LesionSurface(
        vertices=vertices,
        faces=faces,
        lesion=lesion,
        region=found.region,
        ring=ring,
        rings=rings,
        neck_mm=found.neck,
        position=position,
        tissue=tissue,
        remeshed=remeshed,
    )


def _cut_rim(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    lesion: Float32[np.ndarray, " m"],
    position: Float[np.ndarray, "n 3"],
    tissue: str,
) -> Cut:
    """Cut along the ring; move no vertex if that would pass a particle."""
    before = particles_outside(vertices, faces, position, tissue)
    cut = cut_along(vertices, faces, lesion.astype(np.float64), LESION)
    after = particles_outside(cut.vertices, cut.faces, position, tissue)
    if np.array_equal(before, after):
        return cut
    return cut_along(vertices, faces, lesion.astype(np.float64), LESION, moving=False)


def _base_ring(
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    lesion: Float32[np.ndarray, " m"],
) -> tuple[Float[np.ndarray, "k 3"], int]:
    """Return the longest line with smooth label 1/2, and their number."""
    lines = trace_isolines(vertices, faces, lesion.astype(np.float64), LESION)
    return (lines[0].points if lines else np.zeros((0, 3))), len(lines)
