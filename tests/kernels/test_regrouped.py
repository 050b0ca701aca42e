"""Loops whose bits would depend on who calls them become a part of their callers."""

import inspect
import pkgutil
from importlib import import_module

import pytest
from numba.core.registry import CPUDispatcher

import jaxgrow.kernels


# What is compiled before the cache is cleared of other sources is deleted by that.
jaxgrow.kernels.wanted()

LOOPS = {
    loop
    for module in pkgutil.iter_modules(jaxgrow.kernels.__path__, "jaxgrow.kernels.")
    for loop in vars(import_module(module.name)).values()
    if isinstance(loop, CPUDispatcher)
}


def test_what_may_be_regrouped_is_never_called():
    regrouped = [loop for loop in LOOPS if loop.targetoptions.get("fastmath")]
    assert len(regrouped) > 10
    for loop in regrouped:
        assert loop.targetoptions.get("forceinline"), loop


def reached(loop):
    """The loops that one calls, and those that they call."""
    names, known = loop.py_func.__code__.co_names, vars(inspect.getmodule(loop.py_func))
    found = [known.get(name) for name in names]
    for module in filter(inspect.ismodule, found.copy()):
        found += [getattr(module, name, None) for name in names]
    called = {one for one in found if isinstance(one, CPUDispatcher)} - {loop}
    return called.union(*map(reached, called))


@pytest.mark.parametrize("name", ["encounters.pairs_of_edges", "nearest.find"])
def test_what_the_host_measures_is_not_regrouped(name):
    module, loop = name.split(".")
    loop = getattr(import_module(f"jaxgrow.kernels.{module}"), loop)
    asked = reached(loop)
    assert len(asked) > 2
    assert not [one for one in {loop, *asked} if one.targetoptions.get("fastmath")]
