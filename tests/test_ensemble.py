"""Several growths side by side: the same as one after the other."""

import subprocess
import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow import ensemble
from jaxgrow.ensemble import grow_many
from jaxgrow.grow import grow
from jaxgrow.organ import OrganError
from jaxgrow.parameters import Parameters
from jaxgrow.results import Result
from jaxgrow.scene import Myoma, Polyp, Scene


CLUSTER = Scene(organ=None, lesion=Myoma(divisions=6))


def positions(growth):
    return np.asarray(growth.state.particles.position)


@pytest.fixture(scope="module")
def members():
    """Three members in two processes, and those that were told of."""
    told = []
    found = grow_many(
        CLUSTER, seeds=range(3), processes=2, finished=told.append, tolerance=1e-4
    )
    return found, told


def test_members_are_those_of_the_seeds_in_their_order(members):
    found, _ = members
    assert [growth.seed for growth in found] == [0, 1, 2]
    assert all(growth.result is Result.REACHED for growth in found)
    for growth in found:
        alone = grow(CLUSTER, seed=growth.seed, tolerance=1e-4)
        np.testing.assert_allclose(positions(growth), positions(alone), atol=1e-9)
        assert growth.tolerance == 1e-4


def test_every_member_is_told_of_once(members):
    found, told = members
    assert {id(growth) for growth in told} == {id(growth) for growth in found}
    assert len(told) == 3


def test_growth_that_came_from_a_process_can_be_replayed(members):
    growth = members[0][1]
    again = grow(CLUSTER, events=growth.events)
    np.testing.assert_allclose(positions(again), positions(growth), atol=1e-12)


def test_one_process_is_this_one(monkeypatch):
    monkeypatch.setattr(ensemble, "ProcessPoolExecutor", None)
    found = grow_many(CLUSTER, seeds=[4, 5], processes=1)
    np.testing.assert_array_equal(positions(found[1]), positions(grow(CLUSTER, seed=5)))


def test_members_may_have_parameters_of_their_own():
    each = [Parameters(adhesion=a) for a in (0.15, 0.25)]
    found = grow_many(CLUSTER, seeds=[0, 0], parameters=each, processes=1)
    for growth, own in zip(found, each, strict=True):
        assert growth.events.parameters == own
    assert np.abs(positions(found[0]) - positions(found[1])).max() > 1e-3


def test_polyp_survives_the_way_between_processes():
    scene = Scene(lesion=Polyp(divisions=2, particle_mm=1.5))
    found = grow_many(scene, seeds=[0, 1], processes=2)
    assert [growth.events.divisions for growth in found] == [2, 2]
    _, faces, _ = found[0].surface()
    assert len(faces) > 1000


def test_error_of_a_member_is_that_of_a_growth():
    scene = Scene(lesion=Polyp(divisions=2, site="nowhere"))
    with pytest.raises(OrganError, match="nowhere"):
        grow_many(scene, seeds=[0, 1], processes=2)


def test_process_that_is_killed_is_an_error_with_a_sentence():
    code = (
        "import os, signal, jax; jax.config.update('jax_enable_x64', True)\n"
        "from jaxgrow import ensemble, Scene, Myoma\n"
        "def grow(*_, **__): os.kill(os.getpid(), signal.SIGKILL)\n"
        "if __name__ == '__main__':\n"
        "    scene = Scene(organ=None, lesion=Myoma(divisions=1))\n"
        "    ensemble._grow = grow\n"
        "    ensemble.grow_many(scene, seeds=[0, 1], processes=2)\n"
    )
    failed = subprocess.run([sys.executable, "-"], input=code, text=True, **PIPES)
    assert "ended without an answer" in failed.stderr


PIPES = {"capture_output": True, "check": False}


def test_derivative_through_processes_is_refused():
    def size(value):
        varied = replace(Parameters(), adhesion=value)
        return grow_many(CLUSTER, seeds=[0], parameters=varied)[0].size_mm

    with pytest.raises(ValueError, match="derivative does not go through"):
        jax.grad(size)(jnp.asarray(0.2))


@pytest.mark.parametrize(
    "options, error, match",
    [
        ({"parameters": [Parameters()]}, ValueError, "1 parameters for 2 seeds"),
        ({"processes": 0}, ValueError, "must be at least 1"),
        ({"divisions": 3}, TypeError, "takes tolerance"),
    ],
)
def test_wrong_arguments_are_refused(options, error, match):
    with pytest.raises(error, match=match):
        grow_many(CLUSTER, seeds=[0, 1], **options)


def test_no_seeds_no_members():
    assert grow_many(CLUSTER, seeds=[]) == ()
