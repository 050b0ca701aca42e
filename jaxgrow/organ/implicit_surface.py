"""Implicit surfaces: round cones, smoothly united.

A body is the set where a field is negative; its surface is the zero set. The field of
a round cone (the hull of two spheres) is its signed distance, so a union of them is
nearly one too, and a Newton step along the gradient lands on the surface.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float


Field = Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n"]]


def round_cone(
    points: Float[np.ndarray, "n 3"],
    start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
    start_radius: float,
    end_radius: float,
) -> Float[np.ndarray, "n"]:
    """Compute the signed distance to a round cone, negative inside.

    A round cone is the convex hull of two spheres. In the plane of a point and the axis
    the hull is bounded by two arcs and the tangent that touches both; the point's side
    of the tangent's two end normals decides which of the three is nearest.

    Args:
        points: Evaluation points.
        start: Centre of the first sphere.
        end: Centre of the second sphere.
        start_radius: Radius of the first sphere.
        end_radius: Radius of the second sphere.

    Returns:
        Signed distances, in the unit of the arguments.

    Raises:
        ValueError: If one sphere contains the other, so that there is no tangent.
    """
    axis = end - start
    length = float(np.linalg.norm(axis))
    slope = (start_radius - end_radius) / length if length > 0 else np.inf
    if abs(slope) >= 1:
        msg = (
            f"a round cone with radii {start_radius:g} and {end_radius:g} needs "
            f"centres further apart than their difference, not {length:g}; move them "
            "apart."
        )
        raise ValueError(msg)
    axis = axis / length
    cosine = np.sqrt(1 - slope * slope)
    offset = points - start
    along = offset @ axis
    across = np.linalg.norm(offset - along[:, None] * axis, axis=1)
    # position of the foot on the axis, measured along the tangent's normal
    foot = along - across * slope / cosine
    side = across * cosine + along * slope - start_radius
    first = np.hypot(along, across) - start_radius
    second = np.hypot(along - length, across) - end_radius
    return np.where(foot < 0, first, np.where(foot > length, second, side))


def smooth_union(
    distances: Float[np.ndarray, "parts n"], blend: float
) -> Float[np.ndarray, "n"]:
    """Unite bodies with rounded seams: -b log Σ exp(-d / b).

    Never above the smallest distance and at most b log(parts) below it, so it fills
    the seams by about b log 2.

    Args:
        distances: Signed distances to the parts, one row a part.
        blend: Width b of the seams, in the unit of the distances, positive.
    """
    lowest = distances.min(axis=0)
    return lowest - blend * np.log(np.exp((lowest - distances) / blend).sum(axis=0))


def gradient(
    field: Field, points: Float[np.ndarray, "n 3"], step: float
) -> Float[np.ndarray, "n 3"]:
    """Compute a field's gradient by central differences of half-width step."""
    shifts = step * np.eye(3)
    columns = [field(points + shift) - field(points - shift) for shift in shifts]
    return np.stack(columns, axis=1) / (2 * step)


def project(
    field: Field,
    points: Float[np.ndarray, "n 3"],
    *,
    step: float,
    iterations: int,
) -> Float[np.ndarray, "n 3"]:
    """Project points onto the surface by Newton steps -f ∇f / |∇f|².

    Args:
        field: The field, zero on the surface.
        points: Points near the surface.
        step: Half-width of the differences that give ∇f.
        iterations: Number of Newton steps; each about squares the error.
    """
    for _ in range(iterations):
        slope = gradient(field, points, step)
        square = np.maximum(np.einsum("ij,ij->i", slope, slope), 1e-12)
        points = points - (field(points) / square)[:, None] * slope
    return points
