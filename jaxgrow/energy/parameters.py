"""Parameters of growth: a pytree of floats, with units and ranges."""

import dataclasses
import math
import warnings
from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType

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
    "area_modulus": (0.0, math.inf),
    "surface_tension": (0.0, math.inf),
    "healthy_stiffness": (0.0, math.inf),
    "membrane_modulus": (0.0, math.inf),
    "kirchhoff_modulus": (0.0, math.inf),
    "flowing_modulus": (0.0, math.inf),
    "membrane_poisson": (0.0, 0.49),
    "focus_radius": (0.0, math.inf),
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
        area_modulus: μ of the triangles' resistance to a change of area, in F(0)/r0
            (see `jaxgrow.energy.area`).
        surface_tension: σ of the membrane, in F(0)/r0, an energy of its area; 0 leaves
            the tension to `pretension` (see `jaxgrow.energy.tension`).
        healthy_stiffness: k_h of healthy endometrium, in F(0)/r0, which is elastic
            about its shape before growth (see `jaxgrow.energy.healthy`).
        membrane_modulus: Young's modulus times thickness of healthy endometrium as a
            neo-Hookean sheet, in F(0)/r0; 0 leaves it to `healthy_stiffness` (see
            `jaxgrow.energy.finite_elements`).
        kirchhoff_modulus: the same, of a Saint Venant-Kirchhoff sheet.
        flowing_modulus: the same, of a neo-Hookean sheet of all endometrium that is
            reset after every division.
        membrane_poisson: Poisson's ratio of these sheets, dimensionless.
        focus_radius: R_f of a polyp's patch of hyperplastic endometrium (see
            `jaxgrow.lesions.focus`); 0 is the paper's rule: one vertex emits all
            particles, and all springs are reset.
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
    area_modulus: Scalar = 0.0
    surface_tension: Scalar = 0.0
    healthy_stiffness: Scalar = 0.0
    membrane_modulus: Scalar = 0.0
    kirchhoff_modulus: Scalar = 0.0
    flowing_modulus: Scalar = 0.0
    membrane_poisson: Scalar = 0.33
    focus_radius: Scalar = 0.0
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


PRINTED: Mapping[str, float] = MappingProxyType(
    {
        "adhesion": 1.0,
        "smoothing": 0.0,
        "tumour_stiffness": 1.0,
        "mixed_adhesion": 1.0,
        "pretension": 0.0,
        "bending_stiffness": 0.0,
        "area_modulus": 0.0,
        "surface_tension": 0.0,
        "healthy_stiffness": 0.0,
        "focus_radius": 0.0,
        "contact_adhesion": 1.0,
    }
)
"""Parameters of the laws as the paper prints them, without any term of ours; "printed"
in a scene. Clusters collapse under them in three dimensions (see `jaxgrow.A2`)."""

_POWERS = {
    "spring_stiffness": 1,
    "area_modulus": 1,
    "surface_tension": 1,
    "healthy_stiffness": 1,
    "membrane_modulus": 1,
    "kirchhoff_modulus": 1,
    "flowing_modulus": 1,
    "bending_stiffness": 3,
    "focus_radius": 1,
}
"""Power of the unit of length, at a given pressure, in the parameters that are those of
a continuum; the others belong to the particles."""


def at_resolution(parameters: Parameters, refinement: float) -> Parameters:
    r"""Convert parameters to another size of particles, of the same material.

    The pressure :math:`p_0 = F(0)/r_0^2` is the material's. Surface tensions and spring
    stiffnesses are in units of :math:`p_0 r_0`, bending moduli in :math:`p_0 r_0^3`.

    Args:
        parameters: in units of the former r0.
        refinement: former r0 over the new one.
    """
    if refinement == 1:
        return parameters
    scaled = {
        name: getattr(parameters, name) * refinement**power
        for name, power in _POWERS.items()
    }
    return dataclasses.replace(parameters, **scaled)


def as_arrays(parameters: Parameters, dtype: DTypeLike) -> Parameters:
    """Convert all values to arrays; numbers would be compiled as constants."""
    values = jax.tree.leaves(parameters)
    if all(isinstance(v, jax.Array) and v.dtype == dtype for v in values):
        return parameters
    return jax.tree.map(lambda value: jnp.asarray(value, dtype), parameters)
