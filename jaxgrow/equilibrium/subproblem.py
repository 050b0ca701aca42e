"""Subproblem of a larger problem: some nodes move, those around are held."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.energy.a2 import CUTOFF
from jaxgrow.energy.contact import reach
from jaxgrow.energy.term import MembraneTerm
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.neighbors.within_radius import near_seeds
from jaxgrow.numerics.capacity import capacity_for
from jaxgrow.state import Membrane, Nodes, Particles
from jaxgrow.transfer.device import get, get_number, padded, parked, put


_LEAST = 1024


class Mask(NamedTuple):
    """Subset of the nodes."""

    particles: Bool[np.ndarray, " n"]
    vertices: Bool[np.ndarray, " m"]

    @property
    def size(self) -> int:
        """Number of nodes in the subset."""
        return int(self.particles.sum() + self.vertices.sum())

    def joined(self, other: "Mask") -> "Mask":
        """Return the union with another subset."""
        return Mask(*(own | more for own, more in zip(self, other, strict=True)))


class Part(NamedTuple):
    """Subproblem cut out of a larger one.

    Attributes:
        problem: the subproblem; near nodes that may not move are held and pinned.
        particles: their indices in the whole.
        vertices: their indices in the whole; empty without a membrane.
    """

    problem: Problem
    particles: Int[np.ndarray, " p"]
    vertices: Int[np.ndarray, " v"]

    def put(self, nodes: Nodes, into: Nodes) -> Nodes:
        """Write the positions of the part into those of the whole."""

        def placed(
            part: Array | None, whole: Array | None, index: np.ndarray
        ) -> Array | None:
            if part is None or whole is None:
                return whole
            rows = np.array(get(whole))
            rows[index] = get(part)[: len(index)]
            return put(rows)

        return Nodes(
            placed(nodes.particles, into.particles, self.particles),
            placed(nodes.vertices, into.vertices, self.vertices),
        )


def _both(nodes: Nodes) -> tuple[Array | None, Array | None]:
    """Return the rows of particles and of vertices."""
    return nodes.particles, nodes.vertices


def _points(problem: Problem) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return positions of all slots on the host; dead vertices are far away."""
    particles = vertices = None
    if problem.particles is not None:
        particles = get(problem.particles.position)
    if problem.membrane is not None:
        alive = get(problem.membrane.vertex_alive)
        vertices = np.where(alive[:, None], get(problem.membrane.vertices), 1e9)
    return particles, vertices


def _around(problem: Problem, some: Mask, radius: float) -> Mask:
    """Return all nodes within a radius of some of them."""
    points = _points(problem)
    placed = zip(points, some, strict=True)
    seeds = np.concatenate([rows[mask] for rows, mask in placed if rows is not None])
    return Mask(*(near_seeds(place, seeds, radius) for place in points))


def none_of(problem: Problem) -> Mask:
    """Return the empty subset of the nodes."""
    nodes = problem.nodes()
    counts = [0 if rows is None else rows.shape[0] for rows in _both(nodes)]
    return Mask(*(np.zeros(count, bool) for count in counts))


def able(problem: Problem) -> Mask:
    """Return the subset of nodes that may move at all."""
    none = none_of(problem)
    return Mask(
        none.particles if problem.particles is None else get(problem.particles.free),
        none.vertices if problem.membrane is None else get(problem.membrane.free),
    )


class Sizes(NamedTuple):
    """Norm of a vector per node."""

    particles: Float[np.ndarray, " n"]
    vertices: Float[np.ndarray, " m"]

    @classmethod
    def of(cls, force: Nodes, free: Mask) -> "Sizes":
        """Compute the norm of the force on every node, 0 on those held."""

        def size(rows: Array | None, on: Bool[np.ndarray, " k"]) -> np.ndarray:
            if rows is None:
                return np.zeros(0)
            host = get(rows)
            return np.where(on, np.sqrt(np.einsum("ij,ij->i", host, host)), 0)

        rows = zip(_both(force), free, strict=True)
        return cls(*(size(each, on) for each, on in rows))

    @property
    def largest(self) -> float:
        """Largest norm of all nodes; NaN if one is."""
        return float(max(np.max(each, initial=0) for each in self if len(each)))

    def above(self, tolerance: float) -> Mask:
        """Return the subset of nodes above a tolerance."""
        return Mask(*(each > tolerance for each in self))


def around(problem: Problem, some: Mask, free: Mask, radius: float) -> Mask:
    """Return the free nodes within a radius, in r0, of some nodes.

    Args:
        problem: the whole.
        some: the nodes.
        free: nodes that may move at all.
        radius: in r0.
    """
    near = _around(problem, some, radius)
    return Mask(*(on & may for on, may in zip(near, free, strict=True)))


