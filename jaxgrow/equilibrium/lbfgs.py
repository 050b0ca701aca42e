"""Limited-memory BFGS on forces alone (Nocedal and Wright 2006, algorithm 7.4).

No line search and no energy: near an equilibrium energies differ by less than their
rounding while forces are still exact, so a search on the energy stalls early.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class LBFGSMemory(eqx.Module):
    """The last displacements and force changes, oldest first.

    Attributes:
        displacement: s of each pair, in r0; 0 for an empty slot.
        change: y of each pair, force before minus force after.
        inverse: 1 / (s · y), 0 for an empty slot.
        scale: length of a displacement per force, in r0/F(0), along new directions.
    """

    displacement: Float[Array, "k d 3"]
    change: Float[Array, "k d 3"]
    inverse: Float[Array, " k"]
    scale: Float[Array, ""]


class LBFGS(eqx.Module):
    """Minimiser with `pairs` pairs of memory.

    Attributes:
        pairs: how many displacements are remembered.
        first: displacement per force of the first step, in r0/F(0).
    """

    pairs: int = eqx.field(static=True, default=6)
    first: float = 0.1

    def init(self, force: Float[Array, "d 3"]) -> LBFGSMemory:
        """An empty memory."""
        empty = jnp.zeros((self.pairs, *force.shape), force.dtype)
        return LBFGSMemory(
            empty,
            empty,
            jnp.zeros(self.pairs, force.dtype),
            jnp.asarray(self.first, force.dtype),
        )

    def propose(
        self, memory: LBFGSMemory, force: Float[Array, "d 3"]
    ) -> tuple[Float[Array, "d 3"], LBFGSMemory]:
        """Displacement by the two-loop recursion; downhill for pairs with s · y > 0."""

        def backward(
            rest: Float[Array, "d 3"], pair: tuple[Array, Array, Array]
        ) -> tuple[Array, Array]:
            s, y, inverse = pair
            weight = inverse * jnp.sum(s * rest)
            return rest - weight * y, weight

        pairs = (memory.displacement, memory.change, memory.inverse)
        rest, weights = jax.lax.scan(backward, force, pairs, reverse=True)

        def forward(
            step: Float[Array, "d 3"], pair: tuple[Array, Array, Array, Array]
        ) -> tuple[Array, None]:
            s, y, inverse, weight = pair
            return step + (weight - inverse * jnp.sum(y * step)) * s, None

        step, _ = jax.lax.scan(forward, memory.scale * rest, (*pairs, weights))
        return step, memory

    def learn(
        self,
        memory: LBFGSMemory,
        displacement: Float[Array, "d 3"],
        before: Float[Array, "d 3"],
        after: Float[Array, "d 3"],
    ) -> LBFGSMemory:
        """Remember a step that was made, if the energy curves upwards along it."""
        change = before - after
        curvature = jnp.sum(displacement * change)
        size = jnp.sqrt(jnp.sum(displacement**2) * jnp.sum(change**2))
        good = curvature > 1e-8 * size
        safe = jnp.where(good, curvature, 1)

        def push(store: Array, item: Array) -> Array:
            return jnp.where(good, jnp.concatenate([store[1:], item[None]]), store)

        return LBFGSMemory(
            push(memory.displacement, displacement),
            push(memory.change, change),
            push(memory.inverse, 1 / safe),
            jnp.where(
                good,
                safe / jnp.where(good, jnp.sum(change**2), 1),
                memory.scale,
            ),
        )
