"""Ray casting with embreex, or with a z-buffer.

Both find the triangle that a sample sees, with the same data. Only embreex can also
test whether an object blocks a short ray, which shadows and ambient occlusion need;
without it pictures have neither.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from jaxgrow.render.camera import Camera
from jaxgrow.render.zbuffer import nearest_fragments, rasterise


@dataclass(frozen=True)
class Hits:
    """First hits of the samples of a picture.

    Attributes:
        face: Index of the triangle, -1 for none.
        u: Barycentric weight of the triangle's second corner.
        v: Barycentric weight of its third corner.
        distance: Length of the ray, mm; infinite for none.
    """

    face: Int[np.ndarray, " p"]
    u: Float32[np.ndarray, " p"]
    v: Float32[np.ndarray, " p"]
    distance: Float32[np.ndarray, " p"]


class Tracer(ABC):
    """Tracer of the first triangle along a ray.

    Attributes:
        at_once: Whether all samples of a camera cost as much as a few of them.
    """

    at_once: ClassVar[bool]

    @abstractmethod
    def first_hit(self, camera: Camera, at: Int[np.ndarray, " h"]) -> Hits:
        """Find the first triangle behind samples of the camera."""

    @abstractmethod
    def blocked(
        self,
        start: Float32[np.ndarray, "r 3"],
        direction: Float32[np.ndarray, "r 3"],
        length: Float32[np.ndarray, " r"],
    ) -> Bool[np.ndarray, " r"] | None:
        """Test whether rays of a length (mm) meet a triangle.

        ``start`` is relative to the origin that the tracer was made with. The result is
        None if the tracer cannot cast such rays.
        """


def make_tracer(
    triangles: Float[np.ndarray, "f 3 3"], origin: Float[np.ndarray, "3"]
) -> Tracer:
    """Prepare triangles for ray casting.

    Args:
        triangles: Corners, mm.
        origin: Point near the middle of the picture, mm. Rays are cast in single
            precision relative to it, so that no digits are lost for organs far from
            zero.

    Returns:
        The embreex tracer, or the z-buffer where embreex cannot be imported.
    """
    try:
        rtcore_scene = import_module("embreex.rtcore_scene")
        mesh_construction = import_module("embreex.mesh_construction")
    except ImportError:
        return ZBufferTracer(triangles)
    scene = rtcore_scene.EmbreeScene(robust=True)
    if len(triangles):
        corners = np.ascontiguousarray(triangles - origin, dtype=np.float32)
        mesh_construction.TriangleMesh(scene, corners)
    return EmbreeTracer(scene, len(triangles), origin)


@dataclass(frozen=True)
class EmbreeTracer(Tracer):
    """Ray tracer by Embree's bounding volume hierarchy.

    Attributes:
        scene: The embreex scene.
        count: Number of triangles in it.
        origin: Origin of the scene's coordinates, mm.
    """

    scene: Any
    count: int
    origin: Float[np.ndarray, "3"]

    at_once = False

    def first_hit(self, camera: Camera, at: Int[np.ndarray, " h"]) -> Hits:
        """Find the first triangle behind samples of the camera."""
        if self.count == 0 or len(at) == 0:
            return no_hits(len(at))
        start = camera.points(at, np.zeros(len(at), np.float32))
        start += (camera.centre - self.origin).astype(np.float32)
        direction = camera.forward.astype(np.float32)[None]
        found = self.scene.run(start, direction, output=1)
        missed = found["primID"] < 0
        distance = np.where(missed, np.float32(np.inf), found["tfar"])
        return Hits(found["primID"], found["u"], found["v"], distance)

    def blocked(
        self,
        start: Float32[np.ndarray, "r 3"],
        direction: Float32[np.ndarray, "r 3"],
        length: Float32[np.ndarray, " r"],
    ) -> Bool[np.ndarray, " r"] | None:
        """Test whether rays of a length (mm) meet a triangle."""
        if self.count == 0 or len(start) == 0:
            return np.zeros(len(start), bool)
        return self.scene.run(start, direction, dists=length, query="OCCLUDED") == 0


@dataclass(frozen=True)
class ZBufferTracer(Tracer):
    """Rasteriser: no shadows, no occlusion, but needs numpy only.

    Attributes:
        triangles: Corners, mm.
    """

    triangles: Float[np.ndarray, "f 3 3"]

    at_once = True

    def first_hit(self, camera: Camera, at: Int[np.ndarray, " h"]) -> Hits:
        """Find the first triangle behind samples of the camera."""
        fragments = rasterise(camera.to_view(self.triangles), camera.pixels)
        nothing = no_hits(camera.pixels**2)
        buffers = (nothing.face, nothing.u, nothing.v, nothing.distance)
        filled = nearest_fragments(fragments, buffers)
        return Hits(*(buffer[at] for buffer in filled))

    def blocked(
        self,
        start: Float32[np.ndarray, "r 3"],
        direction: Float32[np.ndarray, "r 3"],
        length: Float32[np.ndarray, " r"],
    ) -> Bool[np.ndarray, " r"] | None:
        """Return None: a z-buffer only has what the camera sees."""
        del start, direction, length
        return None


def no_hits(samples: int) -> Hits:
    """Return the hits of a picture in which no sample sees anything."""
    zero = np.zeros(samples, np.float32)
    return Hits(
        np.full(samples, -1, np.int32),
        zero,
        zero.copy(),
        np.full(samples, np.inf, np.float32),
    )
