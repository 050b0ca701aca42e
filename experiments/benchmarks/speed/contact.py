r"""Yardstick: contact with a membrane by exact point-triangle distances, in numba.

Of the listed triangles of a particle the nearest one acts, by the profile of
`jaxgrow.energy.contact` at :math:`u = d / r_s`,

.. math::
    f = \left( c F(u) - \kappa b'(u) \right) n, \qquad
    b'(u) = -2 (u - \hat u) \ln(u / \hat u) - (u - \hat u)^2 / u \;\; (u < \hat u)

along the unit vector n from the closest point to the particle; the reaction goes to
the corners by the barycentric weights of that point. With ``sharpness`` all listed
triangles act, by the smooth minimum that jaxgrow uses instead of the nearest
(`jaxgrow.energy.smooth_minimum`): the same law, at a higher price.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from .pairs import a2_force, CUTOFF, REASSOCIATED, Shape, shape_of


class ContactLaw(NamedTuple):
    """Parameters of contact; names and units as in `jaxgrow.Parameters`.

    Attributes:
        sharpness: of the smooth minimum; 0 for the nearest triangle alone.
    """

    contact_range: float
    contact_stiffness: float
    contact_adhesion: float
    barrier_stiffness: float
    barrier_range: float
    smoothing: float
    sharpness: float = 0.0


@njit(cache=True, fastmath=REASSOCIATED, error_model="numpy")
def closest_point(
    px: float, py: float, pz: float, triangle: np.ndarray, closest: np.ndarray
) -> None:
    """Closest point of a triangle (Ericson 2005, §5.1.5), by Voronoi regions.

    Args:
        px: the point; likewise `py`, `pz`.
        triangle: its three corners.
        closest: receives the vector from the closest point to the point, and the
            barycentric weights of the closest point.
    """
    ax, ay, az = triangle[0, 0], triangle[0, 1], triangle[0, 2]
    abx, aby, abz = triangle[1, 0] - ax, triangle[1, 1] - ay, triangle[1, 2] - az
    acx, acy, acz = triangle[2, 0] - ax, triangle[2, 1] - ay, triangle[2, 2] - az
    apx, apy, apz = px - ax, py - ay, pz - az
    d1 = abx * apx + aby * apy + abz * apz
    d2 = acx * apx + acy * apy + acz * apz
    bpx, bpy, bpz = apx - abx, apy - aby, apz - abz
    d3 = abx * bpx + aby * bpy + abz * bpz
    d4 = acx * bpx + acy * bpy + acz * bpz
    cpx, cpy, cpz = apx - acx, apy - acy, apz - acz
    d5 = abx * cpx + aby * cpy + abz * cpz
    d6 = acx * cpx + acy * cpy + acz * cpz
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0 and d2 <= 0:
        v, w = 0.0, 0.0
    elif d3 >= 0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        v, w = d1 / (d1 - d3), 0.0
    elif d6 >= 0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        scale = 1.0 / (va + vb + vc)
        v, w = vb * scale, vc * scale
    closest[0] = apx - v * abx - w * acx
    closest[1] = apy - v * aby - w * acy
    closest[2] = apz - v * abz - w * acz
    closest[3], closest[4], closest[5] = 1.0 - v - w, v, w


# Not cached: numba would not notice a change of what it calls in another file.
@njit(fastmath=REASSOCIATED, error_model="numpy")
def _push(u: float, law: ContactLaw, shape: Shape) -> float:
    """Force of contact in F(0) at u contact ranges; positive repels."""
    push = law.contact_stiffness * a2_force(u, shape)
    margin = law.barrier_range
    if u < margin:
        u = max(u, 1e-30)
        inside = u - margin
        steep = -2.0 * inside * math.log(u / margin) - inside * inside / u
        push -= law.barrier_stiffness * steep
    return push


@njit(cache=True, fastmath=REASSOCIATED, error_model="numpy")
def _act(
    i: int,
    corners: np.ndarray,
    closest: np.ndarray,
    size: float,
    on_particles: np.ndarray,
    on_vertices: np.ndarray,
) -> None:
    """Add a force of this size along the closest vector, and its reaction."""
    length = math.sqrt(closest[0] ** 2 + closest[1] ** 2 + closest[2] ** 2)
    scale = size / length if length > 0.0 else 0.0
    for axis in range(3):
        part = scale * closest[axis]
        on_particles[i, axis] += part
        for corner in range(3):
            on_vertices[corners[corner], axis] -= part * closest[3 + corner]


@njit(fastmath=REASSOCIATED, error_model="numpy")
def _contact_forces(
    position: np.ndarray,
    vertices: np.ndarray,
    faces: np.ndarray,
    start: np.ndarray,
    face: np.ndarray,
    law: ContactLaw,
    on_particles: np.ndarray,
    on_vertices: np.ndarray,
) -> None:
    triangle = np.zeros((3, 3))
    most = 0
    for i in range(len(position)):
        most = max(most, start[i + 1] - start[i])
    found = np.zeros((most, 6))
    distance = np.zeros(most)
    half = 0.5 * law.sharpness
    shape = shape_of(law.contact_adhesion, law.smoothing)
    for i in range(len(position)):
        begin, listed = start[i], start[i + 1] - start[i]
        nearest, best = CUTOFF, -1
        for k in range(listed):
            corners = faces[face[begin + k]]
            for corner in range(3):
                for axis in range(3):
                    triangle[corner, axis] = vertices[corners[corner], axis]
            gap = found[k]
            closest_point(position[i, 0], position[i, 1], position[i, 2], triangle, gap)
            u = math.sqrt(gap[0] ** 2 + gap[1] ** 2 + gap[2] ** 2) / law.contact_range
            distance[k] = u
            if u < nearest:
                nearest, best = u, k
        if best < 0:
            continue
        if law.sharpness == 0.0:
            size = _push(nearest, law, shape)
            corners = faces[face[begin + best]]
            _act(i, corners, found[best], size, on_particles, on_vertices)
            continue
        # a_t = (unit / u_t)^q - (unit / R)^q, as jaxgrow, in units of the nearest
        unit = min(max(nearest, 1e-30), CUTOFF)
        far = (unit / CUTOFF) ** half
        total = 0.0
        for k in range(listed):
            if distance[k] < CUTOFF:
                total += ((unit / max(distance[k], 1e-30)) ** half - far) ** 2
        norm = math.sqrt(total)
        if norm == 0.0:
            continue
        smooth = unit * (norm + far) ** (-1.0 / half)
        size = _push(smooth, law, shape) * smooth / (norm + far) / norm
        for k in range(listed):
            if distance[k] < CUTOFF:
                u = max(distance[k], 1e-30)
                power = (unit / u) ** half
                share = (power - far) * power / u
                corners = faces[face[begin + k]]
                _act(i, corners, found[k], size * share, on_particles, on_vertices)


def contact_forces(
    position: Float[np.ndarray, "n 3"],
    vertices: Float[np.ndarray, "m 3"],
    faces: Int[np.ndarray, "f 3"],
    start: Int[np.ndarray, " n+1"],
    face: Int[np.ndarray, " p"],
    law: ContactLaw,
    out: tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "m 3"]] | None = None,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "m 3"]]:
    """Forces of contact on particles and vertices, in F(0).

    Args:
        position: of the particles, in r0.
        vertices: of the membrane.
        faces: their triangles.
        start: where the triangles of each particle start in `face`, and the end.
        face: triangles near each particle, one particle after the other.
        law: the parameters.
        out: forces to add these to; None for new ones.
    """
    if out is None:
        out = np.zeros_like(position), np.zeros_like(vertices)
    _contact_forces(position, vertices, faces, start, face, law, *out)
    return out


@njit(cache=True, fastmath=REASSOCIATED, error_model="numpy")
def add_spring_forces(
    vertices: np.ndarray,
    edges: np.ndarray,
    rest_length: np.ndarray,
    stiffness: float,
    pretension: float,
    force: np.ndarray,
) -> None:
    """Add the forces of the springs on the membrane's edges, in F(0).

    Args:
        vertices: in r0.
        edges: vertices of each.
        rest_length: of each, in r0.
        stiffness: k, in F(0)/r0.
        pretension: share by which a rest length falls short.
        force: on the vertices; changed.
    """
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        dx = vertices[b, 0] - vertices[a, 0]
        dy = vertices[b, 1] - vertices[a, 1]
        dz = vertices[b, 2] - vertices[a, 2]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        stretch = length - (1.0 - pretension) * rest_length[e]
        pull = stiffness * stretch / length if length > 0.0 else 0.0
        force[a, 0] += pull * dx
        force[a, 1] += pull * dy
        force[a, 2] += pull * dz
        force[b, 0] -= pull * dx
        force[b, 1] -= pull * dy
        force[b, 2] -= pull * dz
