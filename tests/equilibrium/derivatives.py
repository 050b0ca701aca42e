"""Derivatives of equilibria, as users take them: of all that `relax` returns."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.relax import relax
from jaxgrow.runtime.results import Result


def changed(**values):
    """The default parameters but for these, as arrays."""
    return jax.tree.map(lambda v: jnp.asarray(v, float), Parameters(**values))


PARAMETERS = changed()


def rest(problem, **options):
    """Where the nodes of a problem come to rest."""
    outcome = relax(
        problem.particles,
        problem.membrane,
        parameters=problem.parameters,
        load=problem.load,
        **options,
    )
    return Problem(*outcome.state, problem.parameters).nodes()


def settled(particles, membrane=None, parameters=PARAMETERS, load=None):
    """A problem at its equilibrium."""
    outcome = relax(
        particles, membrane, parameters=parameters, tolerance=1e-12, load=load
    )
    assert outcome.result is Result.CONVERGED
    return Problem(*outcome.state, parameters, load)


def flat(nodes):
    return np.asarray(ravel_pytree(nodes)[0])


def still(problem):
    """A tangent of the problem: no change of any of its floats."""
    return jax.tree.map(jnp.zeros_like, eqx.filter(problem, eqx.is_inexact_array))


def stepped(problem, tangent, step):
    floats, others = eqx.partition(problem, eqx.is_inexact_array)
    return eqx.combine(jax.tree.map(lambda a, t: a + step * t, floats, tangent), others)


def forward(problem, tangent):
    """The derivative of the equilibrium along a tangent."""
    return flat(eqx.filter_jvp(rest, (problem,), (tangent,))[1])


def backward(problem, weight):
    """The derivative of <weight, equilibrium> in all floats of the problem."""

    def weighted(problem):
        products = jax.tree.map(lambda w, x: jnp.sum(w * x), weight, rest(problem))
        return sum(jax.tree.leaves(products))

    return eqx.filter_grad(weighted)(problem)
