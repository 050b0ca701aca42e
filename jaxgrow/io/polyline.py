"""Closed polyline in an OBJ file, which 3-D programs load as a curve."""

from __future__ import annotations

import os

import numpy as np
from jaxtyping import Float

from jaxgrow.runtime.atomic_file import write_atomically


def write_polyline(
    path: str | os.PathLike[str], points: Float[np.ndarray, "k 3"]
) -> None:
    """Write a closed polyline as one line element of an OBJ file.

    Every number is the shortest decimal that is read as the same double.

    Args:
        path: The file to write; an existing one is replaced atomically.
        points: In order, mm; the last one is joined to the first.

    Raises:
        ValueError: There are fewer than three points, or a number is not finite.
    """
    if len(points) < 3 or not np.isfinite(points).all():
        raise ValueError(
            f"{os.fspath(path)}: {len(points)} points were given, but a closed line "
            "needs three or more, all finite."
        )
    lines = ["# ring round the base of a lesion; unit: millimetre"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in points.astype(float).tolist()]
    lines.append("l " + " ".join(map(str, [*range(1, len(points) + 1), 1])))
    content = ("\n".join(lines) + "\n").encode("ascii")
    write_atomically(path, lambda file: file.write(content))
