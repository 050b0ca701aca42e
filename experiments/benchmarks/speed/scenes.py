"""What is measured: dense balls of particles, and a polyp with its contacts."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

import jaxgrow as jg
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.state import Nodes
from jaxgrow.transfer.device import get, put_particles

from .contact import add_spring_forces, contact_forces, ContactLaw
from .lbfgs import relax_lbfgs
from .pairs import set_pair_forces, shape_of


SPACING = 0.96
"""Distance, in r0, of neighbours in a ball before it is relaxed; 0.966 at rest."""

LOOSE = 1.0
"""Spacing at which about 40 neighbours are listed, and none sits at the list's edge."""

JITTER = 0.1


def dense_ball(
    count: int,
    rng: np.random.Generator,
    jitter: float = JITTER,
    spacing: float = SPACING,
) -> Float[np.ndarray, "n 3"]:
    """A ball cut out of a face-centred lattice, every coordinate jittered.

    Particles are in the order of their distance from the centre, as a ball grows. (A
    ball without order takes ten times as many evaluations to relax: it rearranges.)

    Args:
        count: number of particles.
        rng: draws the jitter.
        jitter: standard deviation, in r0.
        spacing: of neighbours, in r0.
    """
    half = int((count / 2) ** (1 / 3)) + 3
    index = np.arange(-half, half + 1)
    lattice = np.stack(np.meshgrid(index, index, index, indexing="ij"), -1)
    lattice = lattice.reshape(-1, 3)
    lattice = lattice[lattice.sum(axis=1) % 2 == 0]
    chosen = np.argsort((lattice**2).sum(axis=1), kind="stable")[:count]
    position = lattice[chosen] * (spacing / np.sqrt(2))
    return position + jitter * rng.normal(size=position.shape)


def resting_ball(count: int) -> Float[np.ndarray, "n 3"]:
    """A dense ball in equilibrium, to 1e-8."""
    start = dense_ball(count, np.random.default_rng(0), 0.0)
    return relax_lbfgs(start, tolerance=1e-8).position


def divided(
    position: Float[np.ndarray, "n 3"], number: int
) -> Float[np.ndarray, "m 3"]:
    """The ball after its inner particle of that number divided; the daughter is last.

    Balls of all sizes are alike at their centres, and so are their divisions.
    """
    parent = int(np.argsort((position**2).sum(axis=1), kind="stable")[number])
    direction = np.random.default_rng(number).normal(size=3)
    offset = 0.5 * direction / np.linalg.norm(direction)
    daughter = position[parent] + offset
    position = np.concatenate([position, daughter[None]])
    position[parent] -= offset
    return position


def particles_of(position: Float[np.ndarray, "n 3"]) -> jg.Particles:
    """Tumour particles on the device, without padding."""
    count = len(position)
    species = np.full(count, int(jg.Species.TUMOUR))
    return put_particles(position, species, np.zeros(count, bool), count)


def runs_of(
    owner: Int[np.ndarray, " p"], item: Int[np.ndarray, " p"], count: int
) -> tuple[Int[np.ndarray, " n+1"], Int[np.ndarray, " p"]]:
    """Pairs as runs: where the items of each owner start, and all items."""
    order = np.argsort(owner, kind="stable")
    start = np.zeros(count + 1, np.int64)
    np.cumsum(np.bincount(owner, minlength=count), out=start[1:])
    return start, item[order].astype(np.int32)


def neighbours_of(
    lists: Lists, alive: Bool[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " m+1"], Int[np.ndarray, " p"]]:
    """A jaxgrow list of neighbours as runs, of the living particles only."""
    entries = get(lists.neighbors.listed).T
    count = len(alive)
    owner, column = np.nonzero((entries < count) & alive[:, None])
    other = entries[owner, column]
    both = alive[other]
    number = np.cumsum(alive) - 1
    return runs_of(number[owner[both]], number[other[both]], int(alive.sum()))


