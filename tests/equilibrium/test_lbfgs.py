"""The memory of L-BFGS against the two-loop recursion over a plain list of pairs."""

import jax.numpy as jnp
import numpy as np

from jaxgrow.equilibrium.lbfgs import LBFGS


def two_loops(pairs, force, scale):
    """Nocedal and Wright 2006, algorithm 7.4."""
    rest, weights = force.copy(), []
    for s, y in reversed(pairs):
        weights.append(np.sum(s * rest) / np.sum(s * y))
        rest -= weights[-1] * y
    step = scale * rest
    for (s, y), weight in zip(pairs, reversed(weights), strict=True):
        step += (weight - np.sum(y * step) / np.sum(s * y)) * s
    return step


def test_the_newest_pairs_that_curve_upwards_count():
    rng = np.random.default_rng(0)
    stiffness = rng.uniform(1, 5, (4, 3))
    minimiser = LBFGS(pairs=3)
    force = rng.normal(size=(4, 3))
    memory, pairs, scale = minimiser.init(jnp.asarray(force)), [], minimiser.first
    kinds = ["made"] * 2 + ["refused", "made", "downwards"] + ["made"] * 5 + ["refused"]
    for kind in kinds:
        moved = rng.normal(size=(4, 3))
        change = stiffness * moved * (-1 if kind == "downwards" else 1)
        after = force - change
        memory = minimiser.learn(
            memory,
            jnp.asarray(moved),
            jnp.asarray(force),
            jnp.asarray(after),
            jnp.asarray(kind != "refused"),
        )
        if kind == "made":
            pairs = [*pairs, (moved, change)][-3:]
            scale = np.sum(moved * change) / np.sum(change**2)
        force = rng.normal(size=(4, 3))
        step, memory = minimiser.propose(memory, jnp.asarray(force))
        np.testing.assert_allclose(step, two_loops(pairs, force, scale), rtol=1e-12)
