"""What is near to a few of many points, on the host."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree


def near_seeds(
    points: Float[np.ndarray, "n 3"] | None,
    seeds: Float[np.ndarray, "k 3"],
    radius: float,
) -> Bool[np.ndarray, " n"]:
    """Which points are within a radius of a seed."""
    if points is None or len(seeds) == 0:
        return np.zeros(0 if points is None else len(points), bool)
    low, high = seeds.min(axis=0) - radius, seeds.max(axis=0) + radius
    near = np.all((points >= low) & (points <= high), axis=1)
    candidates = np.flatnonzero(near)
    distance, _ = KDTree(seeds).query(
        points[candidates], distance_upper_bound=radius, workers=1
    )
    near[candidates] = np.isfinite(distance)
    return near
