"""A scene pays only for what it has: what is traced for each kind."""

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.descent import descend
from jaxgrow.equilibrium.lbfgs import LBFGS
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists


def equations(jaxpr):
    """All equations of a jaxpr and of those inside it."""
    for equation in jaxpr.eqns:
        yield equation
        for value in equation.params.values():
            for inner in jax.tree.leaves(
                value, is_leaf=lambda v: hasattr(v, "eqns") or hasattr(v, "jaxpr")
            ):
                inner = getattr(inner, "jaxpr", inner)
                if hasattr(inner, "eqns"):
                    yield from equations(inner)


@pytest.fixture(scope="module")
def traced(cluster, bed):
    """Equations of the descent of particles alone, a membrane alone, and both."""
    found = {}
    scenes = {"free": (cluster, None), "membrane": (None, bed[1]), "both": bed}
    for name, scene in scenes.items():
        problem = Problem(*scene, Parameters())
        lists = allocate_lists(problem)
        # JAX keeps what it traced of its own functions with the lines that called
        # them first, whoever calls them later
        jax.clear_caches()
        jaxpr = eqx.filter_make_jaxpr(descend)(
            problem,
            lists,
            LBFGS(),
            jnp.asarray(1e-3),
            jnp.asarray(10),
            jnp.asarray(0.1),
        )[0]
        found[name] = list(equations(jaxpr.jaxpr))
    return found


def sizes(all_equations):
    """Every extent of every array."""
    return {
        extent
        for equation in all_equations
        for variable in (*equation.invars, *equation.outvars)
        for extent in getattr(variable.aval, "shape", ())
    }


def sources(all_equations):
    """Modules of the package whose lines the equations come from."""
    return {
        frame.file_name.split("jaxgrow/")[-1]
        for equation in all_equations
        for frame in equation.source_info.traceback.frames
        if "/jaxgrow/" in frame.file_name
    }


OF_A_MEMBRANE = {256, 512, 768, 1024, 4096}
"""Capacities of its vertices, faces, edges and contacts; particles have 64."""


def test_nothing_of_the_size_of_a_membrane_is_traced_for_a_free_cluster(traced):
    assert sizes(traced["both"]) >= OF_A_MEMBRANE
    assert not sizes(traced["free"]) & OF_A_MEMBRANE


def test_no_line_of_springs_or_contact_is_traced_for_a_free_cluster(traced):
    of_membrane = {"energy/contact.py", "energy/springs.py", "energy/distance.py"}
    assert sources(traced["both"]) >= of_membrane | {"energy/pair.py"}
    assert not sources(traced["free"]) & of_membrane
    assert "energy/pair.py" in sources(traced["free"])


def test_no_line_of_particles_is_traced_for_a_membrane_alone(traced):
    of_particles = {"energy/pair.py", "energy/contact.py", "neighbors.py"}
    assert "energy/springs.py" in sources(traced["membrane"])
    assert not sources(traced["membrane"]) & of_particles


def test_free_cluster_has_fewer_equations(traced):
    count = {name: len(found) for name, found in traced.items()}
    assert count["free"] + 300 < count["both"]
    assert count["membrane"] + 300 < count["both"]
