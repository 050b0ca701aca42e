"""`linear_response`: against equilibria under small loads, and what it refuses."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrow as jg
from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.linear_response import linear_response
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.relax import relax
from jaxgrow.growth.collision_broad_phase import CollisionFinder
from jaxgrow.runtime.results import Result
from jaxgrow.state import Nodes


@pytest.fixture(scope="module")
def resting(bed):
    return relax(*bed, tolerance=1e-12)


def no_force(particles=None, membrane=None):
    return Nodes(
        None if particles is None else jnp.zeros_like(particles.position),
        None if membrane is None else jnp.zeros_like(membrane.vertices),
    )


def test_response_to_a_small_load_is_the_difference_of_equilibria(resting, load):
    force = load(24, [0.3, -0.1, 1.0])
    nothing = no_force(*resting.state)
    found = linear_response(*resting.state, forces=Nodes(nothing.particles, force))
    assert found.result is Result.CONVERGED
    step = 1e-5
    up, down = (
        relax(*resting.state, load=s * force, tolerance=1e-13).state
        for s in (step, -step)
    )
    for name, leaf in (("particles", "position"), ("vertices", "vertices")):
        ends = [getattr(p, leaf) for p in (up, down) for p in p if hasattr(p, leaf)]
        wanted = np.asarray(ends[0] - ends[1]) / (2 * step)
        size = np.linalg.norm(wanted)
        error = np.linalg.norm(getattr(found.displacement, name) - wanted)
        assert size > 0.1
        assert error <= 1e-6 * size


def test_response_reports_what_it_took(resting, load):
    nothing = no_force(*resting.state)
    forces = Nodes(nothing.particles, load(24, [0, 0, 1.0]))
    found = linear_response(*resting.state, forces=forces)
    assert 0 < found.residual <= 1e-9
    assert found.products > 20
    assert 1e-3 < found.softest < 0.1
    assert found.null_modes == 0


def test_lists_of_the_relaxation_may_be_given(resting, load):
    nothing = no_force(*resting.state)
    forces = Nodes(nothing.particles, load(24, [0, 0, 1.0]))
    first = linear_response(*resting.state, forces=forces)
    second = linear_response(*resting.state, forces=forces, lists=resting.lists)
    for one, other in zip(
        jax.tree.leaves(first.displacement),
        jax.tree.leaves(second.displacement),
        strict=True,
    ):
        np.testing.assert_allclose(one, other, atol=1e-8)


def test_load_keeps_what_is_not_pinned_from_turning(make_membrane, load):
    membrane = make_membrane()
    loose = eqx.tree_at(lambda m: m.pinned, membrane, jnp.zeros(256, bool))
    pulled = load(0, [-0.1, 0, 0]) + load(48, [0.1, 0, 0])
    modes = [
        linear_response(
            None, loose, forces=no_force(None, loose), load=given
        ).null_modes
        for given in (None, load(0, [0, 0, 0]), pulled)
    ]
    assert modes == [6, 6, 3]


def test_parameters_of_the_energy_count(make_membrane, load):
    soft = relax(None, make_membrane(), tolerance=1e-11).state[1]
    forces = Nodes(None, load(24, [0, 0, 1.0]))
    heights = [
        linear_response(
            None,
            soft,
            forces=forces,
            parameters=Parameters(spring_stiffness=k, bending_stiffness=0.0),
        ).displacement.vertices[24, 2]
        for k in (0.04, 0.08)
    ]
    assert float(heights[0] / heights[1]) == pytest.approx(2, rel=1e-8)


def test_free_cluster_has_six_null_modes(make_particles):
    rng = np.random.default_rng(1)
    drop = relax(make_particles(rng.uniform(0, 3, (27, 3))), tolerance=1e-11).state[0]
    found = jg.linear_response(drop, forces=Nodes(jnp.ones((64, 3)), None))
    assert isinstance(found, jg.LinearResponse)
    assert found.result is Result.CONVERGED
    assert found.null_modes == 6
    np.testing.assert_allclose(found.displacement.particles, 0, atol=1e-10)


def test_result_says_why_a_derivative_is_nan(make_particles):
    position = [[0, 0, 0], [0.85, 0, 0], [1.7, 0, 0]]
    column = make_particles(position, np.array([True, False, True]))

    def place(adhesion):
        parameters = Parameters(adhesion=adhesion)
        return relax(column, parameters=parameters).state[0].position[1, 0]

    assert np.isnan(jax.grad(place)(0.2))
    found = linear_response(column, forces=no_force(column))
    assert found.result is Result.SINGULAR
    assert np.isnan(found.displacement.particles).all()


# what it refuses


def test_nothing_to_respond_is_refused():
    with pytest.raises(ValueError, match="nothing responds: give particles"):
        linear_response(None, forces=Nodes(None, None))


@pytest.mark.parametrize(
    "particles, vertices, match",
    [
        ((50, 3), (256, 3), r"forces.particles has the shape \(50, 3\); it must be"),
        ((64, 3), (49, 3), r"forces.vertices has the shape \(49, 3\); .* \(256, 3\)"),
        ((64, 3), None, r"forces.vertices has the shape None; it must be \(256, 3\)"),
        (None, (256, 3), r"forces.particles has the shape None; it must be \(64, 3\)"),
    ],
)
def test_forces_of_another_shape_are_refused(bed, particles, vertices, match):
    shapes = particles, vertices
    forces = Nodes(*(None if s is None else jnp.zeros(s) for s in shapes))
    with pytest.raises(ValueError, match=match):
        linear_response(*bed, forces=forces)


def test_load_of_another_shape_is_refused(bed):
    with pytest.raises(ValueError, match=r"load has the shape \(49, 3\); it must be"):
        linear_response(*bed, forces=no_force(*bed), load=jnp.zeros((49, 3)))


def test_load_without_a_membrane_is_refused(cluster):
    with pytest.raises(ValueError, match=r"load has .* must be None \(there are no"):
        linear_response(cluster, forces=no_force(cluster), load=jnp.zeros((256, 3)))


def test_collisions_that_were_listed_elsewhere_are_refused(make_membrane):
    membrane = make_membrane()
    names = np.full(49, -1)
    collide = CollisionFinder.of(membrane, names, None, Parameters())
    lists = Lists(None, None, collisions=collide(membrane.vertices, None))
    moved = eqx.tree_at(lambda m: m.vertices, membrane, membrane.vertices + 1.0)
    forces = no_force(None, membrane)
    with pytest.raises(ValueError, match="moved too far since the collisions were"):
        linear_response(None, moved, forces=forces, lists=lists)


@pytest.mark.slow
def test_collisions_of_the_lists_are_felt(make_membrane, load):
    from jaxgrow.mesh.collision_mesh import Walls

    corners = np.array([[-20.0, -20, -0.8], [40, -20, -0.8], [-20, 40, -0.8]])
    walls = Walls(corners, np.array([[0, 1, 2]]), np.array([100, 101, 102]))
    membrane, parameters = make_membrane(), Parameters(spring_stiffness=0.3)
    collide = CollisionFinder.of(membrane, np.full(49, -1), walls, parameters)
    down = load(jnp.arange(49), [0, 0, -0.3])
    given = {
        "parameters": parameters,
        "load": jnp.where(membrane.free[:, None], down, 0),
    }
    outcome = relax(None, membrane, tolerance=1e-11, collide=collide, **given)
    assert outcome.result is Result.CONVERGED
    given["forces"] = Nodes(None, load(24, [0, 0, -1.0]))
    with_wall, without = (
        linear_response(None, outcome.state[1], lists=lists, **given)
        for lists in (outcome.lists, None)
    )
    assert with_wall.result is Result.CONVERGED
    depths = [-r.displacement.vertices[24, 2] for r in (with_wall, without)]
    assert 0 < depths[0] < 0.9 * depths[1]
