"""Two organ surfaces that nobody here made, as PLY files.

    python experiments/studies/organs.py FOLDER

writes ``frog-large-intestine.ply`` and ``human-brain-left.ply`` (binary, double
precision) and prints what each is like. It needs pyvista, nilearn (with nibabel) and
scipy; jaxgrow itself needs none but the last.

frog-large-intestine.ply
    A hollow organ: ``load_organ(..., tissue="outside")``, ``unit_mm`` 1. Label 9 of
    the segmented frog (Whole Frog Project, Lawrence Berkeley National Laboratory,
    1994: photographs of a sectioned frog, labelled by hand), as it comes inside the
    wheel of pyvista (``pyvista.examples.load_frog_tissues``; pyvista is MIT licensed,
    the labels come from VTK's example data). The largest connected piece of the
    label, its enclosed holes filled, is blurred by 1.5 units, contoured at one half
    and smoothed without shrinking (Taubin). The lesion grows into the space that the
    label fills, the gut with its contents.

    Unit: the volume's spacing (1, 1, 1.5) has no stated unit. A leopard frog of 80 mm
    from snout to vent would make it about 0.24 mm. Taken as 1 mm, the gut is 100 mm
    long and about 50 mm wide, the calibre of a human colon, so that lesions of human
    size fit it: that is what we do. Give ``unit_mm=0.24`` for the frog's own size.

human-brain-left.ply
    A solid organ: ``load_organ(..., tissue="inside")``, ``unit_mm`` 1. The pial
    surface of the left hemisphere of fsaverage5, the average of 40 people's cortex
    (Fischl, Sereno, Tootell & Dale, Human Brain Mapping 8:272-284, 1999; part of
    FreeSurfer, under the FreeSurfer software licence), as it comes inside the wheel
    of nilearn (BSD; it states the template's licence as unknown). In mm already. Its
    triangles are cut in four: with edges of 3 mm it is too coarse for a lesion of
    particles of 1.2 mm, which ends with ``SLIVER`` there.

Neither file is part of this repository.
"""

from __future__ import annotations

import sys
from importlib.resources import files as resources
from pathlib import Path

import nibabel
import numpy as np
import pyvista
import trimesh
from jaxtyping import Float, Int
from scipy import ndimage


LARGE_INTESTINE = 9
"""Its label in the frog."""

BLUR = 1.5
"""Standard deviation of the blur, in units of the volume's spacing in x and y."""

PADDING = 10
"""Empty voxels around the label, so that the contour closes."""


def frog_large_intestine() -> tuple[Float[np.ndarray, "m 3"], Int[np.ndarray, "f 3"]]:
    """Closed contour of the large intestine of the segmented frog."""
    volume = pyvista.examples.load_frog_tissues()
    spacing = np.array(volume.spacing)
    labels = np.asarray(volume.active_scalars).reshape(volume.dimensions, order="F")
    inside = labels == LARGE_INTESTINE
    where = np.argwhere(inside)
    low = np.maximum(where.min(axis=0) - PADDING, 0)
    high = where.max(axis=0) + PADDING + 1
    inside = inside[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    pieces, _ = ndimage.label(inside)
    largest = 1 + np.argmax(np.bincount(pieces.ravel())[1:])
    inside = ndimage.binary_fill_holes(pieces == largest)
    blurred = ndimage.gaussian_filter(inside.astype(float), BLUR / spacing)
    image = pyvista.ImageData(
        dimensions=blurred.shape, spacing=spacing, origin=low * spacing
    )
    image["inside"] = blurred.ravel(order="F")
    contour = image.contour([0.5], scalars="inside", method="flying_edges")
    contour = contour.connectivity("largest").triangulate().clean()
    contour = contour.smooth_taubin(n_iter=60, pass_band=0.05)
    vertices = np.asarray(contour.points, dtype=float)
    return vertices, contour.faces.reshape(-1, 4)[:, 1:].astype(np.int64)


def human_brain_left() -> tuple[Float[np.ndarray, "m 3"], Int[np.ndarray, "f 3"]]:
    """Pial surface of the left hemisphere of fsaverage5, its triangles cut in four."""
    folder = resources("nilearn.datasets").joinpath("data", "fsaverage5")
    surface = nibabel.load(str(folder.joinpath("pial_left.gii.gz")))
    vertices = surface.agg_data("pointset").astype(float)
    return trimesh.remesh.subdivide(vertices, surface.agg_data("triangle"))


def outward(
    vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
) -> Int[np.ndarray, "f 3"]:
    """Faces turned so that the closed surface's volume is positive."""
    a, b, c = (vertices[faces[:, k]] - vertices.mean(axis=0) for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    return faces if volume > 0 else np.ascontiguousarray(faces[:, ::-1])


def write_ply(
    path: Path, vertices: Float[np.ndarray, "m 3"], faces: Int[np.ndarray, "f 3"]
) -> None:
    """Binary little-endian PLY with double coordinates."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(faces), dtype=[("count", "u1"), ("corner", "<i4", 3)])
    rows["count"] = 3
    rows["corner"] = faces
    path.write_bytes(
        header.encode() + vertices.astype("<f8").tobytes() + rows.tobytes()
    )


def main(folder: Path) -> None:
    """Write both files into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, make in (
        ("frog-large-intestine", frog_large_intestine),
        ("human-brain-left", human_brain_left),
    ):
        vertices, faces = make()
        faces = outward(vertices, faces)
        path = folder / f"{name}.ply"
        write_ply(path, vertices, faces)
        extent = np.ptp(vertices, axis=0)
        sys.stdout.write(
            f"{path}: {len(vertices)} vertices, {len(faces)} triangles, "
            f"{extent[0]:.0f} x {extent[1]:.0f} x {extent[2]:.0f} mm\n"
        )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python experiments/studies/organs.py FOLDER")
    main(Path(sys.argv[1]))
