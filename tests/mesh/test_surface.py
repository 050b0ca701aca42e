"""The surface and the record of what was done to it."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.mesh.surface import average_parents, Remeshing, Surface


TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
FACE = np.array([[0, 1, 2]])
FREE = np.zeros(3, dtype=bool)


def test_a_face_that_names_a_missing_vertex_is_refused():
    with pytest.raises(ValueError, match="faces name vertices 0 to 3 of 3"):
        Surface(TRIANGLE, np.array([[0, 1, 3]]), FREE)


def test_a_source_that_is_no_vertex_is_refused():
    with pytest.raises(ValueError, match="source is 3 of 3 vertices"):
        Surface(TRIANGLE, FACE, FREE, 3)


def test_flags_that_do_not_fit_the_vertices_are_refused():
    # Without __init__: where shapes are checked at run time they are refused there.
    surface = object.__new__(Surface)
    for name, value in (
        ("vertices", TRIANGLE),
        ("faces", FACE),
        ("fixed", np.zeros(2, dtype=bool)),
        ("source", -1),
    ):
        object.__setattr__(surface, name, value)
    with pytest.raises(ValueError, match="give one flag a vertex"):
        surface.__post_init__()


def test_fixed_vertices_and_the_source_are_kept():
    surface = Surface(TRIANGLE, FACE, np.array([True, False, False]), 2)
    assert surface.kept.tolist() == [True, False, True]


def test_a_vertex_that_is_its_own_parents_keeps_every_bit():
    vertices = np.random.default_rng(0).normal(size=(1000, 3)) * 10.0 ** np.arange(3)
    own = np.repeat(np.arange(1000)[:, None], 2, axis=1)
    assert np.array_equal(average_parents(vertices, own), vertices)


def _two_steps():
    first = np.array([[0, 0], [1, 1], [2, 2], [0, 1]])
    second = np.array([[3, 3], [2, 2], [0, 1]])
    return Remeshing((first, second), FACE, FREE)


def test_origin_names_the_vertices_that_are_old_ones_through_all_maps():
    # 0: a middle made by the first map; 1: old vertex 2; 2: a middle of the second.
    assert _two_steps().origin().tolist() == [-1, 2, -1]


def test_maps_act_on_jax_arrays_as_on_numpy_arrays():
    vertices = TRIANGLE.astype(np.float32)
    replayed = _two_steps().apply(jnp.asarray(vertices))
    assert isinstance(replayed, jnp.ndarray)
    assert np.array_equal(np.asarray(replayed), _two_steps().apply(vertices))


def test_one_remeshing_after_another_joins_maps_and_adds_counts():
    one = Remeshing((_two_steps().parents[0],), FACE, FREE, counts={"t_shape": 1})
    two = Remeshing(
        (_two_steps().parents[1],), FACE, FREE, 1, {"t_shape": 2, "swapped": 4}
    )
    both = one.then(two)
    assert np.array_equal(both.apply(TRIANGLE), two.apply(one.apply(TRIANGLE)))
    assert both.counts == {"t_shape": 3, "swapped": 4}
    assert both.source == 1
