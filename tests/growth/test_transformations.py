"""JAX's transformations around relaxations and growths: Jacobians, and refusals."""

import dataclasses
import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.linear_response import linear_response
from jaxgrow.equilibrium.relax import relax
from jaxgrow.growth.grow import grow
from jaxgrow.io.audit import audit
from jaxgrow.io.run_folder import write_run
from jaxgrow.lesions.myoma import Myoma
from jaxgrow.lesions.polyp import Polyp
from jaxgrow.metrics import shape_metrics
from jaxgrow.runtime.results import Result
from jaxgrow.scene.scene import Scene
from jaxgrow.state import Nodes
from jaxgrow.transfer.device import put_particles


def with_values(names, values):
    return Parameters(**dict(zip(names, values, strict=True)))


def differences(function, at, step=1e-4):
    """The Jacobian by central differences, extrapolated to 0 (Richardson)."""

    def column(direction):
        def central(h):
            ends = [function(at + s * h * direction) for s in (1, -1)]
            return (ends[0] - ends[1]) / (2 * h)

        return (4 * central(step / 2) - central(step)) / 3

    return np.stack([column(e) for e in np.eye(len(at))], axis=1)


def check_jacobians(metrics, at, rtol):
    """Both modes against each other, single directions, and differences."""
    backward, forward = jax.jacrev(metrics)(at), jax.jacfwd(metrics)(at)
    scale = np.abs(backward).max(axis=1, keepdims=True)
    assert (scale > 1e-4).all()
    np.testing.assert_allclose(backward / scale, forward / scale, atol=1e-8)
    _, pull = jax.vjp(metrics, at)
    for weight, row in zip(np.eye(len(backward)), backward, strict=True):
        np.testing.assert_allclose(pull(jnp.asarray(weight))[0], row, rtol=1e-10)
    for direction, column in zip(np.eye(len(at)), forward.T, strict=True):
        _, alone = jax.jvp(metrics, (at,), (jnp.asarray(direction),))
        np.testing.assert_allclose(alone, column, rtol=1e-12, atol=1e-14)
    wanted = differences(metrics, at)
    np.testing.assert_allclose(backward / scale, wanted / scale, atol=rtol)


# relaxations

NAMES = ("adhesion", "tumour_stiffness", "smoothing")
AT = jnp.array([0.2, 1.5, 0.1])


@pytest.fixture(scope="module")
def cage():
    """Forty particles at an equilibrium, half of them tumour, some held."""
    position = np.random.default_rng(0).uniform(0, 3, (40, 3))
    index = np.arange(40)
    start = put_particles(position, index % 2, index % 8 == 0, 64)
    found = relax(start, parameters=with_values(NAMES, AT), tolerance=1e-12)
    assert found.result is Result.CONVERGED
    return found.state[0]


def in_a_cage(cage, **options):
    """Extent, place and reaction of a cage, by its parameters."""

    def metrics(values):
        found = relax(cage, parameters=with_values(NAMES, values), **options)
        position, felt = found.state[0].position[:40], found.forces.particles[:40]
        away = position - jnp.mean(position, axis=0, keepdims=True)
        gyration = jnp.sqrt(jnp.mean(jnp.sum(away**2, axis=1)))
        reaction = jnp.sum(felt[::8] ** 2)
        return jnp.stack([gyration, position[3, 0], position[5, 2], reaction])

    return metrics


def test_jacobians_through_a_relaxation_are_those_of_differences(cage):
    check_jacobians(in_a_cage(cage, tolerance=1e-12), AT, rtol=1e-6)


@pytest.mark.parametrize("jacobian", [jax.jacfwd, jax.jacrev])
def test_jacobian_of_an_equilibrium_that_was_not_reached_is_nan(cage, jacobian):
    metrics = in_a_cage(cage, max_steps=1, method="lbfgs")
    assert np.isnan(jacobian(metrics)(AT + 0.1)).all()


def test_pullback_may_be_compiled_and_batched(cage):
    metrics = in_a_cage(cage)
    _, pull = jax.vjp(metrics, AT)
    wanted = jax.jacrev(metrics)(AT)
    (found,) = jax.jit(jax.vmap(pull))(jnp.eye(4))
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-9)


# what is refused

