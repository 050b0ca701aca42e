"""The loop over the springs of `jaxgrow.energy.springs.spring_energy`."""

import math
from typing import no_type_check

import numpy as np

from jaxgrow.kernels.regrouped import regrouped


@regrouped
@no_type_check
def add_up(
    vertices: np.ndarray,
    edges: np.ndarray,
    rest_length: np.ndarray,
    alive: np.ndarray,
    stiffness: float,
    pretension: float,
    force: np.ndarray,
) -> None:
    """Add the forces of the springs; one of length 0 has none.

    Args:
        vertices: in r0.
        edges: the two ends of each.
        rest_length: of each, in r0.
        alive: which of them are none of the padding.
        stiffness: in F(0)/r0.
        pretension: share of the length at the last reset that is taken off.
        force: on the vertices, in F(0); added to.
    """
    for edge in range(len(edges)):
        if not alive[edge]:
            continue
        i, j = edges[edge, 0], edges[edge, 1]
        dx = vertices[j, 0] - vertices[i, 0]
        dy = vertices[j, 1] - vertices[i, 1]
        dz = vertices[j, 2] - vertices[i, 2]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if length == 0.0:
            continue
        pull = 1.0 - (1.0 - pretension) * rest_length[edge] / length
        pull *= stiffness
        force[i, 0] += pull * dx
        force[i, 1] += pull * dy
        force[i, 2] += pull * dz
        force[j, 0] -= pull * dx
        force[j, 1] -= pull * dy
        force[j, 2] -= pull * dz
