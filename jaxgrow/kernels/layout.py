"""Argument layout of a descent's loop: arrays of XLA or of NumPy.

They are XLA's outside of the loop, and NumPy's within. In this order, field by field,
they are the arguments of `jaxgrow.kernels.descent`.
"""

from typing import Any, NamedTuple, TypeAlias

import numpy as np

from jaxgrow.kernels.arguments import Argument


Array: TypeAlias = Any
"""An array on either side."""

Number: TypeAlias = Any
"""A number within the loop, or a traced one outside."""


AWAY = 1e9
"""Coordinate, in r0, from which on all particles are dead."""

NEAR_ARGUMENTS = (
    Argument("position", np.float64, 2),
    Argument("wide", np.int32, 2),
    Argument("square", np.float64, 1),
)
NEAR_RESULTS = (Argument("listed", np.int32, 2), Argument("most", np.int32, 1))
"""Arguments and results of `jaxgrow.kernels.near`."""


class Touching(NamedTuple):
    """Contact pairs of a particle and a triangle.

    As `jaxgrow.energy.contact.Contacts`.
    """

    particle: Array
    face: Array
    corners: Array
    real: Array


class Pairs(NamedTuple):
    """Collision pairs, as in `jaxgrow.energy.collision.Collisions`.

    Attributes:
        vertex, corners, apart, vertex_margin: of a vertex and a triangle.
        edges, edge_margin: of two edges.
    """

    vertex: Array
    corners: Array
    apart: Array
    vertex_margin: Array
    edges: Array
    edge_margin: Array


class Scene(NamedTuple):
    """Arrays that are constant during a descent.

    Attributes:
        alive: mask of the particles that are not padding.
        free: mask of the nodes that may move: particles, then vertices.
        faces, face_alive: of the membrane.
        load: on its vertices; without rows if there is none.
        still: static vertices that it may collide with.
    """

    alive: Array
    free: Array
    faces: Array
    face_alive: Array
    load: Array
    still: Array


class Lists(NamedTuple):
    """Verlet lists: wide ones, or the near ones that are filtered from them.

    Attributes:
        listed: neighbours, particle by particle in a wide list, and neighbour-major in
            a near one; without entries if there is no such term.
        listed_at: positions of the particles when it was built.
        contacts: of particles and triangles.
        touching: positions of the particles when they were listed.
        touched: positions of the vertices when they were listed.
        collisions: of the membrane.
        collided: positions of the vertices when they were listed.
    """

    listed: Array
    listed_at: Array
    contacts: Touching
    touching: Array
    touched: Array
    collisions: Pairs
    collided: Array


class Bounds(NamedTuple):
    """Bounds of a descent, and of the validity of its lists; lengths in r0.

    Attributes:
        tolerance: largest force allowed at the end, in F(0).
        largest: longest displacement in a step.
        steps: largest number.
        skin: moves for which the near neighbours are valid.
        radius, wide_radius: of the near neighbours, and of the wide list of them.
        cell, cells: size of a cell of the cell list, and number of cells along an axis.
        strays: largest number of particles with long moves that are relisted one by
            one.
        few: whether this is done only if the wide list is not valid.
        contact_skin: moves for which the near contacts are valid.
        contact_radius, candidate_radius: of the near contacts, and of the wide list.
        collision_skin, encounter_skin: moves for which the near collisions, and the
            host's list of them, are valid.
        least: distance up to which collisions are listed in any case.
        collision_range: unit of the collisions' margins.
    """

    tolerance: Number
    largest: Number
    steps: Number
    skin: Number
    radius: Number
    wide_radius: Number
    cell: Number
    cells: Number
    strays: Number
    few: Number
    contact_skin: Number
    contact_radius: Number
    candidate_radius: Number
    collision_skin: Number
    encounter_skin: Number
    least: Number
    collision_range: Number


class Now(NamedTuple):
    """State of a descent; all of it is written.

    Attributes:
        particles, vertices: positions accepted last.
        on_particles, on_vertices: forces there.
        trial_particles, trial_vertices: positions to be evaluated next.
        step: the displacement to them.
        residual: one entry.
        counts: steps (-1 before the first evaluation), code, number of list rebuilds,
            whether the host must rebuild the list of collisions, whether any list
            overflowed at the start, and which do now.
    """

    particles: Array
    vertices: Array
    on_particles: Array
    on_vertices: Array
    trial_particles: Array
    trial_vertices: Array
    step: Array
    residual: Array
    counts: Array


class Memory(NamedTuple):
    """Memory of L-BFGS, with all coordinates in a row.

    As `jaxgrow.equilibrium.lbfgs.LBFGSMemory`.

    Attributes:
        displacement, change: of each pair.
        inverse: 1 / (s · y), 0 for an empty slot.
        oldest: index of the oldest pair; one entry.
        scale: initial inverse Hessian: displacement per force along directions outside
            of the pairs; one entry.
    """

    displacement: Array
    change: Array
    inverse: Array
    oldest: Array
    scale: Array


STEPS, CODE, FOUND, OLD_COLLISIONS, OVERFLOWN = 0, 1, 2, 3, 4
FULL_NEIGHBOURS, FULL_WIDE, FULL_CONTACTS, FULL_CANDIDATES, FULL_COLLISIONS = FULL = (
    *(5, 6, 7, 8, 9),
)
COUNTS = 10
"""Indices of `Now.counts`, and its length."""
