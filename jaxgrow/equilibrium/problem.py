"""Minimisation problem: the sum of the energy terms that a scene has."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

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
    Contacts,
    list_contacts,
    narrow_contacts,
    reach,
)
from jaxgrow.energy.pair import pair_energy, pair_force
from jaxgrow.energy.parameters import as_arrays, Parameters
from jaxgrow.energy.term import energy_of_elements, MembraneTerm, Term
from jaxgrow.energy.terms import MEMBRANE_TERMS
from jaxgrow.equilibrium.extra_terms import (
    as_module,
    check_names,
    EnergyFunction,
    ExtraTerms,
)
from jaxgrow.equilibrium.lists import Lists, Outgrown
from jaxgrow.equilibrium.loops import evaluate, Loops, wired
from jaxgrow.neighbors import verlet_list as nb
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Membrane, Nodes, Particles, replaced


CONTACT_SKIN = 0.15
"""Extra radius of the contact list, in r0: it is valid until the farthest moves of a
particle and of a vertex exceed it together."""

CANDIDATE_SKIN = 0.9
"""Extra radius of the wide list that the contact list is filtered from."""


LARGEST_STEP = 0.1
"""Longest displacement of a node in one step, in r0."""

LEAST_LISTED = 2.5 * LARGEST_STEP
"""Distance, in r0, up to which parts of the membrane are always listed: parts that are
not listed must not meet within one step of both."""

COLLISION_SKIN = 0.3
"""Extra distance of the collision list, in r0: it is valid until the farthest moves of
two vertices exceed it together."""


class Distances(NamedTuple):
    """Exact distances of the listed pairs, in r0.

    Attributes:
        contact: of particle-triangle pairs; None without that term.
        collision: of vertex-triangle and edge-edge pairs; None without that term.
    """

    contact: Float[Array, " p"] | None
    collision: PairDistances | None


def _acts(modulus: Scalar) -> bool:
    """Return whether a modulus is not 0, or is being differentiated."""
    return isinstance(modulus, Tracer) or float(modulus) != 0


class Problem(eqx.Module):
    """Energy of particle positions and membrane vertices, with free nodes.

    Attributes:
        particles: None for a membrane alone.
        membrane: None for particles alone.
        parameters: of all terms.
        load: external force on every vertex, in F(0), or None.
        terms: energies that are sums over elements.
        functions: further energies, of particles and membrane, in F(0) r0.
        loops: of the terms, if a CPU evaluates them; see `with_loops`.
    """

    particles: Particles | None
    membrane: Membrane | None
    parameters: Parameters
    load: Float[Array, "m 3"] | None = None
    terms: tuple[Term, ...] = MEMBRANE_TERMS
    functions: tuple[EnergyFunction, ...] = ()
    loops: Loops | None = None

    @classmethod
    def of(
        cls,
        particles: Particles | None,
        membrane: Membrane | None,
        parameters: Parameters | None = None,
        load: Float[Array, "m 3"] | None = None,
        extra: ExtraTerms = (),
    ) -> "Problem":
        """Build a problem; its parameters become arrays.

        A Python float would be a constant, and each value another compilation. Terms of
        the membrane whose modulus is 0, and carries no derivative, are left out.

        Args:
            particles: or None for a membrane alone.
            membrane: or None for particles alone.
            parameters: of all terms; by default `Parameters()`.
            load: external force on every vertex, in F(0).
            extra: further terms: objects of the kind of `jaxgrow.energy.term.Term`, or
                functions of particles and membrane.

        Raises:
            ValueError: terms share a name.
        """
        parameters = Parameters() if parameters is None else parameters
        known = MEMBRANE_TERMS if membrane is not None else ()
        own = [term for term in extra if isinstance(term, Term)]
        check_names(own)
        terms = [t for t in known if _acts(getattr(parameters, t.modulus))]
        terms += own
        functions = [f for f in extra if not isinstance(f, Term)]
        if membrane is not None:
            new = [t for t in terms if isinstance(t, MembraneTerm)]
            new = [t for t in new if t.name not in membrane.rest]
            more = {term.name: term.at_rest(membrane) for term in new}
            membrane = (
                membrane.with_rest({**membrane.rest, **more}) if new else membrane
            )
        problem = cls(
            *(particles, membrane, parameters, load),
            terms=tuple(terms),
            functions=tuple(map(as_module, functions)),
        )
        arrays = as_arrays(parameters, problem.dtype)
        return problem.but(parameters=arrays)

    def with_loops(self, loops: Loops | None) -> "Problem":
        """Return the same problem with other loops."""
        return self if loops is self.loops else self.but(loops=loops)

    def but(self, **changes: Any) -> "Problem":
        """Return the same problem with other values of some fields."""
        return replaced(self, **changes)

    @property
    def dtype(self) -> jnp.dtype:
        """Dtype of the positions."""
        if self.particles is not None:
            return self.particles.position.dtype
        assert self.membrane is not None
        return self.membrane.vertices.dtype

    def both(self) -> tuple[Particles, Membrane]:
        """Return particles and membrane of a problem that has both."""
        assert self.particles is not None
        assert self.membrane is not None
        return self.particles, self.membrane

    def nodes(self) -> Nodes:
        """Return the current positions of all nodes."""
        return Nodes(
            None if self.particles is None else self.particles.position,
            None if self.membrane is None else self.membrane.vertices,
        )

    def at(self, nodes: Nodes) -> "Problem":
        """Return the same problem with its nodes at other positions."""
        particles, membrane = self.particles, self.membrane
        if particles is not None:
            assert nodes.particles is not None
            particles = particles.at(nodes.particles)
        if membrane is not None:
            assert nodes.vertices is not None
            membrane = membrane.at(nodes.vertices)
        return self.but(particles=particles, membrane=membrane)

    def free(self) -> Nodes:
        """Return 1 for rows that may move, 0 for held, pinned and padding ones."""
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
        """Return the energy, in F(0) r0; only terms of the scene are traced."""
        return self.at(nodes).energy_here(lists)

    def forces(self, nodes: Nodes, lists: Lists) -> Nodes:
        """Return minus the gradient of the energy, on held and pinned nodes too."""
        return self._forces_and_clearances(nodes, lists)[0]

    def bound(
        self,
        nodes: Nodes,
        lists: Lists,
        largest: Scalar,
        distances: Distances | None = None,
    ) -> Nodes:
        """Return how far each node may move in one step, in r0.

        It is `largest`, or 0.4 of the clearance of the particle or vertex (see
        `jaxgrow.energy.contact.clearances` and
        `jaxgrow.energy.collision.collision_clearances`), so that nothing crosses the
        membrane, itself included.

        Args:
            nodes: positions.
            lists: valid there.
            largest: in r0.
            distances: if they are known.
        """
        at = self.at(nodes)
        if distances is None:
            distances = at.distances(lists)
        return at._bound_by(at._clearances(lists, distances), largest)

    def _bound_by(self, clear: Nodes, largest: Scalar) -> Nodes:
        """Return the bound of every node from its clearance."""
        return jax.tree.map(
            lambda free, near: free[:, 0] * jnp.minimum(largest, 0.4 * near),
            *(self.free(), clear),
        )

    def _clearances(self, lists: Lists, distances: Distances) -> Nodes:
        """Return the distance of every node to obstacles; infinite for none."""
        clear = jax.tree.map(lambda x: jnp.full_like(x[:, 0], jnp.inf), self.nodes())
        if lists.contacts is not None:
            assert distances.contact is not None
            particles, membrane = self.both()
            count = particles.position.shape[0]
            given = lists.contacts, membrane, count
            clear = Nodes(*clearances(distances.contact, *given))
        if lists.collisions is not None:
            assert self.membrane is not None
            given = self.membrane, lists.collisions, distances.collision
            assert clear.vertices is not None
            near = jnp.minimum(clear.vertices, collision_clearances(*given))
            clear = eqx.tree_at(lambda n: n.vertices, clear, near)
        return clear

    def forces_and_bound(
        self, nodes: Nodes, lists: Lists, largest: Scalar
    ) -> tuple[Nodes, Nodes]:
        """Return forces and bound, from the same distances."""
        forces, clear = self._forces_and_clearances(nodes, lists)
        return forces, self._bound_by(clear, largest)

    def outgrown(self, nodes: Nodes, lists: Lists) -> Outgrown:
        """Return which lists are not valid at these positions."""
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
        """Rebuild the lists that are not valid at these positions.

        The host lists the collisions, and the near ones are filtered from its list; if
        that is no longer valid it is marked as stale.
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
        """Filter the near collisions from the host's list, to a capacity."""
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
        """Rebuild both contact lists at the nodes, with the same capacities."""
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
        """Rebuild the lists for new positions where a node moved too far."""
        return self.rebuilt(nodes, lists, self.outgrown(nodes, lists))

    def distances(self, lists: Lists) -> Distances:
        """Return exact distances of the listed pairs at the nodes."""
        contact = collision = None
        if lists.contacts is not None:
            contact = contact_distances(*self.both(), lists.contacts)
        if lists.collisions is not None and self.membrane is not None:
            collision = lists.collisions.distances(self.membrane)
        return Distances(contact, collision)

    def _forces_and_clearances(self, nodes: Nodes, lists: Lists) -> tuple[Nodes, Nodes]:
        """Compute both by loops if available, else by autodiff."""
        done = () if self.loops is None else self.loops.names
        with_load = self.at(nodes)._with_load

        def rest(at: Nodes) -> tuple[Float[Array, ""], Distances]:
            moved = self.at(at)
            apart = moved.distances(lists)
            here = moved.energy_here(lists, apart, (*done, "pair", "load"))
            return here, apart

        if self.loops is not None and self.is_looped(lists):
            forces, clear = evaluate(self, nodes, lists)
            return with_load(forces), clear
        slope, apart = jax.grad(rest, has_aux=True)(nodes)
        forces = jax.tree.map(jnp.negative, slope)
        if self.loops is not None:
            forces = jax.tree.map(jnp.add, forces, evaluate(self, nodes, lists)[0])
        if lists.neighbors is not None and "pair" not in done:
            particles = self.at(nodes).particles
            assert particles is not None
            # without the energy, which its derivative rule evaluates too
            pair = pair_force(particles, lists.neighbors.listed, self.parameters)
            forces = eqx.tree_at(lambda n: n.particles, forces, forces.particles + pair)
        return with_load(forces), self.at(nodes)._clearances(lists, apart)

    def _with_load(self, forces: Nodes) -> Nodes:
        """Add the load to forces."""
        if self.load is None or self.membrane is None:
            return forces
        assert forces.vertices is not None
        return Nodes(forces.particles, forces.vertices + self.load)

    def is_looped(self, lists: Lists) -> bool:
        """Return whether loops evaluate everything but the load."""
        assert self.loops is not None
        names = {term.name for term in wired(self, lists)}
        return not self.functions and names <= set(self.loops.names)

    def energy_here(
        self,
        lists: Lists,
        apart: Distances | None = None,
        but: tuple[str, ...] = (),
    ) -> Float[Array, ""]:
        """Return the energy where the nodes are, in F(0) r0.

        Args:
            lists: valid there.
            apart: distances of what is listed, if they are known.
            but: names of terms to leave out.
        """
        if apart is None:
            apart = self.distances(lists)
        total = jnp.zeros((), self.dtype)
        particles, membrane = self.particles, self.membrane
        for term in self.terms:
            elements = term.elements(particles, membrane)
            if elements is not None and term.name not in but:
                rows = jnp.concatenate(jax.tree.leaves(self.nodes()))
                total += energy_of_elements(term, rows, elements, self.parameters)
        for function in self.functions:
            total += function(particles, membrane)
        if lists.collisions is not None and "collision" not in but:
            assert membrane is not None
            given = lists.collisions, self.parameters, apart.collision
            total += collision_energy(membrane, *given)
        if lists.contacts is not None and "contact" not in but:
            given = lists.contacts, self.parameters, apart.contact
            total += contact_energy(*self.both(), *given)
        if lists.neighbors is not None and "pair" not in but:
            assert particles is not None
            listed = lists.neighbors.listed
            total += pair_energy(particles, listed, self.parameters)
        if self.load is not None and membrane is not None and "load" not in but:
            total -= jnp.sum(self.load * membrane.vertices)
        return total
