"""What is near to a few of many points, on the host."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from jaxgrow.kernels import loops


def near_seeds(
    points: Float[np.ndarray, "n 3"] | None,
    seeds: Float[np.ndarray, "k 3"],
    radius: float,
) -> Bool[np.ndarray, " n"]:
    """Which points are within a radius of a seed; by a loop where there is one."""
    if points is None or len(seeds) == 0:
        return np.zeros(0 if points is None else len(points), bool)
    kernel = loops("vicinity")
    if kernel is None:
        return _near_by_tree(points, seeds, radius)
    near = np.zeros(len(points), bool)
    kernel.near(_exact(points), _exact(seeds), radius, near)
    return near


def may_coincide(
    points: Float[np.ndarray, "n 3"], chosen: Bool[np.ndarray, " n"]
) -> bool:
    """Whether two of the chosen points are the same, or there is no loop that tells."""
    kernel = loops("twins")
    return kernel is None or bool(kernel.any_same(_exact(points), chosen))


def _exact(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """For a loop: in 64 bits, and read only, so that one of it is compiled."""
    exact = np.ascontiguousarray(points, np.float64).view()
    exact.flags.writeable = False
    return exact


def _near_by_tree(
    points: Float[np.ndarray, "n 3"], seeds: Float[np.ndarray, "k 3"], radius: float
) -> Bool[np.ndarray, " n"]:
    low, high = seeds.min(axis=0) - radius, seeds.max(axis=0) + radius
    near = np.all((points >= low) & (points <= high), axis=1)
    candidates = np.flatnonzero(near)
    distance, _ = KDTree(seeds).query(
        points[candidates], distance_upper_bound=radius, workers=1
    )
    near[candidates] = np.isfinite(distance)
    return near
