"""Mesh with named vertex attributes, and the protocol of its formats."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Integer, UInt8


HEALTHY_COLOUR = (226, 158, 146)
LESION_COLOUR = (176, 38, 62)

LABEL = "label"
"""Name of the attribute that every organ has: 0 healthy, 1 lesion."""


@dataclass(frozen=True, eq=False)
class SurfaceMesh:
    """Triangle mesh of an organ's surface, as a format writes it.

    Attributes:
        vertices: coordinates in mm.
        faces: vertex indices, one oriented triangle per row.
        attributes: a number for every vertex, by name; ``label`` is among them.
    """

    vertices: Float[np.ndarray, "m 3"]
    faces: Integer[np.ndarray, "f 3"]
    attributes: Mapping[
        str,
        Float[np.ndarray, " m"] | Integer[np.ndarray, " m"] | Bool[np.ndarray, " m"],
    ]

    def __post_init__(self) -> None:
        if not np.isfinite(self.vertices).all():
            raise ValueError("the mesh has a coordinate that is not finite.")
        count, faces = len(self.vertices), self.faces
        if len(faces) and (faces.min() < 0 or faces.max() >= count):
            raise ValueError("a face names a vertex that does not exist.")
        label = self.attributes.get(LABEL, np.zeros(0))
        if len(label) != count or not np.isin(label, (0, 1)).all():
            raise ValueError("every vertex needs one label, 0 (healthy) or 1 (lesion).")
        for name, values in self.attributes.items():
            if not (name.isascii() and name.isidentifier() and name not in _TAKEN):
                raise ValueError(
                    f"{name!r} is no name of a vertex attribute; use letters, digits "
                    f"and underscores, and none of {', '.join(_TAKEN)}."
                )
            if np.shape(values) != (count,) or not np.isfinite(values).all():
                raise ValueError(
                    f"vertex attribute {name!r} has the shape {np.shape(values)} or a "
                    f"number that is not finite; give one finite number for each of "
                    f"{count} vertices."
                )

    @property
    def label(self) -> UInt8[np.ndarray, " m"]:
        """Label of every vertex: 0 healthy, 1 lesion."""
        return np.asarray(self.attributes[LABEL]).astype(np.uint8)

    @property
    def colours(self) -> UInt8[np.ndarray, "m 3"]:
        """Colour of every vertex by its smooth label, or its label; RGB."""
        share = np.asarray(self.attributes.get("lesion", self.label), float)[:, None]
        healthy, lesion = np.array([HEALTHY_COLOUR, LESION_COLOUR], float)
        return np.rint(healthy + share * (lesion - healthy)).astype(np.uint8)


_TAKEN = ("x", "y", "z", "red", "green", "blue")


@runtime_checkable
class MeshFormat(Protocol):
    """File format of a mesh.

    Attributes:
        suffix: of its files, in lower case and without the dot; the format's name.
    """

    suffix: str

    def write(self, mesh: SurfaceMesh) -> bytes:
        """Return the content of the mesh's file, the same for the same mesh."""
        ...
