"""Energies of a user's own: what the guide for contributors says, done."""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrow as jg
from jaxgrow.energy.parameters import Parameters
from jaxgrow.energy.term import energy_of_elements
from jaxgrow.energy.vectors import dot, minus
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.loops import how_terms_run, PrintingWarning, with_loops
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.products import hessian_product
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.equilibrium.relax import relax
from jaxgrow.equilibrium.subproblem import able, around, cut, Mask, none_of
from jaxgrow.runtime.results import Result
from jaxgrow.state import Nodes

from ..sheets import square


class Shell(jg.MembraneTerm):
    """Saint Venant and Kirchhoff's membrane: stretch and shear of the triangles."""

    stiffness: float | jax.Array = 0.7

    name = "shell"
    size = 3
    modulus = "spring_stiffness"
    per = "face"

    def energy(self, x, rest, p):
        one, other = minus(x[1], x[0]), minus(x[2], x[0])
        metric = dot(one, one), dot(one, other), dot(other, other)
        change = [now - before for now, before in zip(metric, rest[:3], strict=True)]
        scale = rest[0] * rest[2] - rest[1] ** 2
        shear = change[0] * change[2] - change[1] ** 2
        trace = rest[2] * change[0] - 2 * rest[1] * change[1] + rest[0] * change[2]
        square = (trace**2 - 2 * scale * shear) / jnp.where(scale > 0, scale, 1) ** 2
        return 0.25 * self.stiffness * rest[3] * square

    def rest(self, x):
        one, other = minus(x[1], x[0]), minus(x[2], x[0])
        metric = dot(one, one), dot(one, other), dot(other, other)
        return *metric, 0.5 * jnp.sqrt(metric[0] * metric[2] - metric[1] ** 2)

    def stencil(self, membrane):
        return membrane.faces, membrane.face_alive


class Weight(jg.Term):
    """Weight of the particles of the tumour."""

    force: float | jax.Array = 0.02

    name = "weight"
    size = 1

    def energy(self, x, rest, p):
        return self.force * rest[0] * x[0][2]

    def elements(self, particles, membrane):
        count = particles.position.shape[0]
        heavy = (particles.species == jg.Species.TUMOUR).astype(
            particles.position.dtype
        )
        return jg.Elements(jnp.arange(count)[:, None], heavy[:, None], particles.alive)


def weight(particles, membrane):
    """The same as a plain function."""
    heavy = (particles.species == jg.Species.TUMOUR) & particles.alive
    return 0.02 * jnp.sum(jnp.where(heavy, particles.position[:, 2], 0))


@pytest.fixture(scope="module")
def sheet():
    rng = np.random.default_rng(4)
    vertices, faces = square(8)
    flat = jg.make_membrane(vertices, faces)
    shell = flat.with_rest({**flat.rest, "shell": Shell().at_rest(flat)})
    return shell.at(flat.vertices + 0.05 * rng.normal(size=flat.vertices.shape))


@pytest.fixture(scope="module")
def cloud():
    """A few particles, the lower ones held."""
    index = np.indices((4, 4, 3)).reshape(3, -1).T
    position = index * [1.0, 1.0, 0.9]
    species = (index.sum(axis=1) % 3 == 0).astype(int)
    return jg.make_particles(position, species=species, held=index[:, 2] == 0)


def pad(membrane, extra=5):
    """The membrane with dead faces of garbage."""
    rng = np.random.default_rng(1)
    faces = rng.integers(0, membrane.vertices.shape[0], (extra, 3))
    rest = membrane.rest["shell"]
    more = jnp.concatenate([rest, jnp.asarray(rng.normal(size=(extra, rest.shape[1])))])
    longer = eqx.tree_at(
        lambda m: (m.faces, m.face_alive),
        membrane,
        (
            jnp.concatenate([membrane.faces, jnp.asarray(faces)]),
            jnp.concatenate([membrane.face_alive, jnp.zeros(extra, bool)]),
        ),
    )
    return longer.with_rest({**membrane.rest, "shell": more})


@pytest.mark.parametrize("change", [lambda m: m, pad])
def test_forces_and_hessian_products_come_from_the_energy_of_one_element(sheet, change):
    problem = Problem(None, change(sheet), Parameters(), terms=(Shell(),))
    lists = Lists(None, None)
    looped = with_loops(problem, lists, products=True)
    assert looped.loops.names == ("shell",)
    assert how_terms_run(looped, lists) == {"shell": "loop"}
    nodes = problem.nodes()
    rng = np.random.default_rng(0)
    way = jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape)), nodes)

    @eqx.filter_jit
    def evaluate(p):
        return p.forces(nodes, lists), hessian_product(p, nodes, lists)(way)

    for found, wanted in zip(evaluate(looped), evaluate(problem), strict=True):
        assert float(jnp.abs(wanted.vertices).max()) > 1e-3
        np.testing.assert_allclose(found.vertices, wanted.vertices, atol=1e-13)

    def energy(vertices):
        elements = Shell().elements(None, sheet)
        return energy_of_elements(Shell(), vertices, elements, Parameters())

    plain = jax.grad(energy)(sheet.vertices)
    np.testing.assert_allclose(evaluate(looped)[0].vertices, -plain, atol=1e-13)