WITHHELD = {
    "jit": jax.jit,
    "checkpoint": jax.checkpoint,
    "vmap": lambda f: lambda x: jax.vmap(f)(x[None]),
    "grad of jit": lambda f: jax.jacrev(jax.jit(f)),
    "jit of grad": lambda f: jax.jit(jax.jacrev(f)),
    "vmap of grad": lambda f: lambda x: jax.vmap(jax.jacrev(f))(x[None]),
    "eval_shape": lambda f: lambda x: jax.eval_shape(f, x),
}
SECOND = {
    "hessian": jax.hessian,
    "grad of grad": lambda f: jax.jacrev(jax.jacrev(f)),
    "forward of forward": lambda f: jax.jacfwd(jax.jacfwd(f)),
    "grad of forward": lambda f: jax.jacrev(jax.jacfwd(f)),
    "grad of value and grad": lambda f: jax.jacrev(
        lambda x: jax.vjp(f, x)[1](jnp.ones(()))[0]
    ),
}
CLUSTER = Scene(organ=None, lesion=Myoma(divisions=4))


def relaxed(cage):
    def place(adhesion):
        parameters = Parameters(adhesion=adhesion)
        return relax(cage, parameters=parameters).state[0].position[3, 0]

    return place


def grown(_):
    def place(adhesion):
        parameters = Parameters(adhesion=adhesion)
        return grow(CLUSTER, parameters=parameters).state.particles.position[1, 0]

    return place


@pytest.mark.parametrize("name", list(WITHHELD))
@pytest.mark.parametrize("made", [relaxed, grown])
def test_what_withholds_values_is_refused(cage, made, name):
    with pytest.raises(ValueError, match="withhold them; call it outside of them"):
        WITHHELD[name](made(cage))(jnp.asarray(0.2))


@pytest.mark.parametrize("name", list(SECOND))
@pytest.mark.parametrize("made", [relaxed, grown])
def test_second_derivative_is_refused(cage, made, name):
    with pytest.raises(ValueError, match="has first derivatives only"):
        SECOND[name](made(cage))(jnp.asarray(0.2))


def test_mixed_second_derivative_is_refused(cage):
    def inner(adhesion, stiffness):
        parameters = Parameters(adhesion=adhesion, tumour_stiffness=stiffness)
        return relax(cage, parameters=parameters).state[0].position[3, 0]

    mixed = jax.grad(lambda a: jax.grad(lambda s: inner(a, s))(jnp.asarray(1.5)))
    with pytest.raises(ValueError, match="has first derivatives only"):
        mixed(jnp.asarray(0.2))


def test_linear_response_has_no_derivative_and_says_so(cage):
    def moved(adhesion):
        forces = Nodes(jnp.ones_like(cage.position), None)
        parameters = Parameters(adhesion=adhesion)
        found = linear_response(cage, forces=forces, parameters=parameters)
        return found.displacement.particles[3, 0]

    with pytest.raises(ValueError, match=r"a linear response is computed on the host"):
        jax.grad(moved)(jnp.asarray(0.2))
    with pytest.raises(ValueError, match="withhold them; call it outside of them"):
        jax.jit(moved)(jnp.asarray(0.2))


# growths


@pytest.fixture(scope="module")
def seven():
    """A free cluster of seven particles, recorded for a replay."""
    lesion = Myoma(divisions=6, particle_mm=1.3)
    return grow(Scene(organ=None, lesion=lesion), tolerance=1e-10)


GROWN = ("adhesion", "smoothing", "tumour_stiffness")
GROWN_AT = jnp.array([0.2, 0.3, 1.0])


def of_a_growth(growth, names):
    """Metrics of a replay, by its parameters."""

    def metrics(values):
        again = grow(
            growth.scene, parameters=with_values(names, values), events=growth.events
        )
        shape = shape_metrics(again.state, smoothing=0.1)
        of_surface = [shape.height_mm, shape.volume_mm3]
        position = again.state.particles.position
        of_particles = [position[0] @ position[2], position[1] @ position[1]]
        some = of_particles if growth.organ is None else of_surface
        size = jnp.asarray(again.size_mm)
        return jnp.stack([*some, shape.tumour_diameter_mm, size])

    return metrics


def test_jacobians_through_a_growth_are_those_of_differences(seven):
    check_jacobians(of_a_growth(seven, GROWN), GROWN_AT, rtol=1e-6)


@pytest.mark.slow
def test_jacobians_through_a_polyp_are_those_of_differences():
    growth = grow(Scene(lesion=Polyp(divisions=3)), tolerance=1e-10)
    names = ("spring_stiffness", "adhesion", "contact_range")
    at = jnp.array([getattr(Parameters(), name) for name in names])
    metrics = of_a_growth(growth, names)
    check_jacobians(lambda values: metrics(values)[:3], at, rtol=1e-5)


