"""What is near to a few of many points, on the host."""

import numpy as np
from jaxtyping import Bool, Float

from jaxgrow.kernels import loops


def near_seeds(
    points: Float[np.ndarray, "n 3"] | None,
    seeds: Float[np.ndarray, "k 3"],
    radius: float,
) -> Bool[np.ndarray, " n"]:
    """Which points are within a radius of a seed."""
    if points is None or len(seeds) == 0:
        return np.zeros(0 if points is None else len(points), bool)
    near = np.zeros(len(points), bool)
    loops("vicinity").near(_exact(points), _exact(seeds), radius, near)
    return near


def may_coincide(
    points: Float[np.ndarray, "n 3"], chosen: Bool[np.ndarray, " n"]
) -> bool:
    """Whether two of the chosen points are the same."""
    return bool(loops("twins").any_same(_exact(points), chosen))


def _exact(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """For a loop: in 64 bits, and read only, so that one of it is compiled."""
    exact = np.ascontiguousarray(points, np.float64).view()
    exact.flags.writeable = False
    return exact
