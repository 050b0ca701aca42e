"""Binary PLY: coordinates and vertex attributes to the last bit."""

from pathlib import Path

import numpy as np

from jaxgrow.io.formats.format import LABEL, SurfaceMesh


_LITTLE_ENDIAN = {
    "char": "<i1", "int8": "<i1", "uchar": "<u1", "uint8": "<u1",
    "short": "<i2", "int16": "<i2", "ushort": "<u2", "uint16": "<u2",
    "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4",
    "float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8",
}  # fmt: skip
_NAMES = {"<u1": "uchar", "<i4": "int", "<f4": "float", "<f8": "double"}


class Ply:
    """File format with each vertex attribute as a property of its name.

    The label is an 8-bit number, other whole numbers and truth values are 32-bit
    numbers, and floats are kept as they are.
    """

    suffix = "ply"

    def write(self, mesh: SurfaceMesh) -> bytes:
        """Return the content of the mesh's file."""
        more = {
            name: np.asarray(values)
            for name, values in mesh.attributes.items()
            if name != LABEL
        }
        columns = {
            **dict(zip("xyz", mesh.vertices.T.astype("<f8"), strict=True)),
            LABEL: mesh.label,
            **{name: values.astype(_stored(values)) for name, values in more.items()},
            **dict(zip(("red", "green", "blue"), mesh.colours.T, strict=True)),
        }
        face = np.zeros(
            len(mesh.faces), [("count", "<u1"), ("vertex_indices", "<i4", 3)]
        )
        face["count"] = 3
        face["vertex_indices"] = mesh.faces
        return write_elements({"vertex": as_rows(columns), "face": face})


def _stored(values: np.ndarray) -> str:
    """Return the type of number that keeps an attribute."""
    if values.dtype == np.uint8:
        return "<u1"
    if values.dtype.kind == "f":
        return "<f4" if values.dtype.itemsize <= 4 else "<f8"
    return "<i4"


def as_rows(columns: dict[str, np.ndarray]) -> np.ndarray:
    """Return named columns as rows of a PLY element."""
    count = len(next(iter(columns.values())))
    rows = np.zeros(count, [(name, each.dtype) for name, each in columns.items()])
    for name, each in columns.items():
        rows[name] = each
    return rows


def write_elements(elements: dict[str, np.ndarray]) -> bytes:
    """Return the content of a binary little-endian PLY file.

    Args:
        elements: rows by name. A list of three numbers is a column with that shape
            after a column ``count``.
    """
    body = b"".join(rows.tobytes() for rows in elements.values())
    return _header(elements) + body


def _header(elements: dict[str, np.ndarray]) -> bytes:
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


def read_elements(path: Path) -> dict[str, np.ndarray]:
    """Read a binary little-endian PLY file whose lists are all triangles.

    Raises:
        ValueError: the file is not such a file, or is truncated.
    """
    with path.open("rb") as file:
        content = file.read()
    head, end, body = content.partition(b"end_header\n")
    if not content.startswith(b"ply") or not end:
        raise ValueError(f"{path}: not a PLY file.")
    lines = head.decode("ascii", errors="replace").splitlines()
    if "format binary_little_endian 1.0" not in lines:
        raise ValueError(f"{path}: the PLY file is not binary and little-endian.")
    rows, offset = {}, 0
    for name, count, layout in _layout(path, lines):
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


def _layout(
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


def with_properties(
    path: Path, elements: dict[str, np.ndarray], names: tuple[str, ...]
) -> np.ndarray:
    """Return the vertices of a PLY file.

    Raises:
        ValueError: they lack one of the named properties.
    """
    rows = elements.get("vertex")
    present = () if rows is None else rows.dtype.names or ()
    missing = [name for name in names if name not in present]
    if rows is None or missing:
        raise ValueError(
            f"{path}: the PLY file's vertices have no {', '.join(missing)}."
        )
    return rows
