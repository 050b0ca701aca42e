"""Mesh and particle files: PLY, OBJ, STL, GLB.

A grown organ is a file that a simulator loads, so two properties are guaranteed.
Coordinates are kept to the last bit where the format can hold a double (PLY, OBJ):
outside the patch the organ is written exactly as it was read. And a file is either
complete or absent: everything is written to a temporary file in the same folder,
flushed to the disk, and renamed.

STL and GLB hold 32-bit floats by definition; STL has no place for labels. All
coordinates are millimetres, in GLB too (its own convention is the metre; the unit is
noted in the file's extras).
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Integer, UInt8

from jaxgrow.runtime.atomic_file import write_atomically


HEALTHY_COLOUR = (226, 158, 146)
LESION_COLOUR = (176, 38, 62)

_LITTLE_ENDIAN = {
    "char": "<i1", "int8": "<i1", "uchar": "<u1", "uint8": "<u1",
    "short": "<i2", "int16": "<i2", "ushort": "<u2", "uint16": "<u2",
    "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4",
    "float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8",
}  # fmt: skip
_NAMES = {"<u1": "uchar", "<i4": "int", "<f4": "float", "<f8": "double"}


def write_mesh(
    path: str | os.PathLike[str],
    vertices: Float[np.ndarray, "m 3"],
    faces: Integer[np.ndarray, "f 3"],
    label: Integer[np.ndarray, " m"] | Bool[np.ndarray, " m"],
) -> None:
    """Write a labelled organ surface in the format that the suffix names.

    ========  ==========================  =========================================
    suffix    coordinates                 label
    ========  ==========================  =========================================
    ``.ply``  64-bit, bit-identical       vertex property ``label``, vertex colours
    ``.obj``  decimal, bit-identical      vertex colours
    ``.stl``  32-bit                      none: the format has no place for it
    ``.glb``  32-bit                      attribute ``_LABEL`` (float), colours
    ========  ==========================  =========================================

    Args:
        path: The file to write; an existing one is replaced atomically.
        vertices: Coordinates, mm.
        faces: Vertex indices, one oriented triangle per row.
        label: 0 healthy, 1 lesion, for every vertex.

    Raises:
        ValueError: The suffix is unknown, or the arrays are not a mesh (a coordinate
            that is not finite, an index out of range, a label other than 0 and 1).
    """
    path = Path(path)
    writers = {".ply": _ply_mesh, ".obj": _obj, ".stl": _stl, ".glb": _glb}
    write = writers.get(path.suffix.lower())
    if write is None:
        raise ValueError(
            f"{path.name}: unknown mesh format {path.suffix!r}; "
            f"use one of {', '.join(sorted(writers))}."
        )
    _check_mesh(path, vertices, faces, label)
    content = write(vertices, faces, np.asarray(label).astype(np.uint8))
    write_atomically(path, lambda file: file.write(content))


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
    elements = _read_ply(path)
    vertex = _with_properties(path, elements, ("x", "y", "z", "label"))
    face = elements.get("face")
    if face is None or face.dtype.names != ("count", "vertex_indices"):
        raise ValueError(f"{path}: the PLY file has no faces made of vertex indices.")
    if np.any(face["count"] != 3):
        raise ValueError(f"{path}: the PLY file has faces that are not triangles.")
    vertices = _columns(vertex, ("x", "y", "z"))
    faces = face["vertex_indices"].astype(np.int64).reshape(-1, 3)
    label = vertex["label"].astype(np.uint8)
    _check_mesh(path, vertices, faces, label)
    return vertices, faces, label


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
    points = np.zeros(
        len(position_mm),
        [(axis, "<f8") for axis in "xyz"] + [("species", "<u1"), ("radius", "<f4")],
    )
    for column, axis in enumerate("xyz"):
        points[axis] = position_mm[:, column]
    points["species"] = species
    points["radius"] = radius
    content = _ply_header({"vertex": points}) + points.tobytes()
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
    points = _with_properties(
        path, _read_ply(path), ("x", "y", "z", "species", "radius")
    )
    return (
        _columns(points, ("x", "y", "z")),
        points["species"].astype(np.uint8),
        points["radius"].astype(np.float32),
    )


def _check_mesh(
    path: Path, vertices: np.ndarray, faces: np.ndarray, label: np.ndarray
) -> None:
    if not np.isfinite(vertices).all():
        raise ValueError(f"{path}: the mesh has a coordinate that is not finite.")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise ValueError(f"{path}: a face names a vertex that does not exist.")
    if len(label) != len(vertices) or not np.isin(label, (0, 1)).all():
        raise ValueError(
            f"{path}: every vertex needs one label, 0 (healthy) or 1 (lesion)."
        )


def _colours(label: UInt8[np.ndarray, " m"]) -> UInt8[np.ndarray, "m 3"]:
    return np.array([HEALTHY_COLOUR, LESION_COLOUR], np.uint8)[label]


def _ply_mesh(vertices: np.ndarray, faces: np.ndarray, label: np.ndarray) -> bytes:
    vertex = np.zeros(
        len(vertices),
        [(axis, "<f8") for axis in "xyz"]
        + [(name, "<u1") for name in ("label", "red", "green", "blue")],
    )
    for column, axis in enumerate("xyz"):
        vertex[axis] = vertices[:, column]
    vertex["label"] = label
    for channel, name in enumerate(("red", "green", "blue")):
        vertex[name] = _colours(label)[:, channel]
    face = np.zeros(len(faces), [("count", "<u1"), ("vertex_indices", "<i4", 3)])
    face["count"] = 3
    face["vertex_indices"] = faces
    header = _ply_header({"vertex": vertex, "face": face})
    return header + vertex.tobytes() + face.tobytes()


def _ply_header(elements: dict[str, np.ndarray]) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", "comment unit millimetre"]
    for element, rows in elements.items():
        lines.append(f"element {element} {len(rows)}")
        for name in rows.dtype.names or ():
            kind = rows.dtype[name]
            if kind.shape:
                lines.append(f"property list uchar {_NAMES[kind.base.str]} {name}")
            elif name != "count":
                stored = kind.str.replace("|", "<")
                lines.append(f"property {_NAMES[stored]} {name}")
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")


def _obj(vertices: np.ndarray, faces: np.ndarray, label: np.ndarray) -> bytes:
    # repr gives the shortest decimal that is read as the same double.
    ink = ["{:.4f} {:.4f} {:.4f}".format(*row) for row in _colours(label) / 255.0]
    lines = ["# organ surface; unit: millimetre; vertex colours tell the lesion"]
    lines += [
        f"v {x!r} {y!r} {z!r} {colour}"
        for (x, y, z), colour in zip(
            vertices.astype(np.float64).tolist(), ink, strict=True
        )
    ]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    return ("\n".join(lines) + "\n").encode("ascii")


def _stl(vertices: np.ndarray, faces: np.ndarray, label: np.ndarray) -> bytes:
    del label
    corners = vertices[faces].reshape(-1, 3, 3)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    facet = np.zeros(
        len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")]
    )
    facet["normal"] = normal / np.where(length > 0, length, 1.0)
    facet["corners"] = corners
    # A binary STL must not begin with "solid": readers take that for the text form.
    header = b"binary STL, organ surface, unit millimetre".ljust(80)
    return header + np.array(len(faces), "<u4").tobytes() + facet.tobytes()


def _glb(vertices: np.ndarray, faces: np.ndarray, label: np.ndarray) -> bytes:
    import trimesh

    # glTF aligns attributes to four bytes: as an 8-bit number the label would be padded
    # to a vector of four, as a 32-bit float it stays one number.
    mesh = trimesh.Trimesh(
        vertices,
        faces,
        vertex_colors=_colours(label),
        vertex_attributes={"_LABEL": label.astype(np.float32)},
        metadata={"unit": "millimetre"},
        process=False,
    )
    content = trimesh.Scene({"organ": mesh}).export(file_type="glb")
    assert isinstance(content, bytes)
    return content


def _read_ply(path: Path) -> dict[str, np.ndarray]:
    """Read a binary little-endian PLY file whose lists are all triangles."""
    with path.open("rb") as file:
        content = file.read()
    head, end, body = content.partition(b"end_header\n")
    if not content.startswith(b"ply") or not end:
        raise ValueError(f"{path}: not a PLY file.")
    lines = head.decode("ascii", errors="replace").splitlines()
    if "format binary_little_endian 1.0" not in lines:
        raise ValueError(f"{path}: the PLY file is not binary and little-endian.")
    rows, offset = {}, 0
    for name, count, layout in _ply_layout(path, lines):
        size = np.dtype(layout).itemsize * count
        if offset + size > len(body):
            raise ValueError(
                f"{path}: the PLY file is cut short in its element {name!r}."
            )
        rows[name] = np.frombuffer(body, layout, count, offset)
        offset += size
    if offset != len(body):
        raise ValueError(f"{path}: the PLY file does not end where its header says.")
    return rows


def _ply_layout(
    path: Path, lines: list[str]
) -> list[tuple[str, int, list[tuple[str, str] | tuple[str, str, int]]]]:
    elements = []
    for line in lines:
        match line.split():
            case ["element", name, count] if count.isdigit():
                elements.append((name, int(count), []))
            case ["property", "list", size, kind, name] if (
                elements and size in _LITTLE_ENDIAN and kind in _LITTLE_ENDIAN
            ):
                elements[-1][2].append(("count", _LITTLE_ENDIAN[size]))
                elements[-1][2].append((name, _LITTLE_ENDIAN[kind], 3))
            case ["property", kind, name] if elements and kind in _LITTLE_ENDIAN:
                elements[-1][2].append((name, _LITTLE_ENDIAN[kind]))
            case ["element" | "property", *_]:
                raise ValueError(f"{path}: the PLY header has a bad line: {line!r}.")
    return elements


def _with_properties(
    path: Path, elements: dict[str, np.ndarray], names: tuple[str, ...]
) -> np.ndarray:
    """Return the vertices of a PLY file; raise if a property is missing."""
    rows = elements.get("vertex")
    present = () if rows is None else rows.dtype.names or ()
    missing = [name for name in names if name not in present]
    if rows is None or missing:
        raise ValueError(
            f"{path}: the PLY file's vertices have no {', '.join(missing)}."
        )
    return rows


def _columns(rows: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    return np.stack([rows[name].astype(np.float64) for name in names], axis=1)
