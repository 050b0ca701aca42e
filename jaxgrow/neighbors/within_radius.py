"""Search for points within a radius of a few seeds, on the host."""

import numpy as np
from jaxtyping import Bool, Float

from jaxgrow.kernels import loops


def near_seeds(
    points: Float[np.ndarray, "n 3"] | None,
    seeds: Float[np.ndarray, "k 3"],
    radius: float,
) -> Bool[np.ndarray, " n"]:
    """Mark the points within a radius of a seed."""
    if points is None or len(seeds) == 0:
        return np.zeros(0 if points is None else len(points), bool)
    near = np.zeros(len(points), bool)
    loops("vicinity").near(_exact(points), _exact(seeds), radius, near)
    return near


def may_coincide(
    points: Float[np.ndarray, "n 3"], chosen: Bool[np.ndarray, " n"]
) -> bool:
    """Return whether two of the chosen points coincide."""
    return bool(loops("twins").any_same(_exact(points), chosen))


def _exact(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Convert points to read-only 64-bit arrays, for one compiled signature."""
    exact = np.ascontiguousarray(points, np.float64).view()
    exact.flags.writeable = False
    return exact
