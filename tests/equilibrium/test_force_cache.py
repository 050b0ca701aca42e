"""Kept forces are those that an evaluation on all particles gives, to rounding."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrow as jg
from jaxgrow.energy.pair import pair_force
from jaxgrow.equilibrium import force_cache as module
from jaxgrow.equilibrium.force_cache import evaluated, renewed
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.neighbors import verlet_list as nb
from jaxgrow.state import Species
from jaxgrow.transfer.device import put_particles


COUNT, SLOTS = 900, 960

ROUNDING = 640 * np.finfo(float).eps
"""64 roundings of a sum of forces, of which many are near 10 here."""


@pytest.fixture(scope="module")
def parameters():
    """Tumour is stiffer, so that species matter."""
    given = jg.Parameters(tumour_stiffness=2.0)
    return Problem.of(crowd(), None, given).parameters


def crowd():
    """A dense box, some of it tumour, with padding."""
    rng = np.random.default_rng(0)
    position = rng.uniform(-4.5, 4.5, (COUNT, 3)) + np.array([100.0, 0, 0])
    species = (rng.uniform(size=COUNT) < 0.5).astype(int)
    return put_particles(position, species, np.zeros(COUNT, bool), SLOTS)


def on_all(particles, parameters):
    listed = nb.allocate(particles.position).listed
    return np.asarray(pair_force(particles, listed, parameters))


def keep(particles, parameters):
    return evaluated(particles, nb.allocate(particles.position), parameters)


def changed(particles, **rows):
    for name, (index, value) in rows.items():
        old = getattr(particles, name)
        new = old.at[jnp.asarray(index)].set(jnp.asarray(value, old.dtype))
        particles = eqx.tree_at(lambda p, n=name: getattr(p, n), particles, new)
    return particles


def moved(rng, particles):
    index = rng.choice(COUNT, 40, replace=False)
    place = np.asarray(particles.position)[index]
    return {"position": (index, place + 0.3 * rng.normal(size=place.shape))}


CHANGES = {
    "some that moved": moved(np.random.default_rng(1), crowd()),
    "one that went far away": {"position": (7, [300.0, -20, 1e6])},
    "one in the lumen": {"position": (7, [94.0, 0, 0])},
    "a new one": {
        "position": (COUNT, [100.0, 0.1, 0.2]),
        "alive": (COUNT, True),
        "species": (COUNT, int(Species.TUMOUR)),
    },
    "one that died": {"alive": (3, False)},
    "another species": {"species": (np.arange(9), 1)},
    "two at one point": {"position": (5, np.asarray(crowd().position)[6])},
}


@pytest.mark.parametrize("name", CHANGES)
def test_renewed_forces_are_those_on_all(name, parameters):
    particles = crowd()
    before = keep(particles, parameters)
    now = changed(particles, **CHANGES[name])
    again = renewed(before, now, parameters)
    wanted = on_all(now, parameters)
    assert np.any(wanted != np.asarray(before.force))
    np.testing.assert_allclose(again.force, wanted, rtol=0, atol=ROUNDING)
    # those that nothing near happened to are not touched
    same = np.all(np.asarray(again.force) == np.asarray(before.force), axis=1)
    assert same.sum() > COUNT / 8


def test_forces_stay_right_through_many_changes(parameters):
    particles, rng = crowd(), np.random.default_rng(2)
    known = keep(particles, parameters)
    for _ in range(25):
        particles = changed(particles, **moved(rng, particles))
        known = renewed(known, particles, parameters)
    wanted = on_all(particles, parameters)
    np.testing.assert_allclose(known.force, wanted, rtol=0, atol=ROUNDING)


def test_a_place_that_is_none_has_a_force_that_is_none(parameters):
    particles = crowd()
    now = changed(particles, position=(4, [np.nan, 0, 0]))
    force = np.asarray(renewed(keep(particles, parameters), now, parameters).force)
    assert np.isnan(force[4]).all()
    assert np.isfinite(np.delete(force, 4, axis=0)).all()


def test_what_is_the_same_is_not_evaluated_again(parameters):
    particles = crowd()
    before = keep(particles, parameters)
    assert renewed(before, crowd(), parameters) is before


def test_forces_of_another_law_or_of_another_crowd_are_not_used(parameters):
    particles = crowd()
    before = keep(particles, parameters)
    assert renewed(None, particles, parameters) is None
    for name in ("adhesion", "smoothing", "tumour_stiffness"):
        other = eqx.tree_at(
            lambda p, n=name: getattr(p, n), parameters, jnp.asarray(0.15)
        )
        assert renewed(before, particles, other) is None
    many = changed(particles, position=(np.arange(300), particles.position[:300] + 1))
    assert renewed(before, many, parameters) is None
    room = put_particles(np.zeros((1, 3)), np.zeros(1, int), np.zeros(1, bool), 64)
    assert renewed(before, room, parameters) is None


def test_without_loops_all_forces_are_evaluated(parameters, monkeypatch):
    particles = crowd()
    before = keep(particles, parameters)
    monkeypatch.setattr(module, "pair_module", lambda: None)
    assert renewed(before, particles, parameters) is None
