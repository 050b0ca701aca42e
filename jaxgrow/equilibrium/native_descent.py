"""Descent by L-BFGS as one compiled loop (`jaxgrow.kernels.steps`).

On a CPU `jaxgrow.equilibrium.descent` runs some dozens of small programs per step, with
arrays between them, and as many more whenever lists are rebuilt. The loop makes the
same steps of the same forces with lists of the same pairs, in one call.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgrow.energy.a2 import CUTOFF
from jaxgrow.energy.collision import Collisions
from jaxgrow.energy.contact import Contacts, reach
from jaxgrow.equilibrium.descent import Descent
from jaxgrow.equilibrium.lbfgs import LBFGS, LBFGSMemory
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.loops import handler, make_wiring, wired
from jaxgrow.equilibrium.problem import (
    CANDIDATE_SKIN,
    COLLISION_SKIN,
    CONTACT_SKIN,
    LEAST_LISTED,
    Problem,
)
from jaxgrow.kernels import layout
from jaxgrow.neighbors import cell_list as cells, verlet_list as nb
from jaxgrow.runtime.results import Result
from jaxgrow.state import Nodes


class _Changed(NamedTuple):
    """Arrays that the loop changes; see `jaxgrow.kernels.layout`."""

    wide: layout.Lists
    near: layout.Lists
    now: layout.Now
    memory: layout.Memory


def descend_by_loop(
    problem: Problem,
    lists: Lists,
    minimiser: LBFGS,
    tolerance: Float[Array, ""],
    max_steps: Int[Array, ""],
    largest: Float[Array, ""],
    memory: LBFGSMemory | None = None,
) -> Descent:
    """Run `descent.descend` as one loop; lists may be invalid at the start."""
    particles, vertices = _both(problem.nodes())
    blank = jnp.zeros((particles.shape[0] + vertices.shape[0], 3))
    known = minimiser.init(blank) if memory is None else memory
    counts = jnp.zeros(layout.COUNTS, int)
    for place, value in (
        (layout.STEPS, -1),
        (layout.CODE, Result.STEP_LIMIT.code),
        (layout.OVERFLOWN, lists.overflow.astype(int)),
    ):
        counts = counts.at[place].set(value)
    now = layout.Now(
        *(particles, vertices, jnp.zeros_like(particles), jnp.zeros_like(vertices)),
        *(particles, vertices, blank, jnp.full(1, jnp.inf), counts),
    )
    remembered = layout.Memory(
        known.displacement,
        known.change,
        known.inverse,
        known.oldest[None],
        known.scale[None],
    )
    bounds = _bounds(problem, lists, tolerance, max_steps, largest)
    changed = _Changed(_wide(problem, lists), _near(problem, lists), now, remembered)
    end = _call(problem, lists, bounds, changed)
    now, left = end.now, end.memory
    oldest, scale = left.oldest[0], left.scale[0]
    memory = LBFGSMemory(left.displacement, left.change, left.inverse, oldest, scale)
    lists = _lists_after(lists, end)
    return Descent(
        _nodes(problem, now.particles, now.vertices),
        _nodes(problem, now.on_particles, now.on_vertices),
        lists.with_stale(now.counts[layout.OLD_COLLISIONS] > 0),
        memory,
        now.residual[0],
        now.counts[layout.STEPS],
        now.counts[layout.FOUND],
        now.counts[layout.CODE],
    )


def _both(nodes: Nodes) -> tuple[Float[Array, "n 3"], Float[Array, "m 3"]]:
    """Return particles and vertices; an array without rows if there are none."""
    none = jnp.zeros((0, 3))
    particles = none if nodes.particles is None else nodes.particles
    return particles, none if nodes.vertices is None else nodes.vertices


def _nodes(problem: Problem, particles: Array, vertices: Array) -> Nodes:
    """Build nodes of the problem from particles and vertices."""
    return Nodes(
        None if problem.particles is None else particles,
        None if problem.membrane is None else vertices,
    )


def _scene(problem: Problem, lists: Lists) -> layout.Scene:
    flags, none = jnp.zeros(0, bool), jnp.zeros((0, 3))
    alive = free_particles = free_vertices = face_alive = flags
    faces = jnp.zeros((0, 3), int)
    if problem.particles is not None:
        alive, free_particles = problem.particles.alive, problem.particles.free
    membrane = problem.membrane
    if membrane is not None:
        faces, face_alive = membrane.faces.astype(int), membrane.face_alive
        free_vertices = membrane.free
    return layout.Scene(
        alive,
        jnp.concatenate([free_particles, free_vertices]),
        faces,
        face_alive,
        none if problem.load is None else problem.load,
        none if lists.encounters is None else lists.encounters.still,
    )


def _bounds(
    problem: Problem, lists: Lists, tolerance: Array, max_steps: Array, largest: Array
) -> Float[Array, "17"]:
    wide_radius, cell, side, strays, few = 0.0, 0.0, 0, 0, False
    if lists.neighbors is not None:
        count = lists.neighbors.reference.shape[0]
        of = cells.Hash.of(count, CUTOFF + lists.neighbors.wide_skin)
        wide_radius, cell, side = of.radius, of.size, of.cells
        strays, few = nb.most_strays(count), count <= nb.FEW
    whole = reach(problem.parameters)
    bounds = layout.Bounds(
        tolerance=tolerance,
        largest=largest,
        steps=max_steps,
        skin=nb.SKIN,
        radius=CUTOFF + nb.SKIN,
        wide_radius=wide_radius,
        cell=cell,
        cells=side,
        strays=strays,
        few=few,
        contact_skin=CONTACT_SKIN,
        contact_radius=whole + CONTACT_SKIN,
        candidate_radius=whole + CANDIDATE_SKIN,
        collision_skin=COLLISION_SKIN,
        encounter_skin=0.0 if lists.encounters is None else lists.encounters.skin,
        least=LEAST_LISTED,
        collision_range=problem.parameters.collision_range,
    )
    return jnp.stack([jnp.asarray(bound, problem.dtype) for bound in bounds])


def _wide(problem: Problem, lists: Lists) -> layout.Lists:
    """Return the wide lists; empty for terms that the problem does not have."""
    particles, _ = _both(problem.nodes())
    entries, at = jnp.zeros((particles.shape[0], 0), jnp.int32), particles
    if lists.neighbors is not None:
        entries, at = lists.neighbors.wide.idx, cells.listed_at(lists.neighbors.wide)
    return _lists(problem, entries, at, lists.candidates, lists.encounters)


def _near(problem: Problem, lists: Lists) -> layout.Lists:
    """Return the near lists; empty for terms that the problem does not have."""
    particles, _ = _both(problem.nodes())
    entries, at = jnp.zeros((0, particles.shape[0]), jnp.int32), particles
    if lists.neighbors is not None:
        entries, at = lists.neighbors.listed, lists.neighbors.reference
    return _lists(problem, entries, at, lists.contacts, lists.collisions)


def _lists(
    problem: Problem,
    entries: Array,
    listed_at: Array,
    contacts: Contacts | None,
    collisions: Collisions | None,
) -> layout.Lists:
    particles, vertices = _both(problem.nodes())
    short, flags, whole = jnp.zeros(0, jnp.int32), jnp.zeros(0, bool), jnp.zeros(0, int)
    touching = layout.Touching(short, short, jnp.zeros((3, 0), int), flags)
    touched = particles, vertices
    if contacts is not None:
        touching = layout.Touching(
            contacts.particle, contacts.face, contacts.corners, contacts.real
        )
        touched = contacts.reference
    pairs = layout.Pairs(
        whole,
        jnp.zeros((0, 3), int),
        flags,
        jnp.zeros(0),
        jnp.zeros((0, 4), int),
        jnp.zeros(0),
    )
    collided = vertices
    if collisions is not None:
        pairs = layout.Pairs(
            collisions.vertex,
            collisions.corners,
            collisions.apart,
            collisions.vertex_margin,
            collisions.edges,
            collisions.edge_margin,
        )
        collided = collisions.reference
    return layout.Lists(entries, listed_at, touching, *touched, pairs, collided)


def _call(
    problem: Problem, lists: Lists, bounds: Float[Array, "17"], changed: _Changed
) -> _Changed:
    assert problem.loops is not None
    scene, terms = _scene(problem, lists), wired(problem, lists)
    rows, structure = jax.tree.flatten(changed)
    # near lists are changed in place, so terms read them there
    first, buffers = len(scene) + 3, [b for term in terms for b in term.buffers]
    own = [b for b in buffers if not any(b is row for row in rows)]
    number = {id(b): first + k for k, b in enumerate(own)}
    number |= {id(row): first + len(own) + k for k, row in enumerate(rows)}
    wiring = make_wiring([[number[id(b)] for b in term.buffers] for term in terms])
    fixed = [*scene, bounds, problem.loops.force, jnp.asarray(wiring), *own]
    call = jax.ffi.ffi_call(
        handler("descent"),
        [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in rows],
        input_output_aliases={len(fixed) + k: k for k in range(len(rows))},
    )
    return jax.tree.unflatten(structure, call(*fixed, *rows))


def _lists_after(lists: Lists, end: _Changed) -> Lists:
    """Return the lists as the loop left them."""
    near, wide, full = end.near, end.wide, end.now.counts > 0
    neighbors, collisions = lists.neighbors, lists.collisions
    contacts, candidates = lists.contacts, lists.candidates
    if neighbors is not None:
        neighbors = nb.Neighbors(
            near.listed,
            near.listed_at,
            neighbors.full | full[layout.FULL_NEIGHBOURS],
            cells.listed_by_loop(
                neighbors.wide, wide.listed, wide.listed_at, full[layout.FULL_WIDE]
            ),
        )
    if contacts is not None and candidates is not None:
        contacts, candidates = (
            Contacts(
                *listed.contacts,
                reference=(listed.touching, listed.touched),
                overflow=before.overflow | too_many,
            )
            for listed, before, too_many in (
                (near, contacts, full[layout.FULL_CONTACTS]),
                (wide, candidates, full[layout.FULL_CANDIDATES]),
            )
        )
    if collisions is not None:
        collisions = eqx.tree_at(
            lambda c: (
                *(c.vertex, c.corners, c.apart, c.vertex_margin),
                *(c.edges, c.edge_margin, c.reference, c.full),
            ),
            collisions,
            (
                *near.collisions,
                near.collided,
                collisions.full | full[layout.FULL_COLLISIONS],
            ),
        )
    return Lists(neighbors, contacts, candidates, collisions, lists.encounters)
