"""Mesh and particle files, whole or absent.

A grown organ is a file that a simulator loads, so two properties are guaranteed.
Coordinates are kept to the last bit where the format can hold a double (PLY, OBJ):
outside the patch the organ is written exactly as it was read. And a file is either
complete or absent: everything is written to a temporary file in the same folder,
flushed to the disk, and renamed. Formats are in `jaxgrow.io.formats`, one file each.
All coordinates are millimetres.
"""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Integer, UInt8

from jaxgrow.io.formats.format import LABEL, SurfaceMesh
from jaxgrow.io.formats.ply import (
    as_rows,
    read_elements,
    with_properties,
    write_elements,
)
from jaxgrow.io.formats.registry import FORMATS
from jaxgrow.runtime.atomic_file import write_atomically


def write_mesh(
    path: str | os.PathLike[str],
    vertices: Float[np.ndarray, "m 3"],
    faces: Integer[np.ndarray, "f 3"],
    label: Integer[np.ndarray, " m"] | Bool[np.ndarray, " m"],
    attributes: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write a labelled organ surface in the format that the suffix names.

    ========  ====================  ===================================================
    suffix    coordinates           vertex attributes
    ========  ====================  ===================================================
    ``.ply``  64-bit, as they are   properties, ``label`` among them; vertex colours
    ``.obj``  decimal, as they are  vertex colours
    ``.stl``  32-bit                none: the format has no place for them
    ``.glb``  32-bit                32-bit floats ``_LABEL``, ``_NAME``; vertex colours
    ========  ====================  ===================================================

    `jaxgrow.register_format` adds others.

    Args:
        path: The file to write; an existing one is replaced atomically.
        vertices: Coordinates, mm.
        faces: Vertex indices, one oriented triangle per row.
        label: 0 healthy, 1 lesion, for every vertex.
        attributes: Further numbers for every vertex, by name.

    Raises:
        ValueError: The suffix is unknown, or the arrays are not a mesh (a coordinate
            that is not finite, an index out of range, a label other than 0 and 1, an
            attribute that is not a finite number for every vertex).
        TypeError: A registered format did not return bytes.
    """
    path = Path(path)
    mesh_format = FORMATS.get(path.suffix.lower()[1:])
    if mesh_format is None:
        raise ValueError(
            f"{path.name}: unknown mesh format {path.suffix!r}; "
            f"use one of {', '.join(f'.{suffix}' for suffix in sorted(FORMATS))}."
        )
    mesh = _mesh_of(path, vertices, faces, {LABEL: label, **(attributes or {})})
    content = mesh_format.write(mesh)
    if not isinstance(content, bytes):
        raise TypeError(
            f"{path.name}: the format's write returned {type(content).__name__}; it "
            "must return bytes."
        )
    write_atomically(path, lambda file: file.write(content))


def _mesh_of(
    path: Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    attributes: Mapping[str, np.ndarray],
) -> SurfaceMesh:
    """Return the mesh of a file, which errors name."""
    try:
        return SurfaceMesh(vertices, faces, attributes)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def read_organ_ply(
    path: str | os.PathLike[str],
) -> tuple[
    Float[np.ndarray, "m 3"], Integer[np.ndarray, "f 3"], UInt8[np.ndarray, " m"]
]:
    """Read a labelled organ surface exactly as `write_mesh` wrote it.

    Args:
        path: A binary little-endian PLY file with a vertex property ``label``.

    Returns:
        Vertices in mm, faces, and the label of every vertex (0 healthy, 1 lesion).

    Raises:
        ValueError: The file is not such a PLY file, or is truncated.
    """
    path = Path(path)
    elements = read_elements(path)
    vertex = with_properties(path, elements, ("x", "y", "z", "label"))
    face = elements.get("face")
    if face is None or face.dtype.names != ("count", "vertex_indices"):
        raise ValueError(f"{path}: the PLY file has no faces made of vertex indices.")
    if np.any(face["count"] != 3):
        raise ValueError(f"{path}: the PLY file has faces that are not triangles.")
    vertices = _columns(vertex, ("x", "y", "z"))
    faces = face["vertex_indices"].astype(np.int64).reshape(-1, 3)
    label = vertex["label"].astype(np.uint8)
    _mesh_of(path, vertices, faces, {LABEL: label})
    return vertices, faces, label


def read_attributes(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Read the further attributes of a PLY file of `write_mesh`, by name.

    Raises:
        ValueError: The file is not such a PLY file, or is truncated.
    """
    path = Path(path)
    vertex = with_properties(path, read_elements(path), (LABEL,))
    known = {"x", "y", "z", LABEL, "red", "green", "blue"}
    return {n: vertex[n].copy() for n in vertex.dtype.names or () if n not in known}


def write_particles(
    path: str | os.PathLike[str],
    position_mm: Float[np.ndarray, "n 3"],
    species: Integer[np.ndarray, " n"] | Bool[np.ndarray, " n"],
    radius_mm: float | Float[np.ndarray, " n"],
) -> None:
    """Write particles as a PLY point cloud.

    The point's properties are ``x y z`` (64-bit, mm), ``species`` (8-bit) and
    ``radius`` (32-bit, mm).

    Args:
        path: The file to write, suffix ``.ply``.
        position_mm: Positions, mm.
        species: 0 tissue, 1 tumour, further species up to 255.
        radius_mm: One radius for all particles, or one for each, mm.

    Raises:
        ValueError: The suffix is not ``.ply``, a number is not finite, or a species
            does not fit into eight bits.
    """
    path = Path(path)
    if path.suffix.lower() != ".ply":
        raise ValueError(f"{path.name}: particles are written as .ply only.")
    radius = np.broadcast_to(np.asarray(radius_mm, np.float64), len(position_mm))
    if not (np.isfinite(position_mm).all() and np.isfinite(radius).all()):
        raise ValueError(f"{path.name}: a particle's position or radius is not finite.")
    species = np.asarray(species).astype(np.int64)
    if len(species) != len(position_mm) or np.any((species < 0) | (species > 255)):
        raise ValueError(
            f"{path.name}: every particle needs one species, a number from 0 to 255."
        )
    points = as_rows(
        {
            **dict(zip("xyz", position_mm.T.astype("<f8"), strict=True)),
            "species": species.astype("<u1"),
            "radius": radius.astype("<f4"),
        }
    )
    content = write_elements({"vertex": points})
    write_atomically(path, lambda file: file.write(content))


def read_particles(
    path: str | os.PathLike[str],
) -> tuple[Float[np.ndarray, "n 3"], UInt8[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Read the particles that `write_particles` wrote.

    Args:
        path: A binary little-endian PLY file.

    Returns:
        Positions in mm, species, and radii in mm (32-bit).

    Raises:
        ValueError: The file is not such a PLY file, or is truncated.
    """
    path = Path(path)
    points = with_properties(
        path, read_elements(path), ("x", "y", "z", "species", "radius")
    )
    return (
        _columns(points, ("x", "y", "z")),
        points["species"].astype(np.uint8),
        points["radius"].astype(np.float32),
    )


def _columns(rows: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    return np.stack([rows[name].astype(np.float64) for name in names], axis=1)
