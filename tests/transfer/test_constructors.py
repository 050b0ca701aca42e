"""A cloud and a membrane of one's own, in a line each."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse import lil_array
from scipy.sparse.linalg import spsolve

import jaxgrow as jg

from ..sheets import square


TETRAHEDRON = (
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
    [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
)


# particles


def test_cloud_of_a_line_comes_to_rest():
    position = np.array([[0, 0, 0], [0.8, 0, 0], [0.4, 0.7, 0]])
    outcome = jg.relax(jg.make_particles(position), tolerance=1e-9)
    assert outcome.result is jg.Result.CONVERGED
    place = np.asarray(outcome.state[0].position)
    sides = np.linalg.norm(place - np.roll(place, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides, 1, atol=1e-8)


def test_particles_are_tissue_that_may_move():
    cloud = jg.make_particles(np.zeros((2, 3)))
    assert cloud.species.tolist() == [jg.Species.TISSUE] * 2
    assert cloud.free.tolist() == [True, True]


def test_species_and_held_are_one_for_all_or_one_for_each():
    cloud = jg.make_particles(
        np.zeros((2, 3)), species=jg.Species.TUMOUR, held=[True, False]
    )
    assert cloud.species.tolist() == [1, 1]
    assert cloud.held.tolist() == [True, False]


@pytest.mark.parametrize(
    "dtype, wanted", [(np.float32, "float32"), (float, "float64"), (int, "float64")]
)
def test_positions_keep_their_precision(dtype, wanted):
    assert jg.make_particles(np.zeros((2, 3), dtype)).position.dtype == wanted
    flat = np.asarray(TETRAHEDRON[0], dtype), TETRAHEDRON[1]
    assert jg.make_membrane(*flat).rest_length.dtype == wanted


@pytest.mark.parametrize(
    "given, match",
    [
        (
            {"position": np.zeros((2, 2))},
            r"position has the shape \(2, 2\); .*\(n, 3\)",
        ),
        ({"position": [[0, 0, np.nan]]}, "position is not finite in row 0"),
        ({"species": [0, 1, 1]}, r"species has the shape \(3,\); it must be \(2,\)"),
        (
            {"species": [0, 2]},
            "species has the value 2; its values must be from 0 to 1",
        ),
        ({"species": 0.0}, "species holds float64; it must hold integers"),
        ({"held": [0, 1]}, r"held holds int64; it must hold booleans"),
    ],
)
def test_wrong_particles_are_refused(given, match):
    with pytest.raises(ValueError, match=match):
        jg.make_particles(**{"position": np.zeros((2, 3)), **given})


# membranes


def test_sheet_of_a_line_sags_as_the_discrete_laplace_equation_says():
    vertices, faces = square(9)
    sheet = jg.make_membrane(vertices, faces)
    load = np.full((81, 3), [0, 0, 1e-5])
    law = jg.Parameters(bending_stiffness=0.0)
    outcome = jg.relax(None, sheet, parameters=law, load=load, tolerance=1e-10)
    assert outcome.result is jg.Result.CONVERGED
    matrix = lil_array((81, 81))
    for i, j in np.asarray(sheet.edges):
        for a, b in ((i, j), (j, i)):
            matrix[a, a] += 1
            matrix[a, b] -= 1
    free = np.flatnonzero(np.asarray(sheet.free))
    # every edge at rest pulls with k τ per length
    stiffness = law.spring_stiffness * law.pretension
    wanted = spsolve(stiffness * matrix.tocsr()[free][:, free], load[free, 2])
    found = np.asarray(outcome.state[1].vertices)[free, 2]
    np.testing.assert_allclose(found, wanted, rtol=1e-4)


def test_edges_are_those_of_the_faces_each_once_and_at_rest():
    vertices, faces = square(4)
    sheet = jg.make_membrane(vertices, faces)
    sides = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges = np.unique(sides, axis=0)
    np.testing.assert_array_equal(sheet.edges, edges)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    np.testing.assert_allclose(sheet.rest_length, length, rtol=1e-15)


def test_everything_of_a_membrane_is_alive():
    sheet = jg.make_membrane(*square(4))
    for mask in (sheet.vertex_alive, sheet.face_alive, sheet.edge_alive):
        assert np.all(mask)
    assert sheet.vertices.shape == (16, 3)
    assert sheet.faces.shape == (18, 3)


def test_rim_is_pinned_and_nothing_of_a_closed_surface():
    inner = np.zeros((4, 4), bool)
    inner[1:3, 1:3] = True
    sheet = jg.make_membrane(*square(4))
    np.testing.assert_array_equal(sheet.free, inner.ravel())
    assert np.all(jg.make_membrane(*TETRAHEDRON).free)


def test_pinned_is_a_mask_or_one_flag_for_all():
    mask = np.arange(16) == 3
    sheet = jg.make_membrane(*square(4), pinned=mask)
    np.testing.assert_array_equal(sheet.pinned, mask)
    assert np.all(jg.make_membrane(*square(4), pinned=False).free)


@pytest.mark.parametrize("given", [0.5, np.full(33, 0.5), np.full(33, 0.5, np.float32)])
def test_rest_length_is_one_for_all_or_one_for_each_edge(given):
    sheet = jg.make_membrane(*square(4), rest_length=given)
    assert sheet.rest_length.dtype == jnp.float64
    np.testing.assert_array_equal(sheet.rest_length, np.full(33, 0.5))


def test_rest_lengths_are_functions_of_traced_vertices():
    vertices, faces = square(3)

    def total(scale):
        return jnp.sum(jg.make_membrane(scale * vertices, faces).rest_length)

    value, slope = jax.value_and_grad(total)(1.0)
    assert float(slope) == pytest.approx(float(value))


def test_rest_length_may_be_traced():
    def total(length):
        return jnp.sum(jg.make_membrane(*square(3), rest_length=length).rest_length)

    assert float(jax.grad(total)(1.0)) == 16


@pytest.mark.parametrize(
    "given, match",
    [
        (
            {"vertices": np.zeros((4, 2))},
            r"vertices has the shape \(4, 2\); .*\(m, 3\)",
        ),
        ({"vertices": np.full((4, 3), np.inf)}, "vertices is not finite in row 0"),
        ({"faces": [0, 1, 2]}, r"faces has the shape \(3,\); it must be \(f, 3\)"),
        (
            {"faces": [[0, 1, 4]]},
            "faces has the value 4; its values must be from 0 to 3",
        ),
        ({"faces": [[0.0, 1, 2]]}, "faces holds float64; it must hold integers"),
        ({"faces": [[0, 1, 1]]}, r"face 0 has a vertex twice"),
        ({"faces": [[0, 1, 2], [0, 1, 3]]}, r"edge \(0, 1\) is run twice"),
        ({"pinned": [0, 1, 0, 1]}, "pinned holds int64; it must hold booleans"),
        ({"pinned": [True]}, r"pinned has the shape \(1,\); it must be \(4,\)"),
        ({"pinned": "edge"}, 'pinned is "edge"; give "rim"'),
        ({"rest_length": np.ones(5)}, r"rest_length has the shape \(5,\); .* \(6,\)"),
        ({"rest_length": np.nan}, "rest_length is not finite in row 0"),
        ({"rest_length": -1.0}, "rest_length has the value -1.0; lengths are not neg"),
        ({"source": 4}, "source has the value 4; its values must be from -1 to 3"),
    ],
)
def test_wrong_membrane_is_refused(given, match):
    vertices, faces = TETRAHEDRON
    with pytest.raises(ValueError, match=match):
        jg.make_membrane(**{"vertices": vertices, "faces": faces, **given})
