"""Operations that would harm a particle are refused."""

import numpy as np
import pytest

from jaxgrow.mesh.particle_guard import Guard, Patches


# The edge a-b under a roof: flipping it to c-d fills the tetrahedron between them.
A, B = np.array([-1.0, 0, 0]), np.array([1.0, 0, 0])
C, D = np.array([0.0, 1, 0.4]), np.array([0.0, -1, 0.4])


def _flip(shift=0.0):
    move = np.array([shift, 0, 0])
    a, b, c, d = A + move, B + move, C + move, D + move
    owner = np.zeros(2, dtype=np.int64)
    return Patches(
        np.array([[a, b, c], [b, a, d]]),
        owner,
        np.arange(2),
        np.array([[a, d, c], [d, b, c]]),
        owner,
        c[None],
    )


def _guard(particle, clearance=0.01, vertices=()):
    return Guard(
        np.array([particle], dtype=float),
        np.array(vertices, dtype=float).reshape(-1, 3),
        clearance,
    )


@pytest.mark.parametrize(
    "particle, admitted",
    [
        ([0, 0, 0.2], False),
        ([0.3, 0.2, 0.2], False),
        ([0, 0, 0.45], True),
        ([0, 0, -0.05], True),
        ([5, 5, 5], True),
    ],
    ids=["middle", "inside", "above", "below", "far"],
)
def test_a_particle_in_the_swept_volume_refuses_the_operation(particle, admitted):
    assert _guard(particle).admits(_flip()).tolist() == [admitted]


def test_a_particle_near_the_new_triangles_refuses_the_operation():
    above = [0, 0, 0.45]
    assert _guard(above, clearance=0.04).admits(_flip()).all()
    assert not _guard(above, clearance=0.06).admits(_flip()).any()


def test_a_particle_that_was_nearer_before_does_not_refuse_it():
    # Under the old edge: 0.05 away from it, and farther from the new one.
    assert _guard([0, 0, -0.05], clearance=0.3).admits(_flip()).all()


def test_a_flat_flip_refuses_nothing_however_near_the_particle():
    flat = _flip()
    for triangles in (flat.old, flat.new):
        triangles[..., 2] = 0.0
    flat.apex[:, 2] = 0.0
    for height in (0.3, 1e-3, 1e-9):
        assert _guard([0.1, 0.05, height], clearance=0.5).admits(flat).all()


def test_a_vertex_of_another_sheet_refuses_the_operation():
    far = [9.0, 9, 9]
    assert not _guard(far, vertices=[[0, 0, 0.2]]).admits(_flip()).any()


def test_the_corners_of_the_patch_itself_do_not_refuse_it():
    assert _guard([9.0, 9, 9], vertices=[A, B, C, D]).admits(_flip()).all()


def test_only_the_operation_that_harms_is_refused():
    one, two = _flip(), _flip(10.0)
    owner = np.array([0, 0, 1, 1])
    both = Patches(
        np.concatenate([one.old, two.old]),
        owner,
        np.arange(4),
        np.concatenate([one.new, two.new]),
        owner,
        np.concatenate([one.apex, two.apex]),
    )
    assert _guard([10.0, 0, 0.2]).admits(both).tolist() == [True, False]


def test_no_operations_are_admitted_without_looking():
    nothing = Patches(
        np.zeros((0, 3, 3)),
        np.zeros(0, dtype=np.int64),
        np.zeros(0, dtype=np.int64),
        np.zeros((0, 3, 3)),
        np.zeros(0, dtype=np.int64),
        np.zeros((0, 3)),
    )
    assert _guard([0, 0, 0]).admits(nothing).shape == (0,)


def test_without_particles_and_vertices_everything_is_admitted():
    empty = np.zeros((0, 3))
    assert Guard(empty, empty, 0.1).admits(_flip()).all()
