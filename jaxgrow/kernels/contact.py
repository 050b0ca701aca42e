"""Loops over pairs of a particle and a triangle, for a printed law.

The law is a function of the smooth minimum of distances (`jaxgrow.energy.contact`).
This module has the geometry: distances, their smooth minimum, and the derivatives of
both with respect to the nodes.
"""

from typing import Any, no_type_check

import numpy as np

from jaxgrow.kernels.closest import LENGTH, OF_B, OF_C
from jaxgrow.kernels.regrouped import regrouped
from jaxgrow.kernels.smooth_distance import (
    add_bent,
    add_squares,
    approach,
    smooth_distances,
)
from jaxgrow.kernels.smooth_minimum import smooth_changes


@regrouped
@no_type_check
def _without_padding(real: np.ndarray) -> int:
    """Count the pairs up to the padding at the end."""
    pairs = len(real)
    while pairs > 0 and not real[pairs - 1]:
        pairs -= 1
    return pairs


@regrouped
@no_type_check
def add_forces(
    slope_of: Any,
    position: np.ndarray,
    vertices: np.ndarray,
    alive: np.ndarray,
    particle: np.ndarray,
    corners: np.ndarray,
    real: np.ndarray,
    scale: float,
    half: float,
    reach: float,
    p: tuple,
    on_particles: np.ndarray,
    on_vertices: np.ndarray,
    of_particles: np.ndarray,
    of_vertices: np.ndarray,
) -> None:
    """Add the contact forces, and update the clearances of the nodes.

    Args:
        slope_of: derivative of the energy of a particle: function of its smooth
            distance and of the parameters.
        position: of the particles, in r0.
        vertices: of the membrane.
        alive: mask of the particles with contact forces.
        particle: of each pair, ascending.
        corners: the vertices of its triangle, corner by corner.
        real: mask of the pairs that are not padding.
        scale: contact range, in r0.
        half: half of the sharpness.
        reach: distance beyond which there is no contact, in contact ranges.
        p: parameters of the law.
        on_particles: forces in F(0); added to.
        on_vertices: likewise.
        of_particles: least distances so far, in r0; lowered.
        of_vertices: likewise.
    """
    pairs = _without_padding(real)
    owner, own = particle[:pairs], corners[:, :pairs]
    given = position, owner, vertices, own, real, scale, half, reach
    found, _, u, slope, _ = smooth_distances(*given)
    push = 0.0
    for pair in range(pairs):
        i = particle[pair]
        if real[pair]:
            length = found[LENGTH, pair]
            of_particles[i] = min(of_particles[i], length)
            for corner in range(3):
                node = corners[corner, pair]
                of_vertices[node] = min(of_vertices[node], length)
        if pair == 0 or i != particle[pair - 1]:
            push = -slope_of(u[pair], *p)[0] / scale
        if slope[pair] > 0.0 and alive[i]:
            size = push * slope[pair] / found[LENGTH, pair]
            v, w = found[OF_B, pair], found[OF_C, pair]
            for axis in range(3):
                part = size * found[axis, pair]
                on_particles[i, axis] += part
                on_vertices[corners[0, pair], axis] -= part * (1.0 - v - w)
                on_vertices[corners[1, pair], axis] -= part * v
                on_vertices[corners[2, pair], axis] -= part * w


