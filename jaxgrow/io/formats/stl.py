"""Binary STL: triangles with normals in single precision."""

import numpy as np

from jaxgrow.io.formats.format import SurfaceMesh


class Stl:
    """File format without vertex attributes and without shared vertices."""

    suffix = "stl"

    def write(self, mesh: SurfaceMesh) -> bytes:
        """Return the content of the mesh's file."""
        corners = mesh.vertices[mesh.faces].reshape(-1, 3, 3)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        facet = np.zeros(
            len(corners),
            [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")],
        )
        facet["normal"] = normal / np.where(length > 0, length, 1.0)
        facet["corners"] = corners
        # A binary STL must not begin with "solid": readers take that for the text form.
        header = b"binary STL, organ surface, unit millimetre".ljust(80)
        return header + np.array(len(corners), "<u4").tobytes() + facet.tobytes()
