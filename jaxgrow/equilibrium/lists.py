"""Lists of a problem: neighbours, contacts, collisions, and validity."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgrow.energy.collision import Collisions
from jaxgrow.energy.contact import Contacts
from jaxgrow.neighbors import verlet_list as nb
from jaxgrow.state import Particles


class Kept(eqx.Module):
    """Cached pair forces, with their particles and parameters.

    Attributes:
        particles: on which they act.
        law: parameters of the pair energy.
        force: in F(0).
    """

    particles: Particles
    law: Float[Array, " p"]
    force: Float[Array, "n 3"]


class Lists(eqx.Module):
    """Lists of a problem, each only if it has the term.

    Attributes:
        neighbors: of particles.
        contacts: pairs of a particle and a triangle that the energy is computed from.
        candidates: wide list from which the contacts are filtered.
        collisions: of the membrane, that the energy is computed from.
        encounters: wide list made by the host, from which the collisions are filtered;
            None if the energy uses the host's list itself.
        kept: cached pair forces, if any.
    """

    neighbors: nb.Neighbors | None
    contacts: Contacts | None
    candidates: Contacts | None = None
    collisions: Collisions | None = None
    encounters: Collisions | None = None
    kept: Kept | None = None

    @property
    def overflow(self) -> Bool[Array, ""]:
        """Whether a list overflowed."""
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
        """Whether the host must rebuild the collision list before the next step."""
        if self.of_host is None:
            return jnp.zeros((), bool)
        return self.of_host.stale

    def with_collisions(
        self, collisions: Collisions | None, encounters: Collisions | None = None
    ) -> "Lists":
        """Return the same lists with other collision lists."""
        known = self.neighbors, self.contacts, self.candidates
        return Lists(*known, collisions, encounters)

    def with_stale(self, stale: Bool[Array, ""]) -> "Lists":
        """Mark whether the host must rebuild the collision list."""
        if self.of_host is None:
            return self
        return eqx.tree_at(lambda lists: lists.of_host.stale, self, stale)


class Outgrown(eqx.Module):
    """Flags of the lists that are not valid at the nodes.

    Attributes:
        neighbors, contacts, collisions: lists that the device rebuilds.
        of_host: the collision list that the host must rebuild.
    """

    neighbors: Bool[Array, ""]
    contacts: Bool[Array, ""]
    collisions: Bool[Array, ""]
    of_host: Bool[Array, ""]

    @classmethod
    def nothing(cls) -> "Outgrown":
        """Return flags for which all lists are valid."""
        no = jnp.zeros((), bool)
        return cls(no, no, no, no)

    def any(self) -> Bool[Array, ""]:
        """Return whether some list is not valid."""
        return self.neighbors | self.contacts | self.collisions | self.of_host
