"""Readers of organ files: OBJ, PLY, STL, GLB and OFF, through trimesh."""

from __future__ import annotations

import io
import logging
import re
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from jaxgrow.organ.organ import Organ
from jaxgrow.organ.validity import (
    check_surface,
    is_closed_manifold,
    merge_duplicates,
    OrganError,
)


FORMATS = (".obj", ".ply", ".stl", ".glb", ".off")
"""Supported formats, by the file's suffix."""


def load_organ(
    path: str | Path,
    *,
    unit_mm: float = 1.0,
    tissue: Literal["outside", "inside"] = "outside",
) -> Organ:
    """Read an organ's surface and validate it.

    Vertices keep the file's order and, where ``unit_mm`` is 1, their exact coordinates.
    STL has no shared vertices at all and GLB splits them at seams of normals and
    textures, so in these two formats exactly coincident vertices are merged, in the
    order of first occurrence; in the others duplicates are an error. The node
    transforms of a GLB scene are applied.

    Args:
        path: The file; its suffix gives the format.
        unit_mm: Length of the file's unit in mm.
        tissue: On which side of the surface the tissue lies.

    Returns:
        The organ, named after the file, without named sites.

    Raises:
        OrganError: With one sentence if the file or its surface cannot be used.
    """
    path = Path(path)
    if not (np.isfinite(unit_mm) and unit_mm > 0):
        msg = (
            f"unit_mm is {unit_mm:g}, but the length of the file's unit in mm must be "
            "a positive number: give 1 for mm, 10 for cm, 1000 for m."
        )
        raise OrganError(msg)
    _check_file(path)
    vertices, faces = _read(path)
    if path.suffix.lower() in {".stl", ".glb"} and len(faces):
        joined = merge_duplicates(vertices, faces)
        # a surface that is closed as it stands keeps the file's vertices
        if not is_closed_manifold(faces):
            vertices, faces = joined
    vertices = vertices * unit_mm if unit_mm != 1 else vertices
    check_surface(vertices, faces, path.name)
    return Organ(path.name, vertices, faces, tissue)


def _check_file(path: Path) -> None:
    if path.suffix.lower() not in FORMATS:
        msg = (
            f"{path} does not end in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}, the "
            "formats that an organ is read from: convert it, for example with trimesh."
        )
        raise OrganError(msg)
    if not path.is_file():
        kind = "is a folder" if path.is_dir() else "does not exist"
        msg = f"{path} {kind}, but an organ is read from a mesh file: check the path."
        raise OrganError(msg)
    if path.stat().st_size == 0:
        msg = f"{path} is empty (0 bytes), but a mesh is wanted: export it again."
        raise OrganError(msg)


def _read(
    path: Path,
) -> tuple[Float[np.ndarray, "m 3"], Int[np.ndarray, "f 3"]]:
    kind = path.suffix.lower()[1:]
    import trimesh  # not above: it takes a third of a second to import

    # trimesh logs complaints about files that we then refuse with a message
    logger = logging.getLogger("trimesh")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        data = path.read_bytes()
        if kind == "obj":
            data = _positions_only(data)
        loaded = trimesh.load_scene(
            io.BytesIO(data), file_type=kind, process=False, maintain_order=True
        )
        pieces = loaded.dump()
    except OSError as error:
        msg = f"{path} cannot be read ({error.strerror}): check its permissions."
        raise OrganError(msg) from error
    # parsers may raise anything on a damaged file
    except Exception as error:
        msg = (
            f"{path} is no {kind.upper()} mesh that can be read "
            f"({_first_line(error)}): check that its content fits its ending, or "
            "export it again."
        )
        raise OrganError(msg) from error
    finally:
        logger.setLevel(level)
    meshes = [piece for piece in pieces if isinstance(piece, trimesh.Trimesh)]
    if len(meshes) > 1:
        names = ", ".join(sorted(map(str, loaded.geometry))[:4])
        msg = (
            f"{path} holds {len(meshes)} geometries ({names}), but an organ is a "
            "single surface: export the one you mean alone."
        )
        raise OrganError(msg)
    if not meshes or len(meshes[0].faces) == 0:
        points = sum(len(getattr(piece, "vertices", ())) for piece in pieces)
        msg = (
            f"{path} holds no triangles (only {points} points), but an organ is a "
            "triangulated surface: export it as a mesh with faces, or check that its "
            "content fits its ending."
        )
        raise OrganError(msg)
    vertices = np.array(meshes[0].vertices, dtype=np.float64)
    faces = np.array(meshes[0].faces, dtype=np.int64)
    return vertices, faces


def _positions_only(data: bytes) -> bytes:
    """Strip normals, textures and groups from the text of an OBJ file.

    trimesh splits the vertices of an OBJ file wherever two triangles refer to
    different normals or texture coordinates; the surface has no such seams.
    """
    text = data.decode("utf-8", errors="replace").replace("\\\n", " ")
    kept = []
    for line in text.splitlines():
        words = line.split()
        if words and words[0] == "v":
            kept.append(line.strip())
        elif words and words[0] == "f":
            kept.append(re.sub(r"/\S*", "", line.strip()))
    return "\n".join(kept).encode()


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0].rstrip(".:")[:120] if lines else type(error).__name__
