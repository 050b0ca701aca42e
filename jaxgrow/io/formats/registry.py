"""Registry of the formats that an organ is written in."""

from collections.abc import Iterable

from jaxgrow.io.formats.format import MeshFormat
from jaxgrow.io.formats.glb import Glb
from jaxgrow.io.formats.obj import Obj
from jaxgrow.io.formats.ply import Ply
from jaxgrow.io.formats.stl import Stl


_BUILT_IN: tuple[MeshFormat, ...] = (Ply(), Obj(), Stl(), Glb())

FORMATS: dict[str, MeshFormat] = {each.suffix: each for each in _BUILT_IN}
"""Registered formats, by suffix; those of `write_run` and of the command."""


def register_format(mesh_format: MeshFormat) -> MeshFormat:
    """Register a mesh format for `jaxgrow.write_run` and the command.

    A format of the same suffix is replaced.

    Args:
        mesh_format: an object with a ``suffix`` and a method ``write``.

    Raises:
        TypeError: the object has no such attribute or method.
        ValueError: the suffix is not lower-case letters and digits, or is ``ply``,
            from which runs are read.
    """
    if isinstance(mesh_format, type) or not isinstance(mesh_format, MeshFormat):
        raise TypeError(
            f"{mesh_format!r} is no mesh format; give an object with a suffix and a "
            "method write(mesh) that returns bytes."
        )
    suffix = mesh_format.suffix
    if not (suffix.isascii() and suffix.isalnum() and suffix == suffix.lower()):
        raise ValueError(
            f"the suffix of a format is {suffix!r}; give lower-case letters and digits "
            "without a dot."
        )
    if suffix == Ply.suffix:
        raise ValueError(
            "the format ply cannot be replaced: runs are read from it; choose another "
            "suffix."
        )
    FORMATS[suffix] = mesh_format
    return mesh_format


def check_formats(names: Iterable[str]) -> None:
    """Raise if a format is not registered.

    Raises:
        ValueError: names the first that is unknown, and those that are known.
    """
    for name in names:
        if name not in FORMATS:
            raise ValueError(f"format {name!r} is unknown; use {', '.join(FORMATS)}.")
