"""Wavefront OBJ: decimal coordinates that are read as the same doubles."""

from jaxgrow.io.formats.format import SurfaceMesh


class Obj:
    """File format with vertex colours and no other vertex attributes."""

    suffix = "obj"

    def write(self, mesh: SurfaceMesh) -> bytes:
        """Return the content of the mesh's file."""
        ink = ["{:.4f} {:.4f} {:.4f}".format(*row) for row in mesh.colours / 255.0]
        lines = ["# organ surface; unit: millimetre; vertex colours tell the lesion"]
        # repr gives the shortest decimal that is read as the same double
        lines += [
            f"v {x!r} {y!r} {z!r} {colour}"
            for (x, y, z), colour in zip(
                mesh.vertices.astype("<f8").tolist(), ink, strict=True
            )
        ]
        lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
        return ("\n".join(lines) + "\n").encode("ascii")
