"""FIRE, the fast inertial relaxation engine (Bitzek et al. 2006).

PRL 97, 170201. It is slower than L-BFGS on smooth energies, but needs no smoothness:
the fall-back where pairs sit on a jump of the force.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.runtime.types import Scalar


class FIREMemory(eqx.Module):
    """Velocity, time step, mixing factor, and steps since uphill motion."""

    velocity: Float[Array, "d 3"]
    step: Float[Array, ""]
    mixing: Float[Array, ""]
    downhill: Int[Array, ""]


class FIRE(eqx.Module):
    """FIRE minimiser with the published constants and unit mass.

    Attributes:
        first: first time step.
        largest: largest time step. Above 2 / √λ, with λ the largest eigenvalue of the
            Hessian, the integration is unstable; λ is about 18 for A2 at its default
            adhesion, and s times that for pairs of stiffness s.
    """

    first: float = 0.15
    largest: Scalar = 0.4

    def init(self, force: Float[Array, "d 3"]) -> FIREMemory:
        """Return the memory at rest."""
        return FIREMemory(
            jnp.zeros_like(force),
            jnp.asarray(self.first, force.dtype),
            jnp.asarray(0.1, force.dtype),
            jnp.zeros((), int),
        )

    def propose(
        self, memory: FIREMemory, force: Float[Array, "d 3"]
    ) -> tuple[Float[Array, "d 3"], FIREMemory]:
        """Return the displacement of one semi-implicit Euler step, mixed velocity."""
        power = jnp.sum(force * memory.velocity)
        uphill = power <= 0
        patient = ~uphill & (memory.downhill > 5)
        step = jnp.where(
            patient,
            jnp.minimum(
                memory.step * 1.1, jnp.asarray(self.largest, memory.step.dtype)
            ),
            jnp.where(uphill, memory.step * 0.5, memory.step),
        )
        step = jnp.maximum(step, 1e-3)
        mixing = jnp.where(
            uphill, 0.1, jnp.where(patient, memory.mixing * 0.99, memory.mixing)
        )
        velocity = jnp.where(uphill, 0, memory.velocity) + step * force
        strength = jnp.sqrt(jnp.sum(force**2))
        speed = jnp.sqrt(jnp.sum(velocity**2))
        along = force * (speed / jnp.where(strength > 0, strength, 1))
        velocity = (1 - mixing) * velocity + mixing * along
        downhill = jnp.where(uphill, 0, memory.downhill + 1)
        return step * velocity, FIREMemory(velocity, step, mixing, downhill)

    def learn(
        self,
        memory: FIREMemory,
        displacement: Float[Array, "d 3"],
        before: Float[Array, "d 3"],
        after: Float[Array, "d 3"],
        made: Bool[Array, ""],
    ) -> FIREMemory:
        """Set the velocity from the step made, which a bound may have cut."""
        del before, after
        velocity = jnp.where(made, displacement / memory.step, memory.velocity)
        return eqx.tree_at(lambda m: m.velocity, memory, velocity)
