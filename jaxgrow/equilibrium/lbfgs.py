"""Limited-memory BFGS on forces alone (Nocedal and Wright 2006).

Their algorithm 7.4, without line search and energy: near an equilibrium energies differ
by less than their rounding while forces are still exact, so a search on the energy
stalls early.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


class LBFGSMemory(eqx.Module):
    """Ring buffer of the last displacements and force changes.

    A new pair replaces the oldest, so that a step writes one row of each, in place.

    Attributes:
        displacement: s of each pair, in r0; 0 for an empty slot.
        change: y of each pair, force before minus force after.
        inverse: 1 / (s · y), 0 for an empty slot.
        oldest: index of the oldest pair.
        scale: length of a displacement per force, in r0/F(0), along new directions.
    """

    displacement: Float[Array, "k d 3"]
    change: Float[Array, "k d 3"]
    inverse: Float[Array, " k"]
    oldest: Int[Array, ""]
    scale: Float[Array, ""]


class LBFGS(eqx.Module):
    """L-BFGS minimiser with `pairs` pairs of memory.

    Attributes:
        pairs: number of displacements in memory.
        first: displacement per force of the first step, in r0/F(0).
    """

    pairs: int = eqx.field(static=True, default=6)
    first: float = 0.1

    def init(self, force: Float[Array, "d 3"]) -> LBFGSMemory:
        """Return an empty memory."""
        empty = jnp.zeros((self.pairs, *force.shape), force.dtype)
        return LBFGSMemory(
            empty,
            empty,
            jnp.zeros(self.pairs, force.dtype),
            jnp.zeros((), int),
            jnp.asarray(self.first, force.dtype),
        )

    def propose(
        self, memory: LBFGSMemory, force: Float[Array, "d 3"]
    ) -> tuple[Float[Array, "d 3"], LBFGSMemory]:
        """Return the displacement by the two-loop recursion.

        It is a descent direction, as all pairs have s · y > 0.
        """
        slots = (memory.oldest + jnp.arange(self.pairs)) % self.pairs

        def backward(
            rest: Float[Array, "d 3"], slot: Int[Array, ""]
        ) -> tuple[Array, Array]:
            s, y = memory.displacement[slot], memory.change[slot]
            weight = memory.inverse[slot] * jnp.sum(s * rest)
            return rest - weight * y, weight

        rest, weights = jax.lax.scan(backward, force, slots, reverse=True)

        def forward(
            step: Float[Array, "d 3"], at: tuple[Array, Array]
        ) -> tuple[Array, None]:
            slot, weight = at
            s, y = memory.displacement[slot], memory.change[slot]
            return step + (weight - memory.inverse[slot] * jnp.sum(y * step)) * s, None

        step, _ = jax.lax.scan(forward, memory.scale * rest, (slots, weights))
        return step, memory

    def learn(
        self,
        memory: LBFGSMemory,
        displacement: Float[Array, "d 3"],
        before: Float[Array, "d 3"],
        after: Float[Array, "d 3"],
        made: Bool[Array, ""],
    ) -> LBFGSMemory:
        """Store a step that was made, if the energy curves upwards along it."""
        change = before - after
        curvature, square = jnp.sum(displacement * change), jnp.sum(change**2)
        size = jnp.sqrt(jnp.sum(displacement**2) * square)
        good = made & (curvature > 1e-8 * size)
        safe, slot = jnp.where(good, curvature, 1), memory.oldest

        def put(store: Array, item: Array) -> Array:
            return store.at[slot].set(jnp.where(good, item, store[slot]))

        return LBFGSMemory(
            put(memory.displacement, displacement),
            put(memory.change, change),
            put(memory.inverse, 1 / safe),
            (slot + good.astype(slot.dtype)) % self.pairs,
            jnp.where(good, safe / jnp.where(good, square, 1), memory.scale),
        )
