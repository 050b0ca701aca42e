"""Transfer between host and device: `put_*` to the device, `get_*` back.

Arrays on the device have a capacity that grows by factors of 3/2, so that a growth
needs few compiled programs; the live rows are always the first ones. Operations on
positions stay on the device, so that they can be differentiated; only discrete choices
(which particle divides, which edge is split) are made on the host.
"""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.energy.terms import MEMBRANE_TERMS
from jaxgrow.mesh.surface import average_parents, Remeshing, Surface
from jaxgrow.mesh.topology import build_topology
from jaxgrow.numerics.capacity import capacity_for
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Membrane, Particles, replaced


MembraneOrNone = TypeVar("MembraneOrNone", bound=Membrane | None)


def get(array: Array) -> np.ndarray:
    """Copy values to the host, cut off from any derivative.

    Only a traced array needs the cut.
    """
    if isinstance(array, Tracer):
        array = jax.lax.stop_gradient(array)
    return np.asarray(array)


def get_number(value: Scalar) -> float:
    """Return a scalar parameter as a float: number, array or traced."""
    return float(get(jnp.asarray(value)))


def put(array: np.ndarray) -> Array:
    """Copy an array to the device.

    `jnp.asarray` is avoided, as it compiles a program for every shape (JAX 0.10).
    `jax.device_put` may alias the memory that it is given, so it is given a copy.
    """
    return jax.device_put(np.array(array))


def padded(array: np.ndarray, capacity: int, value: float = 0) -> np.ndarray:
    """Pad an array with rows of a value (zeros, False) to a capacity."""
    filled = np.full((capacity, *array.shape[1:]), value, array.dtype)
    filled[: len(array)] = array
    return filled