class Scene(NamedTuple):
    """The same forces for jaxgrow and for the numba loop.

    Attributes:
        problem: jaxgrow's.
        lists: its lists.
        position: of the living particles.
        tumour: which of them are.
        neighbours: their list, as runs.
        vertices: living ones; likewise faces, edges and rest lengths.
        contacts: faces listed for each particle, as runs.
        alive: living rows of jaxgrow's particles and vertices.
    """

    problem: Problem
    lists: Lists
    position: Float[np.ndarray, "n 3"]
    tumour: Bool[np.ndarray, " n"]
    neighbours: tuple[Any, Any]
    vertices: Float[np.ndarray, "m 3"]
    faces: Int[np.ndarray, "f 3"]
    edges: Int[np.ndarray, "e 2"]
    rest_length: Float[np.ndarray, " e"]
    contacts: tuple[Any, Any]
    alive: tuple[Bool[np.ndarray, " p"], Bool[np.ndarray, " q"]]

    def of_living(self, forces: Nodes) -> Float[np.ndarray, "k 3"]:
        """Forces of jaxgrow in the rows of the numba loop."""
        rows = zip((forces.particles, forces.vertices), self.alive, strict=True)
        return np.concatenate([get(force)[alive] for force, alive in rows])

    def loop(self, *, smooth: bool) -> Callable[[], Float[np.ndarray, "k 3"]]:
        """All forces by the numba loop: pairs, contact, springs.

        Args:
            smooth: with jaxgrow's smooth minimum instead of the nearest triangle.
        """
        p: jg.Parameters = jax.tree.map(float, self.problem.parameters)
        contact = contact_law(p, smooth=smooth)
        shape = shape_of(p.adhesion, p.smoothing)
        count = len(self.position)
        total = np.zeros((count + len(self.vertices), 3))
        on_particles, on_vertices = total[:count], total[count:]

        def evaluate() -> Float[np.ndarray, "k 3"]:
            set_pair_forces(
                self.position,
                self.tumour,
                *self.neighbours,
                shape,
                p.tumour_stiffness,
                on_particles,
            )
            on_vertices[:] = 0
            contact_forces(
                self.position,
                self.vertices,
                self.faces,
                *self.contacts,
                contact,
                (on_particles, on_vertices),
            )
            add_spring_forces(
                self.vertices,
                self.edges,
                self.rest_length,
                p.spring_stiffness,
                p.pretension,
                on_vertices,
            )
            return total

        return evaluate


def contact_law(parameters: jg.Parameters, *, smooth: bool) -> ContactLaw:
    """The law of the numba loop.

    Args:
        parameters: jaxgrow's.
        smooth: with the smooth minimum over triangles instead of the nearest one.
    """
    return ContactLaw(
        contact_range=float(parameters.contact_range),
        contact_stiffness=float(parameters.contact_stiffness),
        contact_adhesion=float(parameters.contact_adhesion),
        barrier_stiffness=float(parameters.barrier_stiffness),
        barrier_range=float(parameters.barrier_range),
        smoothing=float(parameters.smoothing),
        sharpness=float(parameters.contact_sharpness) if smooth else 0.0,
    )


def scene_of(
    particles: jg.Particles, membrane: jg.Membrane, parameters: jg.Parameters
) -> Scene:
    """A state with the lists of both."""
    problem = Problem.of(particles, membrane, parameters)
    lists = allocate_lists(problem)
    contacts = lists.contacts
    assert contacts is not None
    alive, live = get(particles.alive), get(membrane.vertex_alive)
    number = np.cumsum(alive) - 1
    real = get(contacts.real)
    owner, face = number[get(contacts.particle)[real]], get(contacts.face)[real]
    return Scene(
        problem=problem,
        lists=lists,
        position=get(particles.position)[alive],
        tumour=get(particles.species)[alive] == int(jg.Species.TUMOUR),
        neighbours=neighbours_of(lists, alive),
        vertices=get(membrane.vertices)[live],
        faces=get(membrane.faces)[get(membrane.face_alive)],
        edges=get(membrane.edges)[get(membrane.edge_alive)],
        rest_length=get(membrane.rest_length)[get(membrane.edge_alive)],
        contacts=runs_of(owner, face, int(alive.sum())),
        alive=(alive, live),
    )


def grown_polyp(divisions: int) -> jg.Growth:
    """A polyp on the built-in uterus after that many divisions, its springs reset."""
    wanted = jg.Polyp(divisions=divisions, particle_mm=1.0)
    return jg.grow(jg.Scene(lesion=wanted))


def moved(state: jg.State, size: float) -> jg.State:
    """A state in which everything that is free has moved a little.

    Args:
        state: of a lesion on a membrane.
        size: standard deviation of the change of a coordinate, in r0.
    """
    rng = np.random.default_rng(0)
    assert state.membrane is not None

    def away(at: jax.Array, free: jax.Array) -> jax.Array:
        return at + size * jnp.asarray(rng.normal(size=at.shape)) * free[:, None]

    position = away(state.particles.position, state.particles.free)
    vertices = away(state.membrane.vertices, state.membrane.free)
    return eqx.tree_at(
        lambda s: (s.particles.position, s.membrane.vertices),
        state,
        (position, vertices),
    )


def polyp(divisions: int) -> Scene:
    """A polyp whose particles and vertices are moved by 0.01 r0.

    Forces are then those of a relaxation, not the tolerance of its end.
    """
    growth = grown_polyp(divisions)
    state = moved(growth.state, 0.01)
    assert state.membrane is not None
    return scene_of(state.particles, state.membrane, growth.scene.parameters)
