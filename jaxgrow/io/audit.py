"""Exact audit of a growth, independent of the simulation's distances."""

from dataclasses import asdict, dataclass
from typing import Any, TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from jaxgrow.mesh.audit import audit_surface, SurfaceAudit
from jaxgrow.mesh.winding import particles_outside


if TYPE_CHECKING:
    from jaxgrow.growth.result import Growth


@dataclass(frozen=True)
class Audit:
    """Findings of an audit of a growth.

    Attributes:
        surface: of the whole organ's mesh; None for a free cluster.
        particles: number of particles checked.
        non_finite_particles: number with a coordinate that is not finite.
        particles_outside: number on the wrong side of the surface, or on it.
        euler_number_before: of the organ, if it is known.
    """

    surface: SurfaceAudit | None
    particles: int
    non_finite_particles: int
    particles_outside: int
    euler_number_before: int | None = None

    @property
    def clean(self) -> bool:
        """Whether there is no defect."""
        return not self.defects

    @property
    def defects(self) -> dict[str, int]:
        """Every kind of defect that was found, with its count."""
        found = {
            "non_finite_particles": self.non_finite_particles,
            "particles_outside": self.particles_outside,
        }
        if self.surface is not None:
            found |= self.surface.defects
            found["further_components"] = self.surface.components - 1
            found["inside_out"] = int(self.surface.volume <= 0)
            before = self.euler_number_before
            if before is not None:
                found["euler_number_change"] = abs(self.surface.euler_number - before)
        return {name: count for name, count in found.items() if count}

    def as_dict(self) -> dict[str, Any]:
        """Return all figures, for a report."""
        figures = asdict(self)
        figures["surface"] = None if self.surface is None else self.surface.as_dict()
        return {"clean": self.clean, "defects": self.defects, **figures}


def audit_arrays(
    position: Float[np.ndarray, "n 3"],
    vertices: Float[np.ndarray, "m 3"] | None = None,
    faces: Int[np.ndarray, "f 3"] | None = None,
    tissue: str = "outside",
    euler_number_before: int | None = None,
) -> Audit:
    """Audit particles and the closed surface of the organ around them.

    Args:
        position: of the particles, in mm.
        vertices: of the whole organ in mm, or None for a free cluster.
        faces: its triangles, normals outward.
        tissue: the side of the surface that the particles must be on.
        euler_number_before: of the organ before growth, if it is known.
    """
    non_finite = int((~np.isfinite(position).all(axis=1)).sum())
    if vertices is None or faces is None:
        return Audit(None, len(position), non_finite, 0)
    return Audit(
        surface=audit_surface(vertices, faces),
        particles=len(position),
        non_finite_particles=non_finite,
        particles_outside=int(
            particles_outside(vertices, faces, position, tissue).sum()
        ),
        euler_number_before=euler_number_before,
    )


def audit(growth: "Growth") -> Audit:
    """Audit a growth: penetrations, a valid surface, finite values.

    Args:
        growth: what `jaxgrow.grow` returned.

    Returns:
        The findings; `.clean` if there are none.
    """
    position, _ = growth.particles()
    if growth.organ is None:
        return audit_arrays(position)
    vertices, faces, _ = growth.surface()
    organ = growth.organ
    before = audit_surface(organ.vertices, organ.faces).euler_number
    return audit_arrays(position, vertices, faces, organ.tissue, before)
