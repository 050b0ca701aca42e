"""Parameters of growth: a pytree of floats, with units and ranges."""

import math
import warnings
from dataclasses import fields

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jax.typing import DTypeLike

from jaxgrow.energy.a2 import STABLE_ADHESION
from jaxgrow.runtime.types import Scalar


class UnstableAdhesionWarning(UserWarning):
    """Warning of adhesion above 149/371: in 3-D the cluster collapses."""


_RANGES = {
    "adhesion": (0.0, math.inf),
    "smoothing": (0.0, 0.5),
    "tumour_stiffness": (0.0, math.inf),
    "mixed_adhesion": (0.0, math.inf),
    "spring_stiffness": (0.0, math.inf),
    "pretension": (0.0, 0.9),
    "bending_stiffness": (0.0, math.inf),
    "contact_range": (0.1, 2.0),
    "contact_stiffness": (0.0, math.inf),
    "contact_adhesion": (0.0, math.inf),
    "contact_sharpness": (4.0, 1000.0),
    "barrier_stiffness": (0.0, math.inf),
    "barrier_range": (0.01, 0.9),
    "collision_range": (0.05, 2.0),
    "collision_stiffness": (0.0, math.inf),
    "daughter_offset": (1e-9, 0.5),
}


class Parameters(eqx.Module):
    """Parameters of the mechanics; every leaf may be differentiated.

    Lengths are in r0, the equilibrium distance of two particles; forces in F(0),
    the repulsion of two particles at one point; energies in F(0) r0.

    Attributes:
        adhesion: factor of the attraction between particles, dimensionless. The printed
            law has 1; above 149/371 a cluster collapses (see `jaxgrow.A2`).
        smoothing: width, in r0, over which the two jumps of the A2 force are smoothed;
            0 is the printed law.
        tumour_stiffness: factor s of the pair energy between two tumour particles;
            all other pairs have 1. A stiff myoma core has s > 1.
        mixed_adhesion: factor c of the attraction between a tumour particle and one of
            the tissue; 1 is the printed law, less separates the two.
        spring_stiffness: k of every membrane edge, in F(0)/r0.
        pretension: share τ by which a spring's rest length falls short of its length
            when it is reset; 0 is the paper's reset (see `jaxgrow.energy.springs`).
        bending_stiffness: modulus κ of the membrane's bending, in F(0) r0; 0 is the
            paper's membrane (see `jaxgrow.energy.bending`).
        contact_range: distance r_s, in r0, at which a particle rests from the membrane.
        contact_stiffness: factor of the contact force between particle and membrane.
        contact_adhesion: factor of the attractive branch of that force.
        contact_sharpness: exponent p of the smooth minimum over triangles; the exact
            distance is its limit (see `jaxgrow.energy.contact`).
        barrier_stiffness: factor of the logarithmic barriers at the membrane.
        barrier_range: distance, in contact or collision ranges, below which it acts.
        collision_range: distance r_c, in r0, from which on two sheets of the surface do
            not repel each other (see `jaxgrow.energy.collision`).
        collision_stiffness: factor of that repulsion.
        daughter_offset: distance δ, in r0, at which a polyp's new particle is put under
            its source vertex.

    Raises:
        ValueError: a value is not a finite number of its range.
    """

    adhesion: Scalar = 0.2
    smoothing: Scalar = 0.1
    tumour_stiffness: Scalar = 1.0
    mixed_adhesion: Scalar = 1.0
    spring_stiffness: Scalar = 0.04
    pretension: Scalar = 0.2
    bending_stiffness: Scalar = 0.005
    contact_range: Scalar = 0.7
    contact_stiffness: Scalar = 1.0
    contact_adhesion: Scalar = 0.3
    contact_sharpness: Scalar = 20.0
    barrier_stiffness: Scalar = 10.0
    barrier_range: Scalar = 0.3
    collision_range: Scalar = 0.5
    collision_stiffness: Scalar = 1.0
    daughter_offset: Scalar = 0.1

    def __check_init__(self) -> None:
        """Check the values that are known now; traced ones cannot be."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Tracer):
                continue
            low, high = _RANGES[field.name]
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError(
                    f"parameter {field.name} is {value}; "
                    f"it must be a number from {low:g} to {high:g}."
                )
        adhesion = self.adhesion
        if not isinstance(adhesion, Tracer) and adhesion > STABLE_ADHESION:
            warnings.warn(
                f"adhesion {float(adhesion):g} is above 149/371 = "
                f"{STABLE_ADHESION:.4f}: in three dimensions the attraction of many "
                "particles outweighs their repulsion, so a cluster that is relaxed "
                "after every division collapses; use 0.2, or less than 0.4.",
                UnstableAdhesionWarning,
                stacklevel=3,
            )


def as_arrays(parameters: Parameters, dtype: DTypeLike) -> Parameters:
    """Convert all values to arrays; numbers would be compiled as constants."""
    values = jax.tree.leaves(parameters)
    if all(isinstance(v, jax.Array) and v.dtype == dtype for v in values):
        return parameters
    return jax.tree.map(lambda value: jnp.asarray(value, dtype), parameters)
