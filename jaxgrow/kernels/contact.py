"""The loop over pairs of `jaxgrow.energy.contact.contact_forces`."""

from typing import no_type_check

import numpy as np
from numba import cfunc

from jaxgrow.kernels import frames
from jaxgrow.kernels.closest import LENGTH, measure, OF_B, OF_C
from jaxgrow.kernels.laws import a2, branches, steepness
from jaxgrow.kernels.regrouped import regrouped
from jaxgrow.kernels.smooth_minimum import smooth_minima


@regrouped
@no_type_check
def add_up(
    position: np.ndarray,
    alive: np.ndarray,
    vertices: np.ndarray,
    particle: np.ndarray,
    corners: np.ndarray,
    real: np.ndarray,
    law: np.ndarray,
    on_particles: np.ndarray,
    on_vertices: np.ndarray,
    of_particles: np.ndarray,
    of_vertices: np.ndarray,
) -> None:
    """Add the forces of contact, and bound distances of every node to what it may meet.

    Args:
        position: of the particles, in r0.
        alive: which of them feel a force.
        vertices: of the membrane.
        particle: of each pair, ascending.
        corners: the vertices of its triangle, corner by corner.
        real: which pairs are none of the padding.
        law: contact range, stiffness, adhesion, smoothing and sharpness, stiffness and
            range of the barrier, and distance beyond which there is no contact, in
            contact ranges.
        on_particles: forces in F(0); added to.
        on_vertices: likewise.
        of_particles: distances in r0, the least so far; lowered.
        of_vertices: likewise.
    """
    scale, stiffness, adhesion = law[0], law[1], law[2]
    half, barrier, margin, reach = 0.5 * law[4], law[5], law[6], law[7]
    low, blend, edge, tail = branches(law[3], reach)
    pairs = len(real)
    while pairs > 0 and not real[pairs - 1]:
        pairs -= 1
    found = np.zeros((6, pairs))
    measure(position, particle[:pairs], vertices, corners[:, :pairs], found)
    value, u, slope = np.zeros(pairs), np.zeros(pairs), np.zeros(pairs)
    for pair in range(pairs):
        value[pair] = reach
        if real[pair]:
            length = found[LENGTH, pair]
            of_particles[particle[pair]] = min(of_particles[particle[pair]], length)
            for corner in range(3):
                node = corners[corner, pair]
                of_vertices[node] = min(of_vertices[node], length)
            value[pair] = length / scale
    smooth_minima(particle[:pairs], value, half, reach, u, slope)
    push = 0.0
    for pair in range(pairs):
        i = particle[pair]
        if pair == 0 or i != particle[pair - 1]:
            push = stiffness * a2(u[pair], adhesion, low, blend, edge, tail)
            push += barrier * steepness(u[pair], margin)
        if slope[pair] > 0.0 and alive[i]:
            size = push * slope[pair] / found[LENGTH, pair]
            v, w = found[OF_B, pair], found[OF_C, pair]
            for axis in range(3):
                part = size * found[axis, pair]
                on_particles[i, axis] += part
                on_vertices[corners[0, pair], axis] -= part * (1.0 - v - w)
                on_vertices[corners[1, pair], axis] -= part * v
                on_vertices[corners[2, pair], axis] -= part * w


@cfunc(frames.HANDLER, cache=True)
@no_type_check
def handler(frame: int) -> int:
    """For XLA: arguments and results as of `add_up`."""
    if frames.answers_version(frame):
        return 0
    count, corners = frames.size(frame, 0, 0), frames.size(frame, 2, 0)
    pairs = frames.size(frame, 3, 0)
    on_particles = frames.reals(frames.result(frame, 0), (count, 3))
    on_vertices = frames.reals(frames.result(frame, 1), (corners, 3))
    of_particles = frames.reals(frames.result(frame, 2), (count,))
    of_vertices = frames.reals(frames.result(frame, 3), (corners,))
    on_particles[:], on_vertices[:] = 0.0, 0.0
    of_particles[:], of_vertices[:] = np.inf, np.inf
    add_up(
        frames.reals(frames.argument(frame, 0), (count, 3)),
        frames.booleans(frames.argument(frame, 1), (count,)),
        frames.reals(frames.argument(frame, 2), (corners, 3)),
        frames.indices(frames.argument(frame, 3), (pairs,)),
        frames.long_indices(frames.argument(frame, 4), (3, pairs)),
        frames.booleans(frames.argument(frame, 5), (pairs,)),
        frames.reals(frames.argument(frame, 6), (8,)),
        on_particles,
        on_vertices,
        of_particles,
        of_vertices,
    )
    return 0