def test_part_of_a_problem_feels_the_same_in_it(sheet):
    problem = Problem(None, sheet, Parameters(), terms=(Shell(),))
    some = np.zeros(sheet.vertices.shape[0], bool)
    some[27] = True
    free = able(problem)
    moving = around(problem, Mask(none_of(problem).particles, some), free, 1.6)
    part = cut(problem, moving, 0.1)
    lists = Lists(None, None)
    whole = problem.forces(problem.nodes(), lists).vertices
    own = part.problem.forces(part.problem.nodes(), lists).vertices
    mine = moving.vertices[part.vertices]
    assert 3 < mine.sum() < len(part.vertices) < sheet.vertices.shape[0]
    np.testing.assert_allclose(
        own[: len(mine)][mine], whole[part.vertices][mine], atol=1e-14
    )


@pytest.mark.parametrize("name", ["springs", "bending", "pair", "contact", "collision"])
def test_name_of_a_term_of_jaxgrow_is_refused(cloud, name):
    # rest data and loops are found by it: the term would have those of the other
    other = type("Other", (Weight,), {"name": name})
    with pytest.raises(ValueError, match=f"named '{name}', as one of jaxgrow's own"):
        relax(cloud, terms=[other()])


def test_two_classes_of_one_name_are_refused_and_two_objects_of_one_are_not(cloud):
    other = type("Other", (Weight,), {"name": Weight.name})
    with pytest.raises(ValueError, match="give each class a name of its own"):
        relax(cloud, terms=[Weight(), other()])
    twice = relax(cloud, terms=[Weight(0.01), Weight(0.01)], tolerance=1e-9)
    once = relax(cloud, terms=[Weight(0.02)], tolerance=1e-9)
    for a, b in zip(twice.state, once.state, strict=True):
        if a is not None:
            np.testing.assert_allclose(a.position, b.position, atol=1e-7)


def test_relaxation_with_a_term_of_ones_own_is_one_loop_and_ends_at_rest(cloud):
    outcome = relax(cloud, terms=[Weight()], tolerance=1e-9)
    assert outcome.result is Result.CONVERGED
    alone = relax(cloud, tolerance=1e-9)
    heavy = np.asarray(cloud.species == jg.Species.TUMOUR) & ~np.asarray(cloud.held)
    lower = outcome.state[0].position - alone.state[0].position
    assert float(lower[heavy, 2].mean()) < -1e-3


def test_plain_function_does_the_same_in_xla(cloud):
    loop = relax(cloud, terms=[Weight()], tolerance=1e-9)
    function = relax(cloud, terms=[weight], tolerance=1e-9)
    assert function.result is Result.CONVERGED
    np.testing.assert_allclose(
        function.state[0].position, loop.state[0].position, atol=1e-7
    )


def test_derivative_in_a_parameter_of_ones_own_is_that_of_differences(cloud):
    force, step = jnp.asarray(0.02), 1e-5
    there = relax(cloud, terms=[Weight(force)], tolerance=1e-12).state[0]

    def height(force):
        state = relax(there, terms=[Weight(force)], tolerance=1e-12).state
        return jnp.sum(state[0].position[:, 2])

    slope = jax.grad(height)(force)
    wanted = (height(force + step) - height(force - step)) / (2 * step)
    np.testing.assert_allclose(slope, wanted, rtol=1e-5)


def test_linear_response_knows_the_term(sheet):
    stiff = relax(None, sheet, terms=[Shell(50.0)], tolerance=1e-10)
    membrane = stiff.state[1]
    push = jnp.zeros_like(membrane.vertices).at[27, 0].set(1e-3)
    with_shell, without = (
        jg.linear_response(None, membrane, forces=Nodes(None, push), terms=terms)
        for terms in ([Shell(50.0)], ())
    )
    moved = float(jnp.abs(with_shell.displacement.vertices).max())
    assert moved < 0.2 * float(jnp.abs(without.displacement.vertices).max())


def test_local_relaxation_refuses_what_acts_nobody_knows_how_far(cloud):
    with pytest.raises(ValueError, match="it is not known how far they act"):
        relax(cloud, terms=[weight], method="local")


class Unprintable(Weight):
    """Weight by way of a primitive that the printer does not know."""

    name = "unprintable"

    def energy(self, x, rest, p):
        return self.force * rest[0] * jnp.sum(jnp.stack([x[0][2], 0.0 * x[0][0]]))


def test_term_that_cannot_be_printed_is_left_to_xla_and_said_once_by_name(cloud):
    with pytest.warns(PrintingWarning, match="energy term 'unprintable' uses"):
        slow = relax(cloud, terms=[Unprintable()], tolerance=1e-9)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        relax(cloud, terms=[Unprintable()], tolerance=1e-9)
    loop = relax(cloud, terms=[Weight()], tolerance=1e-9)
    np.testing.assert_allclose(
        slow.state[0].position, loop.state[0].position, atol=1e-7
    )


def test_growth_feels_terms_of_ones_own(tiny_polyp):
    pulled = jg.grow(tiny_polyp.scene, terms=[Weight(0.02)])
    assert pulled.result.success
    vertices = [np.asarray(g.state.membrane.vertices) for g in (pulled, tiny_polyp)]
    assert not np.array_equal(*vertices)
    again = jg.grow(tiny_polyp.scene, events=pulled.events, terms=[Weight(0.02)])
    np.testing.assert_array_equal(
        again.state.membrane.vertices, pulled.state.membrane.vertices
    )


def test_lists_of_a_scene_are_allocated_without_terms(cloud):
    problem = Problem.of(cloud, None, extra=[Weight()])
    assert allocate_lists(problem).neighbors is not None