def parked(count: int, start: int = 0) -> Float[np.ndarray, "n 3"]:
    """Return positions for padding slots, on a lattice far from everything.

    They are distinct because particles parked at one point would fill one cell of a
    neighbour list.
    """
    index = np.arange(start, start + count)
    lattice = np.stack([index % 16, index // 16 % 16, index // 256], axis=1)
    return 1e4 + 4.0 * lattice.astype(float)


def put_particles(
    position: Float[np.ndarray, "n 3"],
    species: Int[np.ndarray, " n"],
    held: Bool[np.ndarray, " n"],
    capacity: int,
) -> Particles:
    """Put particles on the device, padded to a capacity."""
    count = len(position)
    padding = put(parked(capacity - count))
    return Particles(
        position=jnp.concatenate([put(position), padding]),
        species=put(padded(species, capacity)),
        alive=put(np.arange(capacity) < count),
        held=put(padded(held, capacity)),
    )


def with_capacity(particles: Particles, capacity: int) -> Particles:
    """Return the same particles, padded to a larger capacity."""
    old = particles.position.shape[0]
    more = capacity - old

    def extend(array: Array) -> Array:
        return jnp.concatenate([array, jnp.zeros(more, array.dtype)])

    return Particles(
        position=jnp.concatenate([particles.position, put(parked(more, old))]),
        species=extend(particles.species),
        alive=extend(particles.alive),
        held=extend(particles.held),
    )


def get_particles(
    particles: Particles,
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Copy position (in r0) and species of live particles to the host."""
    alive = get(particles.alive)
    return get(particles.position)[alive], get(particles.species)[alive]


class Positions(NamedTuple):
    """Positions of live particles and vertices, on the host.

    Attributes:
        particles: in r0.
        vertices: in r0; None without a membrane.
    """

    particles: Float[np.ndarray, "n 3"]
    vertices: Float[np.ndarray, "m 3"] | None


def get_positions(particles: Particles, membrane: Membrane | None) -> Positions:
    """Copy the positions of live particles and vertices to the host."""
    vertices = None
    if membrane is not None:
        vertices = get(membrane.vertices)[get(membrane.vertex_alive)]
    return Positions(get(particles.position)[get(particles.alive)], vertices)


def put_positions(
    particles: Particles, membrane: MembraneOrNone, positions: Positions
) -> tuple[Particles, MembraneOrNone]:
    """Move the free particles and vertices to other positions."""

    def placed(own: Array, new: np.ndarray, free: Array) -> Array:
        there = put(padded(new, own.shape[0]))
        return jnp.where(free[:, None], there, own)

    moved = placed(particles.position, positions.particles, particles.free)
    particles = particles.at(moved)
    if membrane is not None:
        assert positions.vertices is not None
        moved = placed(membrane.vertices, positions.vertices, membrane.free)
        membrane = membrane.at(moved)
    return particles, membrane


def put_membrane(surface: Surface) -> Membrane:
    """Put a surface on the device as a membrane at rest."""
    capacity = _vertex_capacity(surface)
    vertices = put(padded(surface.vertices, capacity))
    return put_at_rest(vertices, surface)


def get_surface(membrane: Membrane) -> Surface:
    """Copy the live part of a membrane to the host."""
    alive = get(membrane.vertex_alive)
    return Surface(
        vertices=get(membrane.vertices)[alive],
        faces=get(membrane.faces)[get(membrane.face_alive)].astype(np.int64),
        fixed=get(membrane.pinned)[alive],
        source=int(membrane.source),
    )


def put_remeshed(membrane: Membrane, remeshing: Remeshing) -> Membrane:
    """Return a membrane after remeshing, with springs at current length.

    Args:
        membrane: as it was before.
        remeshing: connectivity afterwards, and the linear maps from the old vertices.
    """
    most = max([len(p) for p in remeshing.parents], default=0)
    old = membrane.vertices.shape[0]
    capacity = max(_vertex_capacity(remeshing, most), old)
    carried = _carried(membrane)
    if capacity > old:
        more = jnp.zeros((capacity - old, 7), carried.dtype)
        carried = jnp.concatenate([carried, more])
    for parents in remeshing.parents:
        carried = _average(carried, put(padded(parents, capacity)))
    vertices, reference, hyperplasia = _split(carried)
    return put_at_rest(vertices, remeshing, reference, hyperplasia)


@jax.jit
def _carried(membrane: Membrane) -> Float[Array, "m 7"]:
    """Join the fields that remeshing carries linearly: a row a vertex."""
    marks = membrane.hyperplasia[:, None]
    return jnp.concatenate([membrane.vertices, membrane.reference, marks], axis=1)


@jax.jit
def _split(
    carried: Float[Array, "m 7"],
) -> tuple[Float[Array, "m 3"], Float[Array, "m 3"], Float[Array, " m"]]:
    return carried[:, :3], carried[:, 3:6], carried[:, 6]


_average = jax.jit(average_parents)


def _vertex_capacity(mesh: Surface | Remeshing, most: int = 0) -> int:
    """Return the capacity of vertices that a mesh needs.

    It is at least half the number of faces and a third of the number of edges.
    """
    faces = len(mesh.faces)
    edges = (3 * faces + int(mesh.fixed.sum())) // 2
    needed = max(len(mesh.fixed), faces // 2 + 1, edges // 3 + 1, most)
    return capacity_for(needed, 256)


@jax.jit
def _rest(membrane: Membrane) -> dict[str, Float[Array, "k _"]]:
    return {term.name: term.at_rest(membrane) for term in MEMBRANE_TERMS}


def reset_springs(membrane: Membrane) -> Membrane:
    """Reset the rest data of all terms of the membrane.

    Springs are "assigned a new equilibrium length" (paper §4); healthy tissue keeps its
    own (see `jaxgrow.energy.term.MembraneTerm.at_rest`).
    """
    return membrane.with_rest(_rest(membrane.with_rest({})))


def as_reference(membrane: Membrane) -> Membrane:
    """Make the present positions the reference, and reset all rest data."""
    return reset_springs(replaced(membrane, reference=membrane.vertices))


def put_at_rest(
    vertices: Float[Array, "m 3"],
    mesh: Surface | Remeshing,
    reference: Float[Array, "m 3"] | None = None,
    hyperplasia: Float[Array, " m"] | None = None,
    *,
    room: bool = True,
) -> Membrane:
    """Build a membrane at rest from vertices and a mesh's connectivity.

    Args:
        vertices: on the device; padding behind those of the mesh.
        mesh: gives faces, fixed vertices and source.
        reference: positions before growth; the present ones by default.
        hyperplasia: of each vertex; 1 by default.
        room: whether to pad to twice as many faces and three times as many edges as
            vertices, or not at all.
    """
    capacity = vertices.shape[0]
    topology = build_topology(mesh.faces, len(mesh.fixed))
    edges = topology.edges
    faces = len(mesh.faces)
    most_faces = 2 * capacity if room else faces
    most_edges = 3 * capacity if room else len(edges)
    membrane = Membrane(
        vertices=vertices,
        faces=put(padded(mesh.faces, most_faces)),
        edges=put(padded(edges, most_edges)),
        opposite=put(padded(topology.opposite, most_edges, -1)),
        rest={},
        reference=vertices if reference is None else reference,
        hyperplasia=jnp.ones_like(vertices[:, 0])
        if hyperplasia is None
        else hyperplasia,
        vertex_alive=put(np.arange(capacity) < len(mesh.fixed)),
        face_alive=put(np.arange(most_faces) < faces),
        edge_alive=put(np.arange(most_edges) < len(edges)),
        pinned=put(padded(mesh.fixed, capacity)),
        source=put(np.asarray(mesh.source)),
    )
    return reset_springs(membrane)
