"""The border of a patch: what it feels, and where."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.border import AGAINST, Border, feeling, FELT
from jaxgrow.state import Species
from jaxgrow.transfer import put_particles


PLACES = np.array([[5.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, -3.0]])


def border(force=None):
    force = np.zeros((3, 3)) if force is None else np.asarray(force)
    return Border(np.array([7, 9, -1]), PLACES, force)


def tumour_at(*points):
    points = np.reshape(np.asarray(points, float), (-1, 3))
    tissue = np.array([[0.0, 5.1, 0.0]])
    species = np.array([int(Species.TUMOUR)] * len(points) + [int(Species.TISSUE)])
    position = np.concatenate([points, tissue])
    return put_particles(position, species, np.zeros(len(position), bool), 8)


def test_border_that_nothing_touches_feels_nothing():
    found = feeling(border(), border(), tumour_at([0.0, 0.0, 0.0]))
    assert found.place is None
    assert found.force == 0
    assert found.distance == pytest.approx(3.0)


def test_healthy_tissue_does_not_count():
    found = feeling(border(), border(), tumour_at())
    assert found.place is None
    assert found.distance == np.inf


def test_tumour_that_presses_on_the_border_is_felt_where_it_does():
    point = PLACES[1] + [0.0, -0.99 * AGAINST, 0.0]
    found = feeling(border(), border(), tumour_at(point))
    np.testing.assert_array_equal(found.place, PLACES[1])
    point = PLACES[1] + [0.0, -1.01 * AGAINST, 0.0]
    assert feeling(border(), border(), tumour_at(point)).place is None


@pytest.mark.parametrize("factor, felt", [(0.99, False), (1.01, True)])
def test_force_that_changed_is_felt_above_a_bound(factor, felt):
    before = np.array([[1.0, 0, 0], [0, 2.0, 0], [0, 0, 3.0]])
    now = before.copy()
    now[2, 0] = factor * FELT
    found = feeling(border(now), border(before), tumour_at([0.0, 0.0, 0.0]))
    assert found.force == pytest.approx(factor * FELT)
    assert (found.place is not None) == felt
    if felt:
        np.testing.assert_array_equal(found.place, PLACES[2])


def test_padding_is_not_felt():
    particles = tumour_at([0.0, 0.0, 0.0])
    assert not bool(jnp.all(particles.alive))
    assert feeling(border(), border(), particles).distance == pytest.approx(3.0)