def sized(growth, value):
    parameters = Parameters(adhesion=value)
    return grow(growth.scene, parameters=parameters, events=growth.events)


def test_size_carries_its_derivative(seven):
    def size(value):
        return jnp.asarray(sized(seven, value).size_mm)

    wanted = differences(lambda v: size(v[0]).reshape(1), jnp.array([0.2]))
    found = jax.grad(size)(jnp.asarray(0.2))
    assert abs(wanted[0, 0]) > 1e-3
    assert float(found) == pytest.approx(wanted[0, 0], rel=1e-6)


def test_size_has_the_bits_it_has_without_a_derivative(seven):
    def size(value):
        again = sized(seven, value)
        seen.append((again.size_mm, again.history[-1].size_mm))
        return jnp.asarray(again.size_mm)

    seen = []
    value, _ = jax.value_and_grad(size)(jnp.asarray(0.2))
    assert float(value) == seven.size_mm
    assert isinstance(seven.size_mm, float)
    assert isinstance(seven.history[-1].size_mm, float)
    grad = jax.grad(lambda v: sized(seven, v).history[-1].size_mm)
    assert grad(jnp.asarray(0.2)) == jax.grad(size)(jnp.asarray(0.2))


def test_progress_is_told_numbers_while_a_derivative_is_taken(seven):
    def size(value):
        parameters = Parameters(adhesion=value)
        grow(seven.scene, parameters=parameters, progress=seen.append)
        return value

    seen = []
    jax.grad(size)(jnp.asarray(0.2))
    assert len(seen) == 6
    assert all(type(progress.size_mm) is float for progress in seen)


HOST = {
    "particles": lambda growth: growth.particles()[0].sum(),
    "merged": lambda growth: growth.merged().vertices.sum(),
    "surface": lambda growth: growth.surface()[0].sum(),
    "mesh": lambda growth: growth.mesh().volume,
    "audit": lambda growth: audit(growth).surface.volume,
}


@pytest.mark.parametrize("name", list(HOST))
@pytest.mark.parametrize("leaf", ["position", "vertices"])
def test_what_the_host_makes_of_a_growth_is_refused_under_a_derivative(
    tiny_polyp, name, leaf
):
    def pick(state):
        particles, membrane = state.particles, state.membrane
        return particles.position if leaf == "position" else membrane.vertices

    def number(factor):
        state = eqx.tree_at(pick, tiny_polyp.state, factor * pick(tiny_polyp.state))
        return HOST[name](dataclasses.replace(tiny_polyp, state=state))

    assert np.isfinite(HOST[name](tiny_polyp))
    with pytest.raises(ValueError, match=r"no derivative.*jaxgrow\.shape_metrics"):
        jax.grad(number)(jnp.ones(()))


def test_nothing_is_written_under_a_derivative(tiny_cluster, tmp_path):
    def written(factor):
        position = factor * tiny_cluster.state.particles.position
        state = eqx.tree_at(
            lambda s: s.particles.position, tiny_cluster.state, position
        )
        write_run(dataclasses.replace(tiny_cluster, state=state), tmp_path / "run")
        return factor

    with pytest.raises(ValueError, match=r"no derivative.*jaxgrow\.shape_metrics"):
        jax.grad(written)(jnp.ones(()))
    assert not (tmp_path / "run").exists()


# 64 bits in a context


def test_context_of_64_bits_is_enough(tiny_cluster):
    with jax.enable_x64(False), jax.enable_x64(True):
        again = grow(tiny_cluster.scene)
        shape = shape_metrics(again.state)
        found = relax(again.state.particles)
    assert again.size_mm == tiny_cluster.size_mm
    assert shape.tumour_diameter_mm.dtype == jnp.float64
    assert found.result is Result.CONVERGED


USES = {
    "shape_metrics": shape_metrics,
    "relax": lambda state: relax(state.particles),
    "linear_response": lambda state: linear_response(
        state.particles, forces=Nodes(state.particles.position, None)
    ),
}


@pytest.mark.parametrize("name", list(USES))
def test_state_of_64_bits_is_refused_out_of_their_context(tiny_cluster, name):
    with jax.enable_x64(False), pytest.raises(ValueError, match=r"enable_x64\(True\)"):
        inspect.unwrap(USES[name])(tiny_cluster.state)


def test_host_still_has_the_numbers_out_of_their_context(tiny_cluster):
    wanted, _ = tiny_cluster.particles()
    with jax.enable_x64(False):
        found, _ = tiny_cluster.particles()
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, wanted)
