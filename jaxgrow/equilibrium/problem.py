"""What is minimised: the sum of the energy terms that a scene has."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgrow import neighbors as nb
from jaxgrow.energy.collision import (
    collision_clearances,
    collision_energy,
    Collisions,
    narrow_collisions,
    PairDistances,
)
from jaxgrow.energy.contact import (
    clearances,
    contact_distances,
    contact_energy,
    contact_forces,
    Contacts,
    list_contacts,
    narrow_contacts,
    reach,
)
from jaxgrow.energy.pair import pair_energy, pair_force
from jaxgrow.energy.springs import spring_energy
from jaxgrow.equilibrium.kept import Kept
from jaxgrow.parameters import as_arrays, Parameters
from jaxgrow.state import Membrane, Nodes, Particles
from jaxgrow.types import Scalar


CONTACT_SKIN = 0.15
"""Extra radius of the contact list, in r0: it holds until the farthest moves of a
particle and of a vertex exceed it together."""

CANDIDATE_SKIN = 0.9
"""Extra radius of the list that the contact list is found in."""


LARGEST_STEP = 0.1
"""Longest displacement of a node in one step, in r0."""

LEAST_LISTED = 2.5 * LARGEST_STEP
"""Distance, in r0, up to which parts of the membrane are listed in any case: what is
not listed must not meet within one step of both."""

COLLISION_SKIN = 0.3
"""Extra distance of the collision list, in r0: it holds until the farthest moves of two
vertices exceed it together."""


class Lists(eqx.Module):
    """The lists of a problem, each only where it has the term.

    Attributes:
        neighbors: of particles.
        contacts: pairs of a particle and a triangle that the energy is computed from.
        candidates: more of them, in which those are found again.
        collisions: of the membrane, that the energy is computed from.
        encounters: more of them, listed by the host, in which those are found again;
            None where the host's are the energy's.
        kept: pair forces that were evaluated last, where they are kept.
    """

    neighbors: nb.Neighbors | None
    contacts: Contacts | None
    candidates: Contacts | None = None
    collisions: Collisions | None = None
    encounters: Collisions | None = None
    kept: Kept | None = None

    @property
    def overflow(self) -> Bool[Array, ""]:
        """Whether a list did not fit."""
        full = jnp.zeros((), bool)
        if self.neighbors is not None:
            full |= self.neighbors.overflow
        if self.contacts is not None:
            full |= self.contacts.overflow
        if self.candidates is not None:
            full |= self.candidates.overflow
        if self.collisions is not None:
            full |= self.collisions.full
        return full

    @property
    def of_host(self) -> Collisions | None:
        """The collisions that the host listed."""
        return self.collisions if self.encounters is None else self.encounters

    @property
    def stale(self) -> Bool[Array, ""]:
        """Whether the host must list the collisions anew before the next step."""
        if self.of_host is None:
            return jnp.zeros((), bool)
        return self.of_host.stale

    def with_collisions(
        self, collisions: Collisions | None, encounters: Collisions | None = None
    ) -> "Lists":
        """The same lists with others of the collisions."""
        known = self.neighbors, self.contacts, self.candidates
        return Lists(*known, collisions, encounters)

    def with_stale(self, stale: Bool[Array, ""]) -> "Lists":
        """The same lists; whether the host must list the collisions anew."""
        if self.of_host is None:
            return self
        return eqx.tree_at(lambda lists: lists.of_host.stale, self, stale)


class Outgrown(eqx.Module):
    """Which lists do not hold where the nodes are.

    Attributes:
        neighbors, contacts, collisions: what is listed anew on the device.
        of_host: the collisions that the host must list anew.
    """

    neighbors: Bool[Array, ""]
    contacts: Bool[Array, ""]
    collisions: Bool[Array, ""]
    of_host: Bool[Array, ""]

    @classmethod
    def nothing(cls) -> "Outgrown":
        """All of them hold."""
        no = jnp.zeros((), bool)
        return cls(no, no, no, no)

    def any(self) -> Bool[Array, ""]:
        """Whether one does not."""
        return self.neighbors | self.contacts | self.collisions | self.of_host


class Distances(NamedTuple):
    """How far what may meet is apart, in r0.

    Attributes:
        contact: clearances of particles and vertices from each other; None without
            that term.
        collision: of a vertex and a triangle, and of two edges; likewise.
    """

    contact: tuple[Float[Array, " n"], Float[Array, " m"]] | None
    collision: PairDistances | None


class Problem(eqx.Module):
    """An energy of particle positions and membrane vertices, and what may move.

    Attributes:
        particles: None for a membrane alone.
        membrane: None for particles alone.
        parameters: of all terms.
        load: external force on every vertex, in F(0), or None.
    """

    particles: Particles | None
    membrane: Membrane | None
    parameters: Parameters
    load: Float[Array, "m 3"] | None = None

    @classmethod
    def of(
        cls,
        particles: Particles | None,
        membrane: Membrane | None,
        parameters: Parameters | None = None,
        load: Float[Array, "m 3"] | None = None,
    ) -> "Problem":
        """A problem whose parameters, by default `Parameters()`, are arrays.

        A Python float would be a constant of the program, compiled for each value.
        """
        given = Parameters() if parameters is None else parameters
        problem = cls(particles, membrane, given, load)
        arrays = as_arrays(given, problem.dtype)
        return problem if arrays is given else cls(particles, membrane, arrays, load)

    @property
    def dtype(self) -> jnp.dtype:
        """Of the positions."""
        if self.particles is not None:
            return self.particles.position.dtype
        assert self.membrane is not None
        return self.membrane.vertices.dtype

    def both(self) -> tuple[Particles, Membrane]:
        """Particles and membrane of a problem that has the contact between them."""
        assert self.particles is not None
        assert self.membrane is not None
        return self.particles, self.membrane

    def nodes(self) -> Nodes:
        """The current positions of everything."""
        return Nodes(
            None if self.particles is None else self.particles.position,
            None if self.membrane is None else self.membrane.vertices,
        )

    def at(self, nodes: Nodes) -> "Problem":
        """The same problem with its nodes at other positions."""
        particles, membrane = self.particles, self.membrane
        if particles is not None:
            assert nodes.particles is not None
            particles = particles.at(nodes.particles)
        if membrane is not None:
            assert nodes.vertices is not None
            membrane = membrane.at(nodes.vertices)
        return Problem(particles, membrane, self.parameters, self.load)

    def free(self) -> Nodes:
        """1 for rows that may move, 0 for held, pinned and padding ones."""
        particles = vertices = None
        if self.particles is not None:
            position = self.particles.position
            particles = jnp.where(
                self.particles.free[:, None], jnp.ones_like(position), 0
            )
        if self.membrane is not None:
            corner = self.membrane.vertices
            vertices = jnp.where(self.membrane.free[:, None], jnp.ones_like(corner), 0)
        return Nodes(particles, vertices)

    def energy(self, nodes: Nodes, lists: Lists) -> Float[Array, ""]:
        """Energy in F(0) r0; only the terms that the scene has are traced."""
        at = self.at(nodes)
        total = at._of_membrane(lists, None)
        if lists.contacts is not None:
            total += contact_energy(*at.both(), lists.contacts, self.parameters)
        if lists.neighbors is not None:
            assert at.particles is not None
            total += pair_energy(at.particles, lists.neighbors.listed, self.parameters)
        return total

    def forces(self, nodes: Nodes, lists: Lists) -> Nodes:
        """Minus the gradient of the energy, on held and pinned nodes too.

        The pair force is evaluated on its own; it would be the same through the
        derivative rule of `pair_energy`, which costs the energy as well.
        """
        return self._forces_and_distances(nodes, lists)[0]

    def bound(
        self,
        nodes: Nodes,
        lists: Lists,
        largest: Scalar,
        distances: Distances | None = None,
    ) -> Nodes:
        """How far each node may move in one step: `largest`, or less near contact.

        0.4 of the clearance of each particle and vertex (see
        `jaxgrow.energy.contact.clearances` and
        `jaxgrow.energy.collision.collision_clearances`), so that nothing crosses the
        membrane, itself included.

        Args:
            nodes: where they are.
            lists: valid there.
            largest: in r0.
            distances: if they are known.
        """
        free = self.free()
        limit = jax.tree.map(lambda f: f[:, 0] * largest, free)
        at = self.at(nodes)
        if distances is None:
            distances = at.distances(lists)
        if lists.contacts is not None:
            assert distances.contact is not None
            of_particles, of_vertices = distances.contact
            limit = Nodes(
                jnp.minimum(limit.particles, 0.4 * of_particles),
                jnp.minimum(limit.vertices, 0.4 * of_vertices),
            )
        if lists.collisions is not None:
            assert at.membrane is not None
            assert distances.collision is not None
            clear = collision_clearances(
                at.membrane, lists.collisions, distances.collision
            )
            limit = eqx.tree_at(
                lambda n: n.vertices, limit, jnp.minimum(limit.vertices, 0.4 * clear)
            )
        return limit

    def forces_and_bound(
        self, nodes: Nodes, lists: Lists, largest: Scalar
    ) -> tuple[Nodes, Nodes]:
        """Both, from the same distances."""
        forces, distances = self._forces_and_distances(nodes, lists)
        return forces, self.bound(nodes, lists, largest, distances)

    def outgrown(self, nodes: Nodes, lists: Lists) -> Outgrown:
        """Which lists do not hold at these positions: something moved too far."""
        outgrown = Outgrown.nothing()
        if lists.neighbors is not None:
            assert nodes.particles is not None
            moved = nb.outgrown(lists.neighbors, nodes.particles)
            outgrown = eqx.tree_at(lambda o: o.neighbors, outgrown, moved)
        if lists.contacts is not None:
            assert nodes.particles is not None
            assert nodes.vertices is not None
            moved = lists.contacts.moved(nodes.particles, nodes.vertices)
            stale = ~(moved <= CONTACT_SKIN)  # NaN too
            outgrown = eqx.tree_at(lambda o: o.contacts, outgrown, stale)
        if lists.collisions is not None and lists.of_host is not None:
            assert nodes.vertices is not None
            moved = tuple(
                listed.checked(nodes.vertices).stale
                for listed in (lists.collisions, lists.of_host)
            )
            outgrown = eqx.tree_at(lambda o: (o.collisions, o.of_host), outgrown, moved)
        return outgrown

    def rebuilt(self, nodes: Nodes, lists: Lists, outgrown: Outgrown) -> Lists:
        """The lists for these positions, those that do not hold there rebuilt.

        Collisions are listed by the host, and those near now found in its list; that it
        must make another is noted.
        """
        neighbors = lists.neighbors
        if neighbors is not None:
            assert nodes.particles is not None
            neighbors = nb.rebuilt(neighbors, nodes.particles, outgrown.neighbors)
        contacts, candidates = lists.contacts, lists.candidates
        if contacts is not None and candidates is not None:
            contacts, candidates = jax.lax.cond(
                outgrown.contacts,
                lambda *old: self.at(nodes).contacts(*old),
                lambda *old: old,
                contacts,
                candidates,
            )
        collisions = lists.collisions
        if lists.encounters is not None and collisions is not None:
            room = collisions.vertex.shape[0]
            wide = lists.encounters
            collisions = jax.lax.cond(
                outgrown.collisions,
                lambda: self.at(nodes).collisions(wide, room),
                lambda: collisions,
            )
        lists = Lists(neighbors, contacts, candidates, collisions, lists.encounters)
        return lists.with_stale(outgrown.of_host)

    def collisions(self, wide: Collisions, room: int) -> Collisions:
        """What is near now of the host's list, in arrays of the given size."""
        assert self.membrane is not None
        return narrow_collisions(
            wide,
            self.membrane,
            self.parameters,
            least=LEAST_LISTED,
            skin=COLLISION_SKIN,
            room=room,
        )

    def contacts(
        self, contacts: Contacts, candidates: Contacts
    ) -> tuple[Contacts, Contacts]:
        """Both lists for where the nodes are, in arrays of the given sizes."""
        particles, membrane = self.both()
        whole = reach(self.parameters)
        moved = candidates.moved(particles.position, membrane.vertices)
        room = candidates.particle.shape[0]
        candidates = jax.lax.cond(
            moved <= CANDIDATE_SKIN - CONTACT_SKIN,
            lambda: candidates,
            lambda: list_contacts(particles, membrane, whole + CANDIDATE_SKIN, room),
        )
        near = narrow_contacts(
            candidates,
            particles,
            membrane,
            whole + CONTACT_SKIN,
            contacts.particle.shape[0],
        )
        return near, candidates

    def update(self, nodes: Nodes, lists: Lists) -> Lists:
        """The lists for new positions, rebuilt where something moved too far."""
        return self.rebuilt(nodes, lists, self.outgrown(nodes, lists))

    def distances(self, lists: Lists) -> Distances:
        """Where the nodes are."""
        contact = collision = None
        if self.membrane is not None:
            if lists.contacts is not None:
                particles, membrane = self.both()
                apart = contact_distances(particles, membrane, lists.contacts)
                count = particles.position.shape[0]
                contact = clearances(apart, lists.contacts, membrane, count)
            if lists.collisions is not None:
                collision = lists.collisions.distances(self.membrane)
        return Distances(contact, collision)

    def _forces_and_distances(
        self, nodes: Nodes, lists: Lists
    ) -> tuple[Nodes, Distances]:
        def of_membrane(at: Nodes) -> tuple[Float[Array, ""], PairDistances | None]:
            moved = self.at(at)
            apart = None
            if lists.collisions is not None and moved.membrane is not None:
                apart = lists.collisions.distances(moved.membrane)
            return moved._of_membrane(lists, apart), apart

        moved = self.at(nodes)
        total, contact, collision = jax.tree.map(jnp.zeros_like, nodes), None, None
        if self.membrane is not None:
            slope, collision = jax.grad(of_membrane, has_aux=True)(nodes)
            total = jax.tree.map(jnp.negative, slope)
        if lists.contacts is not None:
            found = contact_forces(*moved.both(), lists.contacts, self.parameters)
            contact = found.clearances
            pushed = Nodes(found.particles, found.vertices)
            total = jax.tree.map(jnp.add, total, pushed)
        if lists.neighbors is not None:
            assert moved.particles is not None
            pair = pair_force(moved.particles, lists.neighbors.listed, self.parameters)
            total = eqx.tree_at(lambda n: n.particles, total, total.particles + pair)
        return total, Distances(contact, collision)

    def _of_membrane(
        self, lists: Lists, apart: PairDistances | None
    ) -> Float[Array, ""]:
        """Energy of the membrane but for its contact with particles."""
        total = jnp.zeros((), self.dtype)
        if self.membrane is None:
            return total
        total += spring_energy(self.membrane, self.parameters)
        if lists.collisions is not None:
            total += collision_energy(
                self.membrane, lists.collisions, self.parameters, apart
            )
        if self.load is not None:
            total -= jnp.sum(self.load * self.membrane.vertices)
        return total
