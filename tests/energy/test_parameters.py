"""Parameters are checked when they are made, and may be traced."""

import warnings

import jax
import jax.numpy as jnp
import pytest

from jaxgrow.energy.a2 import STABLE_ADHESION
from jaxgrow.energy.parameters import Parameters, UnstableAdhesionWarning


@pytest.mark.parametrize(
    "name, value",
    [
        ("adhesion", -0.1),
        ("smoothing", -1e-9),
        ("smoothing", 0.51),
        ("tumour_stiffness", -1.0),
        ("spring_stiffness", -0.3),
        ("pretension", 0.95),
        ("contact_range", 0.0),
        ("contact_stiffness", -1.0),
        ("contact_adhesion", -1.0),
        ("contact_sharpness", 1.0),
        ("barrier_stiffness", -1.0),
        ("barrier_range", 1.0),
        ("daughter_offset", 0.0),
        ("spring_stiffness", float("nan")),
        ("spring_stiffness", float("inf")),
    ],
)
def test_value_out_of_range_is_refused_by_name(name, value):
    with pytest.raises(
        ValueError, match=f"parameter {name} is .*must be a number from"
    ):
        Parameters(**{name: value})


def test_array_out_of_range_is_refused_too():
    with pytest.raises(ValueError, match="parameter smoothing"):
        Parameters(smoothing=jnp.asarray(2.0))


@pytest.mark.parametrize("adhesion", [0.41, 1.0])
def test_adhesion_above_the_stable_one_warns_by_name(adhesion):
    with pytest.warns(UnstableAdhesionWarning, match=f"adhesion {adhesion:g} is above"):
        Parameters(adhesion=adhesion)


@pytest.mark.parametrize("adhesion", [0.0, 0.2, 0.4, STABLE_ADHESION])
def test_adhesion_up_to_the_stable_one_does_not_warn(adhesion):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert Parameters(adhesion=adhesion).adhesion == adhesion


def test_default_is_stable():
    assert 0 < Parameters().adhesion < STABLE_ADHESION


def test_traced_parameters_are_accepted():
    def both(value):
        parameters = Parameters(adhesion=value, spring_stiffness=2 * value)
        return parameters.adhesion * parameters.spring_stiffness

    assert jax.jit(both)(jnp.asarray(0.3)) == pytest.approx(0.18)
    assert jax.grad(both)(jnp.asarray(0.3)) == pytest.approx(1.2)


def test_every_parameter_is_a_leaf():
    assert len(jax.tree.leaves(Parameters())) == len(Parameters.__dataclass_fields__)
