"""Free clusters of one capacity, and so of the same programs."""

import warnings

import jax
import jax.numpy as jnp
from scipy.spatial import KDTree

from jaxgrow.energy.parameters import Parameters, UnstableAdhesionWarning
from jaxgrow.growth.grow import grow
from jaxgrow.lesions.myoma import Myoma
from jaxgrow.scene.scene import Scene


CLUSTER = Scene(organ=None, lesion=Myoma(divisions=299))
"""All sizes are grown in arrays of 300, and so with the same programs."""


def arrays(adhesion):
    """Parameters as arrays, which are traced: every adhesion uses one program."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnstableAdhesionWarning)
        return jax.tree.map(jnp.asarray, Parameters(adhesion=adhesion))


def free(divisions=29, seed=0, **more):
    """Grow a cluster of thirty particles, or of others."""
    parameters = arrays(0.2)
    return grow(
        CLUSTER, seed=seed, parameters=parameters, max_divisions=divisions, **more
    )


def nearest(position):
    """Distance of each particle to the nearest other."""
    return KDTree(position).query(position, k=2)[0][:, 1]
