"""Several growths side by side: the same as one after the other."""

import inspect
import os
import subprocess
import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.parameters import Parameters
from jaxgrow.ensemble import grow_many as ensemble
from jaxgrow.ensemble.grow_many import grow_many
from jaxgrow.growth.grow import grow
from jaxgrow.lesions.myoma import Myoma
from jaxgrow.lesions.polyp import Polyp
from jaxgrow.organ import OrganError
from jaxgrow.runtime.results import Result
from jaxgrow.scene.scene import Scene


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


SETUP = """
import jax; jax.config.update("jax_enable_x64", True)
from jaxgrow.ensemble import grow_many as ensemble
from jaxgrow import Myoma, Scene
scene = Scene(organ=None, lesion=Myoma(divisions=6))
"""


def run(code, *arguments, given=None, **environment):
    """Run a script, a file or what is given to standard input."""
    env = {k: v for k, v in os.environ.items() if k != "TF_CPP_MIN_LOG_LEVEL"}
    return subprocess.run(
        [sys.executable, code, *arguments],
        input=given,
        env={**env, **environment},
        text=True,
        capture_output=True,
        check=False,
        timeout=240,
    )


@pytest.fixture
def script(tmp_path):
    def _script(code):
        path = tmp_path / "script.py"
        path.write_text(SETUP + code, encoding="utf-8")
        return path

    return _script


def test_member_is_bit_for_bit_that_of_a_process_with_one_thread(
    members, script, tmp_path
):
    code = """
import sys
import numpy as np
grown = [ensemble.grow(scene, seed=seed, tolerance=1e-4) for seed in (0, 1)]
np.save(sys.argv[1], [np.asarray(g.state.particles.position) for g in grown])
"""
    done = run(script(code), tmp_path / "alone.npy", NPROC="1")
    assert done.returncode == 0, done.stderr
    # the first one was grown by another process, the second one by this
    for member, alone in zip(
        members[0][:2], np.load(tmp_path / "alone.npy"), strict=True
    ):
        np.testing.assert_array_equal(positions(member), alone)


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


def test_process_that_is_killed_is_an_error_with_a_sentence(script):
    code = """
import multiprocessing, os, signal, time

def grow(scene, seed, parameters, options):
    if multiprocessing.parent_process() is not None:
        os.kill(os.getpid(), signal.SIGKILL)
    for _ in range(600):
        time.sleep(0.1)
        options["progress"](None)

if __name__ == "__main__":
    ensemble._grow = grow
    ensemble.grow_many(scene, seeds=[0, 1], processes=2)
"""
    failed = run(script(code)).stderr
    assert "RuntimeError: a process of grow_many ended without an answer" in failed
    assert "FileNotFoundError" not in failed
    assert "Can't get attribute" not in failed


def test_script_without_a_guard_is_told_to_have_one(script):
    failed = run(script("ensemble.grow_many(scene, seeds=[0, 1], processes=2)"))
    last = failed.stderr.strip().splitlines()[-1]
    assert last.startswith("RuntimeError: no process of grow_many could start")
    assert last.endswith('call grow_many under if __name__ == "__main__": there.')


def test_script_that_is_no_file_is_told_to_be_one():
    code = """
if __name__ == "__main__":
    ensemble.grow_many(scene, seeds=[0, 1], processes=2)
"""
    failed = run("-", given=SETUP + code)
    last = failed.stderr.strip().splitlines()[-1]
    assert last.startswith("RuntimeError: no process of grow_many could start")
    assert last.endswith("<stdin> is no file; write the script to one.")


def test_what_is_raised_ends_all_members_at_once(script):
    code = """
import multiprocessing, os, signal, threading, time
grow_one = ensemble._grow

def grow(scene, seed, parameters, options):
    options = dict(options)
    look = options.pop("progress", lambda _: None)
    for _ in range(3000 if seed > 0 else 0):
        time.sleep(0.1)
        look(None)
    return grow_one(scene, seed, parameters, options) if seed < 0 else seed

def refuse(member):
    raise LookupError(member)

def exists(pid):
    # is_alive would be late: the pool's own thread may have waited for the process
    # and not yet noted its end
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True

def interrupt(member):
    threading.Timer(0.5, os.kill, [os.getpid(), signal.SIGINT]).start()

if __name__ == "__main__":
    # where the tests themselves run in the background, SIGINT is ignored
    signal.signal(signal.SIGINT, signal.default_int_handler)
    ensemble._grow = grow
    for seeds, finished in ([-1, 0, 1, 2], None), ([0, 1], refuse), ([0, 1], interrupt):
        try:
            ensemble.grow_many(scene, seeds=seeds, processes=2, finished=finished)
        except BaseException as error:
            members = multiprocessing.active_children()
            print(type(error).__name__, [m for m in members if exists(m.pid)])
"""
    done = run(script(code))
    told = ["ValueError []", "LookupError []", "KeyboardInterrupt []"]
    assert done.stdout.splitlines() == told, done.stderr
    assert done.stderr == ""


def test_processes_are_configured_as_this_one_and_say_nothing_of_the_cache(script):
    code = """
import multiprocessing, os

def see(*_):
    config = jax.config
    if multiprocessing.parent_process() is None:
        return None
    return (
        config.jax_enable_x64,
        config.jax_platforms,
        config.jax_default_matmul_precision,
        os.environ["TF_CPP_MIN_LOG_LEVEL"],
        os.environ["NPROC"],
    )

if __name__ == "__main__":
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_default_matmul_precision", "highest")
    ensemble._grow = see
    print(set(ensemble.grow_many(scene, seeds=[0, 1], processes=2)) - {None})
"""
    done = run(script(code))
    seen = {(True, "cpu", "highest", "3", "1")}
    assert done.stdout.splitlines() == [str(seen)], done.stderr


def test_derivative_through_processes_is_refused():
    def size(value):
        varied = replace(Parameters(), adhesion=value)
        return grow_many(CLUSTER, seeds=[0], parameters=varied)[0].size_mm

    with pytest.raises(ValueError, match="derivative does not go through"):
        jax.grad(size)(jnp.asarray(0.2))


def test_derivative_in_parameters_of_the_scene_is_refused():
    def size(value):
        varied = CLUSTER.model_copy(
            update={"parameters": replace(Parameters(), adhesion=value)}
        )
        return grow_many(varied, seeds=[0])[0].size_mm

    with pytest.raises(ValueError, match="derivative does not go through"):
        jax.grad(size)(jnp.asarray(0.2))


@pytest.mark.parametrize(
    "options, match",
    [
        ({"seeds": [0, 1.7]}, r"a seed is 1\.7; give a whole number"),
        ({"seeds": [0], "processes": 1.5}, r"processes is 1\.5; give a whole number"),
    ],
)
def test_numbers_that_are_not_whole_are_refused(options, match):
    with pytest.raises(TypeError, match=match):
        inspect.unwrap(grow_many)(CLUSTER, **options)


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