@regrouped
@no_type_check
def add_products(
    slopes_of: Any,
    position: np.ndarray,
    vertices: np.ndarray,
    alive: np.ndarray,
    particle: np.ndarray,
    corners: np.ndarray,
    real: np.ndarray,
    scale: float,
    half: float,
    reach: float,
    p: tuple,
    of_particles: np.ndarray,
    of_vertices: np.ndarray,
    on_particles: np.ndarray,
    on_vertices: np.ndarray,
) -> None:
    """Add the product of the contact's Hessian with a displacement.

    With the smooth distance u(d) of a particle, and E(u) its energy, the gradient is
    E' ∂u/∂d ∇d, and its change E'' δu ∂u/∂d ∇d + E' δ(∂u/∂d) ∇d + E' ∂u/∂d ∇∇d v.

    Args:
        slopes_of: first and second derivative of the energy of a particle.
        position: as for `add_forces`, like the arguments below.
        vertices: likewise.
        alive: likewise.
        particle: likewise.
        corners: likewise.
        real: likewise.
        scale: likewise.
        half: likewise.
        reach: likewise.
        p: likewise.
        of_particles: displacement of particles.
        of_vertices: displacement of vertices.
        on_particles: product; added to.
        on_vertices: likewise.
    """
    pairs = _without_padding(real)
    owner, own = particle[:pairs], corners[:, :pairs]
    given = position, owner, vertices, own, real, scale, half, reach
    found, value, u, slope, power = smooth_distances(*given)
    moved, turned, along = np.zeros(pairs), np.zeros(pairs), np.zeros(pairs)
    for pair in range(pairs):
        if slope[pair] > 0.0:
            a, b, c = corners[0, pair], corners[1, pair], corners[2, pair]
            i = particle[pair]
            way = approach(found, pair, of_particles, i, of_vertices, a, b, c)
            moved[pair] = way / scale
    smooth_changes(owner, value, moved, half, reach, u, slope, power, along, turned)
    first, second = 0.0, 0.0
    for pair in range(pairs):
        i = particle[pair]
        if pair == 0 or i != particle[pair - 1]:
            first, second = slopes_of(u[pair], *p)
        if slope[pair] > 0.0 and alive[i]:
            change = second * along[pair] * slope[pair] + first * turned[pair]
            add_bent(
                change / scale,
                first * slope[pair] / scale,
                found,
                pair,
                i,
                vertices,
                corners[0, pair],
                corners[1, pair],
                corners[2, pair],
                of_particles,
                of_vertices,
                on_particles,
                on_vertices,
            )


@regrouped
@no_type_check
def add_blocks(
    slopes_of: Any,
    position: np.ndarray,
    vertices: np.ndarray,
    alive: np.ndarray,
    particle: np.ndarray,
    corners: np.ndarray,
    real: np.ndarray,
    scale: float,
    half: float,
    reach: float,
    p: tuple,
    of_particles: np.ndarray,
    of_vertices: np.ndarray,
) -> None:
    """Add approximate diagonal blocks of the contact's Hessian.

    Each pair adds E'' ∂u/∂d n nᵀ. A particle near an almost flat surface is in contact
    with several triangles: the directions n of its pairs are about equal, and the ∂u/∂d
    sum to about 1, so that the sum of the blocks is about E'' ∇u ∇uᵀ. The terms of
    changes of n and of ∂u/∂d are omitted, and so is a negative E''.

    Args:
        slopes_of: first and second derivative of the energy of a particle.
        position: as for `add_forces`, like the arguments below.
        vertices: likewise.
        alive: likewise.
        particle: likewise.
        corners: likewise.
        real: likewise.
        scale: likewise.
        half: likewise.
        reach: likewise.
        p: likewise.
        of_particles: blocks in F(0)/r0, in rows; added to.
        of_vertices: likewise.
    """
    pairs = _without_padding(real)
    owner, own = particle[:pairs], corners[:, :pairs]
    given = position, owner, vertices, own, real, scale, half, reach
    found, _, u, slope, _ = smooth_distances(*given)
    for pair in range(pairs):
        i = particle[pair]
        second = slopes_of(u[pair], *p)[1]
        if slope[pair] > 0.0 and alive[i] and second > 0.0:
            a, b, c = corners[0, pair], corners[1, pair], corners[2, pair]
            stiffness = second * slope[pair] / (scale * scale)
            add_squares(stiffness, found, pair, i, a, b, c, of_particles, of_vertices)
