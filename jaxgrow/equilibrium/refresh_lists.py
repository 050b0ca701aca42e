"""Allocate, refresh and invalidate the lists of a problem."""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import equinox as eqx
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from jaxgrow.energy.collision import Collisions
from jaxgrow.energy.contact import (
    Contacts,
    count_contacts,
    list_contacts,
    narrow_contacts,
    reach,
    SPHERES_PER_CONTACT,
)
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.native_lists import (
    collisions_by_loops,
    fitting,
    is_looped,
    LEAST_CANDIDATES,
    LEAST_COLLISIONS,
    LEAST_CONTACTS,
    listed_by_loops,
)
from jaxgrow.equilibrium.problem import CANDIDATE_SKIN, CONTACT_SKIN, Problem
from jaxgrow.neighbors import verlet_list as nb
from jaxgrow.numerics.capacity import capacity_for
from jaxgrow.state import Membrane, Particles


CollisionLister: TypeAlias = Callable[
    [Float[Array, "m 3"], Collisions | None], Collisions
]
"""Host function that lists collisions, given the vertices and the list before."""

_count_contacts = eqx.filter_jit(count_contacts)


@eqx.filter_jit
def _list_contacts(
    particles: Particles, membrane: Membrane, radius: Array, *, capacity: int
) -> Contacts:
    return list_contacts(particles, membrane, radius, capacity)


@eqx.filter_jit
def _narrow_contacts(
    wide: Contacts,
    particles: Particles,
    membrane: Membrane,
    radius: Array,
    *,
    capacity: int,
) -> Contacts:
    return narrow_contacts(wide, particles, membrane, radius, capacity)


@eqx.filter_jit
def _collisions(problem: Problem, found: Collisions, *, room: int) -> Collisions:
    return problem.collisions(found, room)


@eqx.filter_jit
def _refresh(problem: Problem, lists: Lists) -> Lists:
    return problem.update(problem.nodes(), lists)


def allocate_lists(problem: Problem, before: Lists | None = None) -> Lists:
    """Allocate lists for the current state, not smaller than before."""
    neighbors = None
    if before is None:
        before = Lists(None, None)
    if problem.particles is not None:
        neighbors = nb.allocate(problem.particles.position, before.neighbors)
    return allocate_contacts(problem, neighbors, before)


def allocate_contacts(
    problem: Problem, neighbors: nb.Neighbors | None, before: Lists | None = None
) -> Lists:
    """Allocate contact lists, for neighbours that are listed already."""
    contacts = candidates = None
    if before is None:
        before = Lists(None, None)
    if problem.particles is not None and problem.membrane is not None:
        listed = listed_by_loops if is_looped(problem) else _listed_by_programs
        candidates, contacts = listed(problem, before)
    known = before.collisions, before.encounters
    return Lists(neighbors, contacts, candidates, *known)


def _listed_by_programs(problem: Problem, before: Lists) -> tuple[Contacts, Contacts]:
    """Build the wide and the near contact list by XLA."""
    both = problem.both()
    radius = jnp.asarray(reach(problem.parameters))
    wide = radius + CANDIDATE_SKIN
    spheres = int(_count_contacts(*both, wide))
    candidates = fitting(
        lambda room: _list_contacts(*both, wide, capacity=room),
        spheres // SPHERES_PER_CONTACT,
        before.candidates,
        LEAST_CANDIDATES,
    )
    contacts = fitting(
        lambda room: _narrow_contacts(
            candidates, *both, radius + CONTACT_SKIN, capacity=room
        ),
        0,
        before.contacts,
        LEAST_CONTACTS,
    )
    return candidates, contacts


def fits(problem: Problem, lists: Lists) -> bool:
    """Return whether lists have the shapes of this problem."""
    if lists.neighbors is not None:
        if problem.particles is None:
            return False
        if lists.neighbors.listed.shape[1] != problem.particles.position.shape[0]:
            return False
    if lists.contacts is not None:
        if problem.membrane is None or problem.particles is None:
            return False
        shapes = tuple(a.shape for a in lists.contacts.reference)
        now = (problem.particles.position.shape, problem.membrane.vertices.shape)
        return shapes == now
    return (problem.particles is None) or (problem.membrane is None)


@eqx.filter_jit
def _hold(problem: Problem, lists: Lists) -> Array:
    return ~(problem.outgrown(problem.nodes(), lists).any() | lists.overflow)


def prepared(
    problem: Problem,
    lists: Lists,
    collide: CollisionLister | None,
    *,
    refresh: bool = True,
) -> Lists:
    """Return lists that are valid at the problem's nodes.

    Args:
        problem: at its present nodes.
        lists: of matching shapes.
        collide: lists collisions on the host.
        refresh: whether invalid lists of the device are rebuilt here.
    """
    now = lists if lists.collisions is None else lists.with_collisions(None)
    if refresh:
        if not bool(_hold(problem, now)):
            now = _refresh(problem, now)
        if bool(now.overflow):
            now = allocate_lists(problem, now)
    if collide is None or problem.membrane is None:
        return now
    found = collide(problem.membrane.vertices, lists.of_host)
    near = _near_collisions(problem, found, lists.collisions)
    return now.with_collisions(near, found)


def with_contacts(problem: Problem, lists: Lists) -> Lists:
    """Return lists of which the contacts are valid at the problem's nodes."""
    now = Lists(None, lists.contacts, lists.candidates)
    if now.contacts is not None:
        if not bool(_hold(problem, now)):
            now = _refresh(problem, now)
        if bool(now.overflow):
            now = allocate_contacts(problem, None, now)
    return Lists(lists.neighbors, now.contacts, now.candidates)


def _near_collisions(
    problem: Problem, found: Collisions, before: Collisions | None
) -> Collisions:
    """Filter the near collisions from the host's list, no smaller than before."""
    looped = is_looped(problem)
    room = LEAST_COLLISIONS
    if before is not None:
        room = capacity_for(before.vertex.shape[0] + bool(before.full), room)
    while True:
        if looped:
            made = collisions_by_loops(problem, found, room)
        else:
            made = _collisions(problem, found, room=room)
        if not bool(made.full):
            return made
        room = capacity_for(room + 1, room)


def stale(lists: Lists) -> Lists:
    """Invalidate contact lists, because faces or species changed."""
    if lists.contacts is None or lists.candidates is None:
        return lists

    def never(known: Contacts) -> Contacts:
        particles, vertices = known.reference
        far = _elsewhere(particles.shape, particles.dtype)
        return replace(
            known, reference=(far, _elsewhere(vertices.shape, vertices.dtype))
        )

    both = never(lists.contacts), never(lists.candidates)
    return eqx.tree_at(lambda a: (a.contacts, a.candidates), lists, both)


@functools.lru_cache(maxsize=64)
def _elsewhere(shape: tuple[int, ...], dtype: DTypeLike) -> Array:
    """Return positions farther away than anything moves (cached)."""
    return jnp.full(shape, 1e6, dtype)
