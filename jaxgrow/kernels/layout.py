"""What the loop of a descent is given: arrays of XLA outside, of NumPy within.

In this order, field by field, they are the arguments of `jaxgrow.kernels.descent`.
"""

from typing import Any, NamedTuple, TypeAlias

import numpy as np

from jaxgrow.kernels.arguments import Argument


Array: TypeAlias = Any
"""An array on either side."""

Number: TypeAlias = Any
"""A number within, or one that is not known yet outside."""


AWAY = 1e9
"""Coordinate, in r0, from which on there is nothing but dead particles."""

NEAR_ARGUMENTS = (
    Argument("position", np.float64, 2),
    Argument("wide", np.int32, 2),
    Argument("square", np.float64, 1),
)
NEAR_RESULTS = (Argument("listed", np.int32, 2), Argument("most", np.int32, 1))
"""What `jaxgrow.kernels.near` is given and gives."""


class Touching(NamedTuple):
    """Pairs of a particle and a triangle, as `jaxgrow.energy.contact.Contacts`."""

    particle: Array
    face: Array
    corners: Array
    real: Array


class Pairs(NamedTuple):
    """What may collide, as in `jaxgrow.energy.collision.Collisions`.

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
    """What does not change.

    Attributes:
        alive: which particles are none of the padding.
        free: which nodes may move: particles, then vertices.
        faces, face_alive: of the membrane.
        load: on its vertices, or on none.
        still: static vertices that it may collide with.
    """

    alive: Array
    free: Array
    faces: Array
    face_alive: Array
    load: Array
    still: Array


class Lists(NamedTuple):
    """Wide lists, or the near ones that are found in them.

    Attributes:
        listed: neighbours, particle by particle in a wide list, and neighbour-major in
            a near one; without entries if there is no such term.
        listed_at: positions of the particles then.
        contacts: of particles and triangles.
        touching: positions of the particles then.
        touched: vertices then.
        collisions: of the membrane.
        collided: vertices then.
    """

    listed: Array
    listed_at: Array
    contacts: Touching
    touching: Array
    touched: Array
    collisions: Pairs
    collided: Array


class Bounds(NamedTuple):
    """Numbers that end the loop, or a list; lengths in r0.

    Attributes:
        tolerance: largest force allowed at the end, in F(0).
        largest: longest displacement in a step.
        steps: at most.
        skin: moves that the near neighbours hold for.
        radius, wide_radius: of the near neighbours, and of the wide list of them.
        cell, cells: size of a cell of space, and how many there are along an axis.
        strays: how many that went far are listed by themselves.
        few: whether that is so only where the wide list does not hold.
        contact_skin: moves that the near contacts hold for.
        contact_radius, candidate_radius: of the near contacts, and of the wide list.
        collision_skin, encounter_skin: moves that collisions, and the host's list of
            them, hold for.
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
    """Where the descent stands; all of it is written.

    Attributes:
        particles, vertices: accepted last.
        on_particles, on_vertices: forces there.
        trial_particles, trial_vertices: to be evaluated next.
        step: the displacement to them.
        residual: one entry.
        counts: steps (-1 before the first evaluation), code, how often a list was made
            anew, whether the host has to list the collisions anew, whether any list
            was too small at first, and which are now.
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
    """As `jaxgrow.equilibrium.lbfgs.LBFGSMemory`, with all coordinates in a row.

    Attributes:
        displacement, change: of each pair.
        inverse: 1 / (s · y), 0 for an empty slot.
        oldest: index of the oldest pair; one entry.
        scale: displacement per force along new directions; one entry.
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
"""Places of `Now.counts`, and how many there are."""
