"""Relaxation methods of one's own, by name."""

import equinox as eqx
import numpy as np
import pytest

import jaxgrow as jg
from jaxgrow.equilibrium.gauss_seidel import sweep
from jaxgrow.equilibrium.relaxers import Program, register_relaxer


class Downhill(eqx.Module):
    """Steepest descent."""

    rate: float = 0.05

    def init(self, force):
        return None

    def propose(self, memory, force):
        return self.rate * force, memory

    def learn(self, memory, displacement, before, after, made):
        return memory


@pytest.fixture(scope="module")
def cloud():
    rng = np.random.default_rng(4)
    return jg.make_particles(rng.normal(size=(12, 3)), species=[1] * 12)


def position(outcome):
    return np.asarray(outcome.state[0].position)


def test_registered_method_relaxes_to_the_equilibrium_of_the_others(registries, cloud):
    register_relaxer("downhill", Downhill())
    found = jg.relax(cloud, method="downhill", tolerance=1e-3)
    assert found.result is jg.Result.CONVERGED
    assert found.stats.method == "downhill"
    assert found.stats.steps > 0
    again = jg.relax(found.state[0], tolerance=1e-3)
    assert again.stats.steps == 0
    assert again.stats.residual == pytest.approx(found.stats.residual, rel=1e-9)


def test_method_may_depend_on_the_parameters(registries, cloud):
    seen = []

    def careful(parameters):
        seen.append(float(parameters.tumour_stiffness))
        return Downhill(0.08 / seen[-1])

    register_relaxer("careful", careful)
    stiff = jg.Parameters(tumour_stiffness=4.0)
    assert jg.relax(cloud, method="careful", parameters=stiff).result.success
    assert seen == [4.0]


def test_whole_program_is_a_method(registries, cloud):
    register_relaxer("sweeps", Program(sweep))
    found = jg.relax(cloud, method="sweeps")
    assert found.result is jg.Result.CONVERGED
    serial = jg.relax(cloud, method="serial")
    assert position(found).tobytes() == position(serial).tobytes()


def test_registered_method_is_observed_step_by_step(registries, cloud):
    register_relaxer("downhill", Downhill())
    seen = []
    found = jg.relax(cloud, method="downhill", max_steps=7, observe=seen.append)
    assert len(seen) == found.stats.steps == 7


def test_unknown_method_is_refused_with_those_that_are_registered(registries, cloud):
    register_relaxer("downhill", Downhill())
    with pytest.raises(ValueError, match=r"'downhil'; it must be .*'downhill'"):
        jg.relax(cloud, method="downhil")


@pytest.mark.parametrize("name", ["auto", "lbfgs", "staggered"])
def test_method_of_the_package_is_not_replaced(name):
    with pytest.raises(ValueError, match="is jaxgrow's; choose another name"):
        register_relaxer(name, Downhill())


@pytest.mark.parametrize("given", [3, Downhill])
def test_object_without_the_functions_is_no_method(unchecked, given):
    with pytest.raises(TypeError, match="init, propose and learn"):
        unchecked(register_relaxer)("other", given)
