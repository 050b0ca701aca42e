"""Binary glTF: single precision, vertex attributes and colours."""

import numpy as np

from jaxgrow.io.formats.format import SurfaceMesh


class Glb:
    """File format with each vertex attribute as ``_NAME``, a 32-bit float.

    Coordinates are millimetres, though the format's convention is the metre; the unit
    is noted in the file's extras.
    """

    suffix = "glb"

    def write(self, mesh: SurfaceMesh) -> bytes:
        """Return the content of the mesh's file."""
        import trimesh

        # glTF aligns attributes to four bytes: as an 8-bit number the label would be
        # padded to a vector of four, as a 32-bit float it stays one number.
        surface = trimesh.Trimesh(
            mesh.vertices,
            mesh.faces,
            vertex_colors=mesh.colours,
            vertex_attributes={
                f"_{name.upper()}": np.asarray(values).astype(np.float32)
                for name, values in mesh.attributes.items()
            },
            metadata={"unit": "millimetre"},
            process=False,
        )
        content = trimesh.Scene({"organ": surface}).export(file_type="glb")
        assert isinstance(content, bytes)
        return content
