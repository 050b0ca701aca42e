"""Compiled programs are counted."""

import gc
import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.parameters import Parameters
from jaxgrow.growth.grow import grow
from jaxgrow.lesions.myoma import Myoma
from jaxgrow.runtime import compilations
from jaxgrow.runtime.compilations import count_compilations, forget_compiled
from jaxgrow.scene.scene import Scene


CLUSTER = Scene(organ=None, lesion=Myoma(divisions=3))


def test_first_call_compiles_once_and_the_second_does_not():
    program = jax.jit(lambda x: 3 * x - 1)
    x = jnp.arange(5.0)
    with count_compilations() as first:
        program(x)
    with count_compilations() as second:
        program(x)
    assert first.count == 1
    assert second.count == 0


def test_new_shape_compiles_again():
    program = jax.jit(lambda x: 5 * x + 1)
    arrays = [jnp.zeros(n) for n in (3, 4)]
    with count_compilations() as seen:
        for array in arrays:
            program(array)
    assert seen.count == 2


def test_nothing_is_counted_after_the_block():
    x = jnp.arange(7.0)
    with count_compilations() as seen:
        pass
    jax.jit(lambda x: x * 7)(x)
    assert seen.count == 0


def mapped_by(program):
    """How many regions are mapped more after a program has been compiled and run."""
    maps = Path("/proc/self/maps")
    before = maps.read_text().count("\n")
    program(jnp.arange(9.0))
    return maps.read_text().count("\n") - before


@pytest.mark.skipif(sys.platform != "linux", reason="there is no such limit")
def test_programs_are_forgotten_when_they_map_too_much(monkeypatch, tmp_path):
    program = jax.jit(lambda x: jnp.sort(x)[::-1] * 11)
    assert mapped_by(program) > 0
    assert mapped_by(program) == 0
    limit = tmp_path / "max_map_count"
    monkeypatch.setattr(compilations, "_MOST_MAPPED", limit)
    monkeypatch.setattr(compilations, "_left", 0)
    limit.write_text("100000000\n")
    assert not forget_compiled()
    limit.write_text("10\n")
    assert forget_compiled()
    assert mapped_by(program) > 0


def test_what_forgetting_does_not_free_is_no_reason_to_repeat_it(monkeypatch, tmp_path):
    maps, limit = tmp_path / "maps", tmp_path / "max_map_count"
    limit.write_text("100\n")
    monkeypatch.setattr(compilations, "_MAPPED", maps)
    monkeypatch.setattr(compilations, "_MOST_MAPPED", limit)
    monkeypatch.setattr(compilations, "_left", 0)
    monkeypatch.setattr(jax, "clear_caches", lambda: None)
    for mapped, forgets in (
        (50, False),
        (60, True),
        (60, False),
        (80, False),  # 60 and half of what they leave
        (81, True),
        (20, False),
        (60, False),  # 20 and half of what they leave
        (61, True),
    ):
        maps.write_text(mapped * "region\n")
        assert forget_compiled() is forgets


def test_nothing_is_forgotten_where_no_limit_is_known(monkeypatch, tmp_path):
    monkeypatch.setattr(compilations, "_MOST_MAPPED", tmp_path / "none")
    assert not forget_compiled(0.0)


def test_growth_and_replay_look_before_they_begin(monkeypatch):
    asked = []
    monkeypatch.setattr(compilations, "forget_compiled", lambda: asked.append(1))
    growth = grow(CLUSTER)
    assert asked == [1]
    grow(CLUSTER, events=growth.events)
    assert asked == [1, 1]


def test_what_is_forgotten_on_the_way_changes_nothing(monkeypatch):
    def height(adhesion):
        varied = replace(parameters, adhesion=adhesion)
        state = grow(CLUSTER, parameters=varied, events=growth.events).state
        return jnp.max(state.particles.position[:4])

    parameters = Parameters()
    growth = grow(CLUSTER, tolerance=1e-10)
    known = jax.value_and_grad(height)(jnp.asarray(0.2))
    monkeypatch.setattr(compilations, "_OFTEN", 1)
    monkeypatch.setattr(
        compilations, "forget_compiled", lambda: (jax.clear_caches(), gc.collect())
    )
    np.testing.assert_array_equal(jax.value_and_grad(height)(jnp.asarray(0.2)), known)
    again = grow(CLUSTER, tolerance=1e-10)
    positions = (g.state.particles.position for g in (growth, again))
    np.testing.assert_array_equal(*positions)
