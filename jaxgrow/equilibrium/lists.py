"""The lists of a problem: who is near whom, and which of them still hold."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgrow.energy.collision import Collisions
from jaxgrow.energy.contact import Contacts
from jaxgrow.neighbors import verlet_list as nb
from jaxgrow.state import Particles


class Kept(eqx.Module):
    """Pair forces, and what they are of.

    Attributes:
        particles: which felt them.
        law: parameters of the pair energy.
        force: in F(0).
    """

    particles: Particles
    law: Float[Array, " p"]
    force: Float[Array, "n 3"]


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
