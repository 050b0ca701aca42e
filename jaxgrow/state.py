"""State of a growth: immutable pytrees of fixed capacity, with masks.

Lengths are in r0 and coordinates relative to the site of the lesion. A slot that is
not alive is padding: it changes no energy, force or gradient.
"""

import enum
from dataclasses import fields
from typing import Any, TypeVar

import equinox as eqx
import jax
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int


class Species(enum.IntEnum):
    """Species of a particle."""

    TISSUE = 0
    TUMOUR = 1


ModuleT = TypeVar("ModuleT", bound=eqx.Module)


def replaced(module: ModuleT, **changes: Any) -> ModuleT:
    """Return a copy of a module with some fields replaced.

    As `dataclasses.replace`, but without the constructor, which takes a quarter of a
    millisecond, as long as many relaxation steps of a small system.
    """
    copy = object.__new__(type(module))
    for field in fields(module):
        value = (
            changes[field.name]
            if field.name in changes
            else getattr(module, field.name)
        )
        object.__setattr__(copy, field.name, value)
    return copy


class Particles(eqx.Module):
    """Particles of tissue and tumour.

    Attributes:
        position: in r0.
        species: a `Species` per particle.
        alive: False for padding.
        held: True for particles that never move (the bottom and sides of a patch).
    """

    position: Float[Array, "n 3"]
    species: Int[Array, " n"]
    alive: Bool[Array, " n"]
    held: Bool[Array, " n"]

    @property
    def free(self) -> Bool[Array, " n"]:
        """Particles that equilibrium may move."""
        return self.alive & ~self.held

    def at(self, position: Float[Array, "n 3"]) -> "Particles":
        """Return the same particles at other positions."""
        return replaced(self, position=position)


class Membrane(eqx.Module):
    """Triangulated surface of the tissue; its normals point out of it.

    Attributes:
        vertices: in r0.
        faces: vertices of each triangle, counter-clockwise seen from the lumen.
        edges: vertices of each edge, every edge once.
        opposite: the third vertices of the triangles at each edge: of the one that has
            the edge in its direction, and of the other; -1 where there is none.
        rest: rest data of each term of the elasticity that the membrane has, by its
            name (see `jaxgrow.energy.term.MembraneTerm`).
        reference: position, in r0, of each vertex before it was displaced; healthy
            tissue keeps its rest data there.
        hyperplasia: share of each vertex that is hyperplastic, 0 to 1. Hyperplastic
            tissue gets new rest data after every division (see
            `jaxgrow.energy.term.MembraneTerm.at_rest`); 1 everywhere is the paper's
            rule.
        vertex_alive: False for padding; `face_alive` and `edge_alive` too.
        pinned: True for the vertices of the rim, which never move.
        source: the vertex that emits a polyp's particles; -1 if there is none.
    """

    vertices: Float[Array, "m 3"]
    faces: Int[Array, "f 3"]
    edges: Int[Array, "e 2"]
    opposite: Int[Array, "e 2"]
    rest: dict[str, Float[Array, "k _"]]
    reference: Float[Array, "m 3"]
    hyperplasia: Float[Array, " m"]
    vertex_alive: Bool[Array, " m"]
    face_alive: Bool[Array, " f"]
    edge_alive: Bool[Array, " e"]
    pinned: Bool[Array, " m"]
    source: Int[Array, ""]

    @property
    def free(self) -> Bool[Array, " m"]:
        """Vertices that equilibrium may move."""
        return self.vertex_alive & ~self.pinned

    @property
    def rest_length(self) -> Float[Array, " e"]:
        """Length at rest of the spring on each edge, in r0."""
        return self.rest["springs"][:, 0]

    def with_rest_length(self, length: Float[Array, " e"]) -> "Membrane":
        """Return the same membrane with springs of other lengths at rest, in r0."""
        return self.with_rest({**self.rest, "springs": length[:, None]})

    def with_rest(self, rest: dict[str, Float[Array, "k _"]]) -> "Membrane":
        """Return the same membrane with other rest data."""
        return replaced(self, rest=rest)

    def at(self, vertices: Float[Array, "m 3"]) -> "Membrane":
        """Return the same membrane with its vertices at other positions."""
        return replaced(self, vertices=vertices)


class FormerSurface(eqx.Module):
    """Surface of the patch before growth, the reference of heights.

    Attributes:
        vertices: in r0.
        faces: vertices of each triangle; normals into the lumen.
    """

    vertices: Float[Array, "k 3"]
    faces: Int[Array, "g 3"]


class Frame(eqx.Module):
    """Position of the patch in the organ, and its unit of length in mm.

    Attributes:
        origin: the site of the lesion in the organ's coordinates, in mm.
        axis: unit normal of the former surface at the site, into the lumen.
        particle_mm: r0 in mm.
        former: the patch before growth; None for a free cluster.
    """

    origin: Float[Array, "3"]
    axis: Float[Array, "3"]
    particle_mm: Float[Array, ""]
    former: FormerSurface | None


class State(eqx.Module):
    """Particles, membrane (None for a free cluster) and frame of a growth."""

    particles: Particles
    membrane: Membrane | None
    frame: Frame

    def __repr__(self) -> str:
        """Count particles, vertices and faces in one line, where there are values."""
        for leaf in jax.tree.leaves(self):
            if isinstance(leaf, Tracer) or not eqx.is_array(leaf):
                return super().__repr__()
        parts = [f"{int(self.particles.alive.sum())} particles"]
        if self.membrane is not None:
            parts.append(f"{int(self.membrane.vertex_alive.sum())} vertices")
            parts.append(f"{int(self.membrane.face_alive.sum())} faces")
        return f"State({', '.join(parts)})"


class Nodes(eqx.Module):
    """Array per degree of freedom: positions, forces or displacements.

    Attributes:
        particles: one row a particle, or None for a membrane alone.
        vertices: one row a membrane vertex, or None for particles alone.
    """

    particles: Float[Array, "n *_"] | None
    vertices: Float[Array, "m *_"] | None
