"""What is minimised: the sum of the energy terms that a scene has."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgrow import neighbors as nb
from jaxgrow.energy.collision import (
    collision_clearances,
    collision_energy,
    Collisions,
)
from jaxgrow.energy.contact import (
    clearances,
    contact_distances,
    contact_energy,
    Contacts,
    list_contacts,
    reach,
)
from jaxgrow.energy.pair import pair_energy, pair_force
from jaxgrow.energy.springs import spring_energy
from jaxgrow.numerics import safe_norm
from jaxgrow.parameters import Parameters
from jaxgrow.state import Membrane, Nodes, Particles
from jaxgrow.types import Scalar


CONTACT_SKIN = 0.3
"""Extra radius of the contact list: it holds until a node has moved by half of it."""


class Lists(eqx.Module):
    """The lists of a problem, each only where it has the term."""

    neighbors: nb.NeighborList | None
    contacts: Contacts | None
    collisions: Collisions | None = None

    @property
    def overflow(self) -> Bool[Array, ""]:
        """Whether a list did not fit."""
        full = jnp.zeros((), bool)
        if self.neighbors is not None:
            full |= nb.overflowed(self.neighbors)
        if self.contacts is not None:
            full |= self.contacts.overflow
        return full

    @property
    def stale(self) -> Bool[Array, ""]:
        """Whether the host must list the collisions anew before the next step."""
        if self.collisions is None:
            return jnp.zeros((), bool)
        return self.collisions.stale


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
        dtype = cls(particles, membrane, given).dtype
        arrays: Parameters = jax.tree.map(lambda v: jnp.asarray(v, dtype), given)
        return cls(particles, membrane, arrays, load)

    @property
    def dtype(self) -> jnp.dtype:
        """Of the positions."""
        return jax.tree.leaves(self.nodes())[0].dtype

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
        new = self
        if self.particles is not None:
            new = eqx.tree_at(lambda p: p.particles.position, new, nodes.particles)
        if self.membrane is not None:
            new = eqx.tree_at(lambda p: p.membrane.vertices, new, nodes.vertices)
        return new

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
        return self.at(nodes)._total(lists, pairs=True)

    def forces(self, nodes: Nodes, lists: Lists) -> Nodes:
        """Minus the gradient of the energy, on held and pinned nodes too.

        The pair force is evaluated on its own; it would be the same through the
        derivative rule of `pair_energy`, which costs the energy as well.
        """

        def rest(at: Nodes) -> Float[Array, ""]:
            return self.at(at)._total(lists, pairs=False)

        if self.membrane is None:
            total = jax.tree.map(jnp.zeros_like, nodes)
        else:
            total = jax.tree.map(jnp.negative, jax.grad(rest)(nodes))
        if lists.neighbors is not None:
            moved = self.at(nodes)
            assert moved.particles is not None
            pair = pair_force(
                moved.particles, nb.listed(lists.neighbors), self.parameters
            )
            total = eqx.tree_at(lambda n: n.particles, total, total.particles + pair)
        return total

    def bound(self, nodes: Nodes, lists: Lists, largest: Scalar) -> Nodes:
        """How far each node may move in one step: `largest`, or less near contact.

        0.4 of the clearance of each particle and vertex (see
        `jaxgrow.energy.contact.clearances` and
        `jaxgrow.energy.collision.collision_clearances`), so that nothing crosses the
        membrane, itself included.
        """
        free = self.free()
        limit = jax.tree.map(lambda f: f[:, 0] * largest, free)
        at = self.at(nodes)
        if lists.contacts is not None:
            particles, membrane = at.both()
            distance = contact_distances(particles, membrane, lists.contacts)
            near = clearances(
                distance, lists.contacts, membrane, particles.position.shape[0]
            )
            limit = Nodes(
                jnp.minimum(limit.particles, 0.4 * near[0]),
                jnp.minimum(limit.vertices, 0.4 * near[1]),
            )
        if lists.collisions is not None:
            assert at.membrane is not None
            clear = collision_clearances(at.membrane, lists.collisions)
            limit = eqx.tree_at(
                lambda n: n.vertices, limit, jnp.minimum(limit.vertices, 0.4 * clear)
            )
        return limit

    def update(self, nodes: Nodes, lists: Lists) -> Lists:
        """The lists for new positions, rebuilt where something moved too far."""
        neighbors, contacts = lists.neighbors, lists.contacts
        if neighbors is not None:
            assert nodes.particles is not None
            neighbors = nb.update(neighbors, nodes.particles)
        if contacts is not None:
            particles, membrane = self.at(nodes).both()
            before = contacts.reference
            shift = jnp.maximum(
                jnp.max(safe_norm(particles.position - before[0])),
                jnp.max(safe_norm(membrane.vertices - before[1])),
            )
            radius = reach(self.parameters) + CONTACT_SKIN
            capacity = contacts.particle.shape[0]
            contacts = jax.lax.cond(
                shift > CONTACT_SKIN / 2,
                lambda: list_contacts(particles, membrane, radius, capacity),
                lambda: contacts,
            )
        collisions = lists.collisions
        if collisions is not None:
            assert nodes.vertices is not None
            collisions = collisions.checked(nodes.vertices)
        return Lists(neighbors, contacts, collisions)

    def _total(self, lists: Lists, *, pairs: bool) -> Float[Array, ""]:
        total = jnp.zeros((), self.dtype)
        if pairs and lists.neighbors is not None:
            assert self.particles is not None
            listed = nb.listed(lists.neighbors)
            total += pair_energy(self.particles, listed, self.parameters)
        if self.membrane is not None:
            total += spring_energy(self.membrane, self.parameters)
            if lists.contacts is not None:
                total += contact_energy(*self.both(), lists.contacts, self.parameters)
            if lists.collisions is not None:
                total += collision_energy(
                    self.membrane, lists.collisions, self.parameters
                )
            if self.load is not None:
                total -= jnp.sum(self.load * self.membrane.vertices)
        return total