def cut(problem: Problem, moving: Mask, margin: float) -> Part:
    """Cut out the problem of some nodes, with all that act on them.

    Args:
        problem: the whole.
        moving: nodes that may move.
        margin: distance that a node may move, in r0, before it could meet nodes that
            are not cut out.
    """
    near = _around(problem, moving, _span(problem) + margin)
    needed = int(near.particles.sum())
    if problem.membrane is not None:
        needed = max(needed, 2 * _vertices_needed(problem.membrane, near.vertices))
    room = capacity_for(needed, _LEAST)
    particles = membrane = load = None
    if problem.particles is not None:
        particles = _cut_particles(problem.particles, near, moving, room)
    if problem.membrane is not None:
        membrane = _cut_membrane(problem.membrane, near, moving, room // 2)
    if problem.load is not None:
        load = put(padded(get(problem.load)[near.vertices], room // 2))
    return Part(
        problem.but(particles=particles, membrane=membrane, load=load),
        np.flatnonzero(near.particles),
        np.flatnonzero(near.vertices),
    )


def _span(problem: Problem) -> float:
    """Return the interaction range: beyond it nodes do not act on each other."""
    membrane = problem.membrane
    if membrane is None:
        return CUTOFF
    ends = get(membrane.vertices)[get(membrane.edges)[get(membrane.edge_alive)]]
    longest = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).max(initial=0.0)
    across = max(
        (t.edges for t in problem.terms if isinstance(t, MembraneTerm)), default=1
    )
    touched = get_number(reach(problem.parameters)) + longest
    return max(CUTOFF, touched, across * longest)


def _vertices_needed(membrane: Membrane, near: Bool[np.ndarray, " m"]) -> int:
    """Return the capacity of vertices that the near part needs.

    It is at least half the number of faces and a third of the number of edges.
    """
    faces, _ = _within(membrane.faces, membrane.face_alive, near)
    edges, _ = _within(membrane.edges, membrane.edge_alive, near)
    return max(int(near.sum()), len(faces) // 2 + 1, len(edges) // 3 + 1)


def _within(
    corners: Int[Array, "f k"], alive: Bool[Array, " f"], near: Bool[np.ndarray, " m"]
) -> tuple[Int[np.ndarray, " g"], Int[np.ndarray, "g k"]]:
    """Find faces or edges with all vertices near, and renumber these."""
    rows = get(corners)
    chosen = np.flatnonzero(get(alive) & near[rows].all(axis=1))
    number = np.cumsum(near) - 1
    return chosen, number[rows[chosen]]


def _cut_particles(
    particles: Particles, near: Mask, moving: Mask, room: int
) -> Particles:
    chosen = near.particles
    position = get(particles.position)[chosen]
    padding = parked(room - len(position), len(position)).astype(position.dtype)
    return Particles(
        position=put(np.concatenate([position, padding])),
        species=put(padded(get(particles.species)[chosen], room)),
        alive=put(padded(get(particles.alive)[chosen], room)),
        held=put(padded(~moving.particles[chosen], room)),
    )


def _cut_membrane(membrane: Membrane, near: Mask, moving: Mask, room: int) -> Membrane:
    chosen = near.vertices
    of_faces, faces = _within(membrane.faces, membrane.face_alive, chosen)
    which, edges = _within(membrane.edges, membrane.edge_alive, chosen)
    number = np.append(np.cumsum(chosen) - 1, -1)
    opposite = get(membrane.opposite)[which]
    inner = (opposite >= 0) & chosen[opposite]
    opposite = np.where(inner, number[opposite], -1)

    def fitted(array: np.ndarray, like: Array, size: int) -> Array:
        return put(padded(array.astype(like.dtype), size))

    return Membrane(
        vertices=fitted(get(membrane.vertices)[chosen], membrane.vertices, room),
        faces=fitted(faces, membrane.faces, 2 * room),
        edges=fitted(edges, membrane.edges, 3 * room),
        opposite=put(padded(opposite, 3 * room, -1)),
        rest={
            name: fitted(get(rest)[which], rest, 3 * room)
            if rest.shape[0] == membrane.edges.shape[0]
            else fitted(get(rest)[of_faces], rest, 2 * room)
            for name, rest in membrane.rest.items()
        },
        reference=fitted(get(membrane.reference)[chosen], membrane.reference, room),
        hyperplasia=fitted(
            get(membrane.hyperplasia)[chosen], membrane.hyperplasia, room
        ),
        vertex_alive=put(np.arange(room) < chosen.sum()),
        face_alive=put(np.arange(2 * room) < len(faces)),
        edge_alive=put(np.arange(3 * room) < len(edges)),
        pinned=put(padded(~moving.vertices[chosen], room)),
        source=jnp.asarray(-1, membrane.source.dtype),
    )
