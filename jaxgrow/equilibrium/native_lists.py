"""Contact and collision lists, built by loops that the host calls.

With XLA every size of a list is another program, and loading these is expensive.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxgrow.energy.collision import Collisions
from jaxgrow.energy.contact import Contacts, reach
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.problem import (
    CANDIDATE_SKIN,
    COLLISION_SKIN,
    CONTACT_SKIN,
    LEAST_LISTED,
    Problem,
)
from jaxgrow.kernels import layout, loops
from jaxgrow.kernels.ffi import refused, registered
from jaxgrow.numerics.capacity import capacity_for
from jaxgrow.transfer.device import get, get_number, put


LEAST_CONTACTS, LEAST_CANDIDATES, LEAST_COLLISIONS = 1024, 4096, 256
"""Initial capacities of lists."""


def is_looped(problem: Problem) -> bool:
    """Return whether there is a loop for this problem: on a CPU, in 64 bits."""
    return why_not_looped(problem) is None


def why_not_looped(problem: Problem) -> str | None:
    """Return why there is no loop for this problem; None if there is one."""
    if problem.dtype != jnp.float64:
        return f"numbers are {problem.dtype}, and loops know 64 bits only"
    if not registered("descent"):
        found = refused("descent")
        assert found is not None
        return found.reason
    nodes = problem.particles or problem.membrane
    where = jax.tree.leaves(nodes)[0].devices()
    elsewhere = {device.platform for device in where} - {"cpu"}
    if elsewhere:
        return f"it was computed on {elsewhere.pop()}, and loops are for processors"
    return None


def fitting(
    make: Callable[[int], Contacts], size: int, before: Contacts | None, least: int
) -> Contacts:
    """Build a list with capacity for `size`, enlarged until it fits.

    If the list before overflowed, at positions that were discarded since, the capacity
    is larger than its.
    """
    if before is not None:
        least = before.particle.shape[0]
        size = max(size, least + int(before.overflow))
    capacity = capacity_for(size, least)
    while bool((made := make(capacity)).overflow):
        capacity = capacity_for(capacity + 1, least)
    return made


def listed_by_loops(problem: Problem, before: Lists) -> tuple[Contacts, Contacts]:
    """Build the wide and the near contact list, no smaller than before."""
    particles, membrane = problem.both()
    kernel, radius = loops("anew"), get_number(reach(problem.parameters))
    position, vertices = _own(particles.position), _own(membrane.vertices)
    surface = vertices, _own(membrane.faces), _own(membrane.face_alive)
    given = position, _own(particles.alive), *surface, radius + CANDIDATE_SKIN

    def listed(room: int) -> Contacts:
        return _contacts(problem, *kernel.contacts(*given, room))

    # no counting if the capacity before is probably sufficient
    count = 0 if before.candidates is not None else kernel.contacts(*given, 0)[1]
    candidates = fitting(listed, count, before.candidates, LEAST_CANDIDATES)
    wide = layout.Touching(
        *(_own(candidates.particle), _own(candidates.face)),
        *(_own(candidates.corners), _own(candidates.real)),
    )
    within = wide, position, vertices, radius + CONTACT_SKIN

    def narrowed(room: int) -> Contacts:
        return _contacts(problem, *kernel.near_contacts(*within, room))

    count = 0 if before.contacts is not None else kernel.near_contacts(*within, 0)[1]
    return candidates, fitting(narrowed, count, before.contacts, LEAST_CONTACTS)


def collisions_by_loops(problem: Problem, wide: Collisions, room: int) -> Collisions:
    """Build the near collision list, as `Problem.collisions` does."""
    membrane = problem.membrane
    assert membrane is not None
    points = _own(jnp.concatenate([membrane.vertices, wide.still]))
    pairs = layout.Pairs(
        *(_own(wide.vertex), _own(wide.corners), _own(wide.apart)),
        *(_own(wide.vertex_margin), _own(wide.edges), _own(wide.edge_margin)),
    )
    scale = get_number(problem.parameters.collision_range)
    found, count = loops("anew").near_collisions(
        pairs, points, scale, LEAST_LISTED, COLLISION_SKIN, room
    )
    vertex, corners, apart, vertex_margin, edges, edge_margin = found
    return Collisions(
        *(wide.still, put(vertex), put(corners)),
        put(apart.view(bool)),
        *map(put, (vertex_margin, edges, edge_margin)),
        reference=membrane.vertices,
        skin=jnp.asarray(COLLISION_SKIN, wide.skin.dtype),
        stale=jnp.zeros((), bool),
        full=wide.full | (count > room),
    )


def _contacts(problem: Problem, found: layout.Touching, count: int) -> Contacts:
    """Put a contact list for the problem's nodes on the device."""
    particles, membrane = problem.both()
    return Contacts(
        *(put(found.particle), put(found.face)),
        *(put(found.corners), put(found.real.view(bool))),
        reference=(particles.position, membrane.vertices),
        overflow=jax.device_put(count > len(found.real)),
    )


def _own(array: Array) -> layout.Array:
    """Copy an array for a loop, flags as bytes."""
    rows = get(array).copy()
    return rows.view("uint8") if rows.dtype == bool else rows
