"""The lists of a problem: allocated, kept valid, and told to be out of date."""

from collections.abc import Callable
from typing import TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgrow import neighbors as nb
from jaxgrow.capacity import capacity_for
from jaxgrow.energy.collision import Collisions
from jaxgrow.energy.contact import Contacts, count_contacts, list_contacts, reach
from jaxgrow.equilibrium.problem import CONTACT_SKIN, Lists, Problem
from jaxgrow.state import Membrane, Particles


CollisionLister: TypeAlias = Callable[
    [Float[Array, "m 3"], Collisions | None], Collisions
]
"""Lists on the host what may collide, given the vertices and the list before."""

_count_contacts = eqx.filter_jit(count_contacts)


@eqx.filter_jit
def _list_contacts(
    particles: Particles, membrane: Membrane, radius: Array, *, capacity: int
) -> Contacts:
    return list_contacts(particles, membrane, radius, capacity)


@eqx.filter_jit
def _refresh(problem: Problem, lists: Lists) -> Lists:
    return problem.update(problem.nodes(), lists)


def allocate_lists(problem: Problem, before: Lists | None = None) -> Lists:
    """Lists with room for the current state, and not smaller than before."""
    neighbors = contacts = None
    if problem.particles is not None:
        known = None if before is None else before.neighbors
        occupancy = 0 if known is None else known.max_occupancy
        neighbors = nb.allocate(problem.particles.position, occupancy)
    if problem.particles is not None and problem.membrane is not None:
        known = None if before is None else before.contacts
        radius = jnp.asarray(reach(problem.parameters) + CONTACT_SKIN)
        candidates = _count_contacts(problem.particles, problem.membrane, radius)
        least = 2048 if known is None else known.particle.shape[0]
        capacity = capacity_for(int(candidates) // 2, least)
        while contacts is None or bool(contacts.overflow):
            contacts = _list_contacts(
                problem.particles, problem.membrane, radius, capacity=capacity
            )
            capacity = capacity_for(capacity + 1, least)
    return Lists(neighbors, contacts, None if before is None else before.collisions)


def fits(problem: Problem, lists: Lists) -> bool:
    """Whether lists of an earlier problem have the shapes of this one."""
    if lists.neighbors is not None:
        if problem.particles is None:
            return False
        if lists.neighbors.idx.shape[0] != problem.particles.position.shape[0]:
            return False
    if lists.contacts is not None:
        if problem.membrane is None or problem.particles is None:
            return False
        shapes = tuple(a.shape for a in lists.contacts.reference)
        now = (problem.particles.position.shape, problem.membrane.vertices.shape)
        return shapes == now
    return (problem.particles is None) or (problem.membrane is None)


def prepared(problem: Problem, lists: Lists, collide: CollisionLister | None) -> Lists:
    """Lists that are valid for where the problem is now."""
    now = _refresh(problem, Lists(lists.neighbors, lists.contacts))
    if bool(now.overflow):
        now = allocate_lists(problem, now)
    if collide is None or problem.membrane is None:
        return now
    found = collide(problem.membrane.vertices, lists.collisions)
    return Lists(now.neighbors, now.contacts, found)


def stale(lists: Lists) -> Lists:
    """Lists that the next update rebuilds, because faces or species changed."""
    if lists.contacts is None:
        return lists
    moved = jax.tree.map(lambda x: x + 1e6, lists.contacts.reference)
    return eqx.tree_at(lambda a: a.contacts.reference, lists, moved)
