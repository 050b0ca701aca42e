"""What `relax` and `linear_response` are given is right, made right, or refused."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrow as jg
from jaxgrow.runtime.compilations import count_compilations
from jaxgrow.runtime.results import Result
from jaxgrow.state import Membrane, Nodes, Particles
from jaxgrow.transfer.array_checks import accept_bodies, accept_vectors

from ..sheets import square


CLOUD = jg.make_particles([[0.0, 0, 0], [0.9, 0, 0], [0, 1.1, 0]])
SHEET = jg.make_membrane(*square(9))
FIELDS = {
    f"{body}.{field.name}": (body, field.name)
    for body, of in (("particles", Particles), ("membrane", Membrane))
    for field in dataclasses.fields(of)
    if field.name != "rest"
}
MASKS = [name for name in FIELDS if name.endswith(("alive", "held", "pinned"))]
WHOLE = ["particles.species", "membrane.faces", "membrane.edges", "membrane.source"]


def field(name):
    body, own = FIELDS[name]
    return getattr({"particles": CLOUD, "membrane": SHEET}[body], own)


def changed(name, value):
    """Cloud and sheet, one of them with another array."""
    body, own = FIELDS[name]
    bodies = {"particles": CLOUD, "membrane": SHEET}
    bodies[body] = eqx.tree_at(lambda b: getattr(b, own), bodies[body], value)
    return bodies["particles"], bodies["membrane"]


def uniform(force=1e-5):
    return np.full((81, 3), [0, 0, force])


@pytest.fixture(scope="module")
def sagging():
    """The sheet under its own weight."""
    return jg.relax(None, SHEET, load=jnp.asarray(uniform()), tolerance=1e-9)


# load and forces


@pytest.mark.parametrize("shape", [(3,), (40, 3), (162, 3), (81,), (81, 2)])
def test_load_of_another_shape_is_refused(shape):
    with pytest.raises(ValueError, match=r"load has .*; it must be \(81, 3\) \(one"):
        jg.relax(None, SHEET, load=jnp.zeros(shape))


def test_load_without_a_membrane_is_refused():
    with pytest.raises(ValueError, match=r"it must be None \(there are no such nodes"):
        jg.relax(CLOUD, load=jnp.zeros((3, 3)))


@pytest.mark.parametrize("dtype", [bool, complex, np.float16])
def test_load_of_other_numbers_is_refused(dtype):
    with pytest.raises(ValueError, match=r"load holds .*; it must hold real numbers"):
        jg.relax(None, SHEET, load=np.zeros((81, 3), dtype))


@pytest.mark.parametrize("make", [np.asarray, np.ndarray.tolist])
def test_load_may_be_of_numpy_or_lists(sagging, make):
    found = jg.relax(None, SHEET, load=make(uniform()), tolerance=1e-9)
    np.testing.assert_array_equal(found.state[1].vertices, sagging.state[1].vertices)


def test_load_of_32_bits_gets_64(sagging):
    load = jnp.asarray(uniform(), jnp.float32)
    found = jg.relax(None, SHEET, load=load, tolerance=1e-9)
    assert found.result is Result.CONVERGED
    vertices = sagging.state[1].vertices
    np.testing.assert_allclose(found.state[1].vertices, vertices, rtol=1e-6, atol=1e-9)


def test_load_of_whole_numbers_gets_the_precision_of_the_vertices():
    load = accept_vectors("load", np.ones((81, 3), int), SHEET.vertices)
    assert load.dtype == jnp.float64


def test_forces_of_a_response_may_be_of_numpy(sagging):
    membrane, load = sagging.state[1], uniform()
    found = jg.linear_response(
        None, membrane, forces=Nodes(None, jnp.asarray(load)), load=load
    )
    assert found.result is Result.CONVERGED
    # nearly linear: as much again
    heights = membrane.vertices[:, 2]
    np.testing.assert_allclose(
        found.displacement.vertices[:, 2], heights, rtol=1e-3, atol=1e-8
    )


# arrays of particles and membrane


@pytest.mark.parametrize("name", FIELDS)
def test_array_with_a_row_too_many_is_refused(name):
    array = jnp.atleast_1d(field(name))
    longer = jnp.concatenate([array, array[:1]])
    with pytest.raises(ValueError, match=r"has the shape .*; it must be \("):
        jg.relax(*changed(name, longer))


@pytest.mark.parametrize(
    "name, shape, match",
    [
        ("particles.position", (3, 2), r"\(3, 2\); it must be \(n, 3\) \(one row for"),
        ("particles.species", (1,), r"\(1,\); it must be \(3,\) .* every particle"),
        ("membrane.faces", (128,), r"\(128,\); it must be \(f, 3\) .* every face"),
        ("membrane.opposite", (), r"\(\); it must be \(208, 2\) .* every edge"),
        ("membrane.source", (1,), r"\(1,\); it must be \(\) \(a single number"),
    ],
)
def test_sentence_says_which_shape_came_and_which_is_wanted(name, shape, match):
    array = jnp.zeros(shape, field(name).dtype)
    with pytest.raises(ValueError, match=f"{name} has the shape {match}"):
        jg.relax(*changed(name, array))


@pytest.mark.parametrize("name", MASKS)
def test_mask_of_whole_numbers_is_refused(name):
    numbers = field(name).astype(int)
    with pytest.raises(ValueError, match=f"{name} holds int64; it must hold booleans"):
        jg.relax(*changed(name, numbers))


@pytest.mark.parametrize("name", WHOLE)
def test_number_of_a_row_that_is_no_integer_is_refused(name):
    numbers = field(name).astype(float)
    with pytest.raises(ValueError, match=f"{name} holds float64; it must hold integer"):
        jg.relax(*changed(name, numbers))


@pytest.mark.parametrize("name", ["membrane.vertices", "particles.position"])
def test_positions_of_16_bits_are_refused(name):
    with pytest.raises(ValueError, match=f"{name} holds float16; it must hold real"):
        jg.relax(*changed(name, field(name).astype(jnp.float16)))


@pytest.mark.parametrize("put", [np.asarray, jnp.asarray])
@pytest.mark.parametrize(
    "name, value, match",
    [
        ("particles.species", 2, "the value 2; its values must be from 0 to 1,"),
        ("membrane.faces", 81, "the value 81; its values must be from 0 to 80,"),
        ("membrane.edges", -1, "the value -1; its values must be from 0 to 80,"),
        ("membrane.source", -2, "the value -2; its values must be from -1 to 80,"),
    ],
)
def test_number_of_a_row_that_is_not_there_is_refused(name, value, match, put):
    numbers = np.array(field(name))
    numbers[(0,) * numbers.ndim] = value
    with pytest.raises(ValueError, match=f"{name} has {match}"):
        jg.relax(*changed(name, put(numbers)))


@pytest.mark.parametrize(
    "value, match",
    [
        ([[0.0, 0, 0], [1.0, 0]], "particles.position is no array .*; give an array"),
        (np.full((3, 3), "a"), "particles.position holds <U1; it must hold real"),
        (None, "particles.position holds object; it must hold real numbers"),
    ],
)
def test_what_is_no_array_of_numbers_is_refused(value, match):
    with pytest.raises(ValueError, match=match):
        accept_bodies(*changed("particles.position", value))


@pytest.mark.parametrize(
    "given, match",
    [
        ((CLOUD.position, None), r"particles is of type ArrayImpl; give .*make_partic"),
        ((SHEET, None), r"particles is of type Membrane; give jaxgrow.Particles"),
        ((None, CLOUD), r"membrane is of type Particles; .*make_membrane\(\.\.\.\)"),
    ],
)
def test_what_is_no_body_is_refused(given, match):
    with pytest.raises(ValueError, match=match):
        accept_bodies(*given)


def test_linear_response_checks_the_same_arrays():
    membrane = changed("membrane.pinned", SHEET.pinned.astype(int))[1]
    forces = Nodes(None, jnp.zeros((81, 3)))
    with pytest.raises(ValueError, match="pinned holds int64; it must hold booleans"):
        jg.linear_response(None, membrane, forces=forces)


# what is made right


@pytest.mark.parametrize("make", [np.asarray, lambda array: np.asarray(array).tolist()])
def test_arrays_of_numpy_and_lists_are_put_on_the_device(make):
    found = accept_bodies(*jax.tree.map(make, (CLOUD, SHEET)))
    for array, wanted in zip(
        *map(jax.tree.leaves, (found, (CLOUD, SHEET))), strict=True
    ):
        assert isinstance(array, jax.Array)
        assert array.dtype == wanted.dtype
        np.testing.assert_array_equal(array, wanted)


def test_numbers_of_32_bits_get_the_precision_of_the_positions():
    length = SHEET.rest_length.astype(jnp.float32)
    _, membrane = accept_bodies(CLOUD, SHEET.with_rest_length(length))
    assert membrane.rest_length.dtype == jnp.float64
    np.testing.assert_allclose(membrane.rest_length, SHEET.rest_length, rtol=1e-7)


@pytest.mark.parametrize("name", ["particles.position", "membrane.vertices"])
def test_positions_get_the_wider_of_two_precisions(name):
    particles, membrane = accept_bodies(*changed(name, field(name).astype(jnp.float32)))
    assert particles.position.dtype == membrane.vertices.dtype == jnp.float64


def test_positions_of_32_bits_keep_them_and_all_else_follows():
    narrow = CLOUD.position.astype(jnp.float32)
    assert accept_bodies(*changed("particles.position", narrow))[0] is not CLOUD
    particles, _ = changed("particles.position", narrow)
    assert accept_bodies(particles, None)[0] is particles
    load = accept_vectors("load", np.ones((3, 3)), narrow)
    assert load.dtype == jnp.float32


def test_whole_numbers_of_32_bits_get_64():
    faces = np.asarray(SHEET.faces, np.int32)
    assert accept_bodies(*changed("membrane.faces", faces))[1].faces.dtype == int


# what is right


def test_right_arrays_come_back_as_they_are_without_a_program():
    with count_compilations() as compilations:
        found = accept_bodies(CLOUD, SHEET)
    assert compilations.count == 0
    assert found[0] is CLOUD
    assert found[1] is SHEET


def test_state_of_a_growth_is_right_as_it_is(tiny_polyp, tiny_cluster):
    for growth in (tiny_polyp, tiny_cluster):
        state = growth.state
        particles, membrane = accept_bodies(state.particles, state.membrane)
        assert particles is state.particles
        assert membrane is state.membrane


def test_array_on_the_device_is_looked_at_once(monkeypatch):
    from jaxgrow.transfer import array_checks

    faces = jnp.asarray(np.asarray(SHEET.faces))
    looked = []
    monkeypatch.setattr(
        array_checks, "get", lambda a: looked.append(a) or np.asarray(a)
    )
    for _ in range(3):
        accept_bodies(*changed("membrane.faces", faces))
    assert sum(array is faces for array in looked) == 1


@pytest.mark.parametrize("rows", [0, 1, 207, 209])
def test_rest_data_with_other_rows_than_edges_or_faces_are_refused(rows):
    wrong = SHEET.with_rest({"springs": jnp.zeros((rows, 1))})
    with pytest.raises(ValueError, match=r"membrane.rest\['springs'\] has the shape"):
        jg.relax(None, wrong)


# traced values


def moved(scale):
    """Cloud and sheet with positions and rest lengths that a number scales."""
    return (
        CLOUD.at(scale * CLOUD.position),
        SHEET.at(scale * SHEET.vertices).with_rest_length(scale * SHEET.rest_length),
    )


def total(scale):
    particles, membrane = accept_bodies(*moved(scale))
    load = accept_vectors("load", scale * jnp.ones((81, 3)), membrane.vertices)
    floats = (particles.position, membrane.vertices, membrane.rest_length, load)
    return sum(jnp.sum(array) for array in floats)


def test_traced_values_pass():
    one, two = jnp.asarray(1.0), jnp.asarray([1.0, 2.0])
    value = float(total(one))
    assert float(jax.grad(total)(one)) == pytest.approx(value)
    assert float(jax.jvp(total, (one,), (one,))[1]) == pytest.approx(value)
    assert float(jax.jit(total)(one)) == pytest.approx(value)
    np.testing.assert_allclose(jax.vmap(total)(two), [value, 2 * value])


def test_traced_load_of_another_shape_is_refused():
    def height(load):
        return jg.relax(None, SHEET, load=load).state[1].vertices[40, 2]

    with pytest.raises(ValueError, match=r"load has the shape \(40, 3\); it must be"):
        jax.grad(height)(jnp.zeros((40, 3)))


def test_traced_numbers_may_come_in_a_list():
    def first(x):
        particles, _ = changed("particles.position", [[x, 0.0, 0.0]] * 3)
        return accept_bodies(particles, None)[0].position[0, 0]

    assert float(jax.grad(first)(2.0)) == 1.0
