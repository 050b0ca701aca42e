"""A small scene of particles under a membrane, for all energy terms."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.area import Area
from jaxgrow.energy.bending import Bending
from jaxgrow.energy.collision import collision_energy, Collisions
from jaxgrow.energy.contact import contact_energy, list_contacts, reach
from jaxgrow.energy.finite_elements import FlowingSheet, Kirchhoff, NeoHookean
from jaxgrow.energy.healthy import HealthySprings
from jaxgrow.energy.pair import pair_energy
from jaxgrow.energy.parameters import Parameters
from jaxgrow.energy.springs import Springs
from jaxgrow.energy.tension import Tension
from jaxgrow.energy.term import energy_of_elements
from jaxgrow.state import Membrane, Nodes, Particles
from jaxgrow.transfer.constructors import make_membrane, make_particles

from ..quick_jit import quick_jit


PARAMETERS = Parameters(
    tumour_stiffness=2.0,
    spring_stiffness=0.3,
    pretension=0.1,
    contact_adhesion=1.0,
    collision_range=1.5,
    mixed_adhesion=0.3,
    bending_stiffness=0.2,
    area_modulus=0.4,
    surface_tension=0.5,
    membrane_modulus=0.8,
    kirchhoff_modulus=0.7,
    flowing_modulus=0.9,
    healthy_stiffness=0.6,
)
CONTACTS = 512  # capacity of the lists of contacts
SIDE = 5  # vertices along a side of the membrane
COUNT = 24  # particles


def dense_list(count):
    """Everybody is everybody's neighbour, neighbour-major."""
    index = np.arange(count)
    return jnp.asarray((index[None, :] + index[1:, None]) % count)


def grid(columns, rows=None):
    """Vertices, faces and edges of a flat grid, square if not told; normals up."""
    y, x = np.mgrid[: rows or columns, :columns]
    vertices = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(float)
    index = np.arange(x.size).reshape(x.shape)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0)
    return vertices, faces, edges


@dataclasses.dataclass(frozen=True)
class Scene:
    particles: Particles
    membrane: Membrane


@pytest.fixture(scope="session")
def scene():
    return random_scene()


@pytest.fixture(scope="session")
def small():
    """A smaller scene, which padding can fill up to the other."""
    return random_scene(rows=4, count=15, seed=3)


def random_scene(rows=SIDE, count=COUNT, seed=1):
    """24 random particles below a bumpy grid of 25 vertices; nothing is padding."""
    rng = np.random.default_rng(seed)
    vertices, faces, edges = grid(SIDE, rows)
    vertices += 0.2 * rng.normal(size=vertices.shape)
    position = rng.uniform([0, 0, -1.5], [SIDE - 1, rows - 1, -0.1], (count, 3))
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    particles = make_particles(position, species=rng.integers(0, 2, count))
    rest_length = length * rng.uniform(0.7, 1.3, len(edges))
    membrane = make_membrane(vertices, faces, pinned=False, rest_length=rest_length)
    return Scene(particles, partly_healthy(membrane, rng))


def partly_healthy(membrane, rng):
    """The membrane with another reference, random marks, and areas not at rest."""
    membrane = dataclasses.replace(
        membrane,
        reference=membrane.vertices + 0.1 * rng.normal(size=membrane.vertices.shape),
        hyperplasia=jnp.asarray(rng.uniform(0, 0.4, len(membrane.vertices))),
    )
    area = Area().at_rest(membrane) * rng.uniform(0.7, 1.3, (len(membrane.faces), 1))
    healthy = HealthySprings().at_rest(membrane)
    known = {**membrane.rest, "area": area, "healthy": healthy}
    return sheets_at_rest(membrane.with_rest(known))


def sheets_at_rest(membrane):
    """The membrane with sheets at rest in its reference."""
    there = membrane.at(membrane.reference)
    sheets = (NeoHookean(), Kirchhoff(), FlowingSheet())
    rest = {term.name: term.at_rest(there) for term in sheets}
    return membrane.with_rest({**membrane.rest, **rest})


def _pair(particles, membrane, parameters):
    return pair_energy(particles, dense_list(particles.position.shape[0]), parameters)


def _elements(term):
    def energy(particles, membrane, parameters):
        nodes = jnp.concatenate([particles.position, membrane.vertices])
        elements = term.elements(particles, membrane)
        return energy_of_elements(term, nodes, elements, parameters)

    return energy


def _contact(particles, membrane, parameters):
    contacts = list_contacts(particles, membrane, reach(parameters), CONTACTS)
    contacts = jax.lax.stop_gradient(contacts)
    energy = contact_energy(particles, membrane, contacts, parameters)
    return jnp.where(contacts.overflow, jnp.nan, energy)


def all_pairs(membrane, margin=0.3):
    """Every vertex with every triangle and every edge with every edge, all apart."""
    n, faces, edges = membrane.vertices.shape[0], membrane.faces, membrane.edges
    vertex, face = (x.ravel() for x in jnp.indices((n, faces.shape[0])))
    one, other = jnp.triu_indices(edges.shape[0], 1)
    four = jnp.concatenate([edges[one], edges[other]], axis=1)
    strange = ~jnp.any(faces[face] == vertex[:, None], axis=1)
    strange &= membrane.vertex_alive[vertex] & membrane.face_alive[face]
    foreign = ~jnp.any(four[:, :2, None] == four[:, None, 2:], axis=(1, 2))
    foreign &= membrane.edge_alive[one] & membrane.edge_alive[other]
    dtype = membrane.vertices.dtype
    return Collisions(
        still=jnp.zeros((0, 3), dtype),
        vertex=vertex,
        corners=faces[face],
        apart=strange,
        vertex_margin=jnp.where(strange, margin, 0).astype(dtype),
        edges=four,
        edge_margin=jnp.where(foreign, margin, 0).astype(dtype),
        reference=membrane.vertices,
        skin=jnp.asarray(0.4, dtype),
        stale=jnp.zeros((), bool),
        full=jnp.zeros((), bool),
    )


def _collision(particles, membrane, parameters):
    pairs = jax.lax.stop_gradient(all_pairs(membrane))
    return collision_energy(membrane, pairs, parameters)


TERMS = {
    "pair": _pair,
    "springs": _elements(Springs()),
    "bending": _elements(Bending()),
    "area": _elements(Area()),
    "tension": _elements(Tension()),
    "neo_hookean": _elements(NeoHookean()),
    "kirchhoff": _elements(Kirchhoff()),
    "flowing": _elements(FlowingSheet()),
    "healthy": _elements(HealthySprings()),
    "contact": _contact,
    "collision": _collision,
}


@pytest.fixture(scope="session", params=list(TERMS))
def term(request):
    """Energy and its gradient in all nodes, as one compiled function of a scene."""

    @quick_jit
    def evaluate(scene_particles, scene_membrane):
        def energy(nodes):
            particles = eqx.tree_at(
                lambda p: p.position, scene_particles, nodes.particles
            )
            membrane = eqx.tree_at(lambda m: m.vertices, scene_membrane, nodes.vertices)
            return TERMS[request.param](particles, membrane, PARAMETERS)

        nodes = Nodes(scene_particles.position, scene_membrane.vertices)
        return jax.value_and_grad(energy)(nodes)

    return evaluate
