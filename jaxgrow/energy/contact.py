r"""Energy of the contact between particles and membrane (paper §4).

In "Adapt surface" all particles act on the surface by their exact distance to it, "not
just to the particles on the surface". With :math:`u_i = d_i / r_s`, the distance of
particle i in contact ranges,

.. math::
    E = \sum_i r_s \left( c\, U_{\alpha_c}(u_i) + \kappa\, b(u_i) \right), \qquad
    b(u) = -(u - \hat u)^2 \ln(u / \hat u) \;\; (u < \hat u), \; 0 \text{ beyond}

with U of `A2`. The A2 force is bounded, so it alone cannot keep a particle in; the
logarithmic barrier b does (with the displacement bound of `jaxgrow.equilibrium`).

The distance is the smooth minimum of `jaxgrow.energy.smooth_minimum` over the
triangles within the reach of 3/2 contact ranges.
"""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.energy.a2 import A2, CUTOFF
from jaxgrow.energy.distance import triangle_distance
from jaxgrow.energy.parameters import Parameters
from jaxgrow.energy.points_in_spheres import count_inside, list_inside, Spheres
from jaxgrow.energy.smooth_minimum import smooth_minimum
from jaxgrow.energy.term import values_of
from jaxgrow.energy.vectors import split
from jaxgrow.numerics.bitmask import list_true
from jaxgrow.numerics.guards import safe_norm, smallest_distance
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Membrane, Particles


def barrier(
    u: Float[Array, "*n"], margin: Float[Array, "*n"] | Scalar
) -> Float[Array, "*n"]:
    """Return the logarithmic barrier b(u), twice differentiable at its onset.

    It is infinite at 0.

    Args:
        u: distances.
        margin: the onset û, in the same unit; 0 for none.
    """
    inside = u < margin
    safe = jnp.where(inside, jnp.maximum(u, smallest_distance(u.dtype)), 1)
    edge = jnp.where(inside, margin, 1)
    return jnp.where(inside, -((safe - edge) ** 2) * jnp.log(safe / edge), 0)


class Contact(eqx.Module):
    """Contact of a particle with the surface, by its smooth distance.

    Class attributes:
        name: of the term.
        parameters: the fields of `Parameters` that it uses.
    """

    name: ClassVar[str] = "contact"
    parameters: ClassVar[tuple[str, ...]] = (
        *("contact_range", "contact_stiffness", "contact_adhesion", "smoothing"),
        *("barrier_stiffness", "barrier_range"),
    )

    def energy(self, u: Array, p: Any) -> Array:
        """Return the energy of one particle, in F(0) r0.

        Args:
            u: its smooth distance, in contact ranges.
            p: has the `parameters` by name.
        """
        law = A2(p.contact_adhesion, p.smoothing)
        each = p.contact_stiffness * law.energy(u)
        each += p.barrier_stiffness * barrier(u, p.barrier_range)
        return p.contact_range * each


CONTACT = Contact()


class Contacts(eqx.Module):
    """Contact list: pairs of particle and triangle that may be within reach.

    Attributes:
        particle: index of the particle of each pair, ascending.
        face: index of its triangle.
        corners: vertices of that triangle.
        real: False for padding.
        reference: particle positions and vertices when the list was made.
        overflow: whether its capacity was exceeded; then it must not be used.
    """

    particle: Int[Array, " p"]
    face: Int[Array, " p"]
    corners: Int[Array, "3 p"]
    real: Bool[Array, " p"]
    reference: tuple[Float[Array, "n 3"], Float[Array, "m 3"]]
    overflow: Bool[Array, ""]

    def moved(
        self, position: Float[Array, "n 3"], vertices: Float[Array, "m 3"]
    ) -> Float[Array, ""]:
        """Return the farthest moves of a particle and a vertex, summed, in r0."""
        particles, corners = self.reference
        return jnp.max(safe_norm(position - particles)) + jnp.max(
            safe_norm(vertices - corners)
        )


def reach(parameters: Parameters) -> Scalar:
    """Return the cutoff of contact, in r0."""
    return CUTOFF * parameters.contact_range


def _spheres(membrane: Membrane, radius: Scalar) -> Spheres:
    """Return spheres that hold every point within `radius` of a triangle."""
    corners = membrane.vertices[membrane.faces]
    centre = jnp.mean(corners, axis=1)
    size = jnp.max(safe_norm(corners - centre[:, None, :]), axis=1)
    return Spheres(centre, jnp.where(membrane.face_alive, radius + size, 0))


SPHERES_PER_CONTACT = 3
"""Largest ratio of candidates (by the spheres around triangles) to contacts."""


def count_contacts(
    particles: Particles, membrane: Membrane, radius: Scalar
) -> Int[Array, ""]:
    """Count the candidates that the spheres leave: an upper bound of contacts."""
    spheres = _spheres(membrane, radius)
    return count_inside(particles.position, particles.alive, spheres)


def list_contacts(
    particles: Particles, membrane: Membrane, radius: Scalar, capacity: int
) -> Contacts:
    """List all pairs closer than `radius` (in r0), ordered by particle.

    Bounding spheres of the triangles give the candidates, exact distances decide.
    """
    size = SPHERES_PER_CONTACT * capacity
    spheres = _spheres(membrane, radius)
    found = list_inside(particles.position, particles.alive, spheres, size)
    candidates = Contacts(
        particle=found.point,
        face=found.sphere,
        corners=membrane.faces.T[:, found.sphere],
        real=jnp.arange(size, dtype=jnp.int32) < found.total,
        reference=(particles.position, membrane.vertices),
        overflow=found.total > size,
    )
    return narrow_contacts(candidates, particles, membrane, radius, capacity)


def narrow_contacts(
    wide: Contacts,
    particles: Particles,
    membrane: Membrane,
    radius: Scalar,
    capacity: int,
) -> Contacts:
    """Filter a list to the pairs closer than `radius` (in r0), in order."""
    near = contact_distances(particles, membrane, wide) < radius
    chosen, count = list_true(near, capacity)
    real = jnp.arange(capacity, dtype=jnp.int32) < count
    last = particles.position.shape[0] - 1
    return Contacts(
        particle=jnp.where(real, wide.particle[chosen], last),
        face=wide.face[chosen],
        corners=wide.corners[:, chosen],
        real=real,
        reference=(particles.position, membrane.vertices),
        overflow=(count > capacity) | wide.overflow,
    )


def contact_distances(
    particles: Particles, membrane: Membrane, contacts: Contacts
) -> Float[Array, " p"]:
    """Return exact distances of listed pairs, in r0; infinite for padding."""
    position, vertices = split(particles.position), split(membrane.vertices)
    point = tuple(column[contacts.particle] for column in position)
    a, b, c = (tuple(column[at] for column in vertices) for at in contacts.corners)
    distance = triangle_distance(point, a, b, c)
    return jnp.where(contacts.real, distance, jnp.inf)


def smooth_distance(
    distance: Float[Array, " p"],
    contacts: Contacts,
    count: int,
    parameters: Parameters,
) -> Float[Array, " n"]:
    """Return the smooth minimum of distances per particle, in contact ranges.

    Args:
        distance: exact distance of every pair, in r0, infinite for padding.
        contacts: the list of the pairs.
        count: number of particles n.
        parameters: contact range and sharpness are used.

    Returns:
        u as in the module's formula; the reach 3/2 where no triangle is nearer.
    """
    u = jnp.where(contacts.real, distance, CUTOFF) / parameters.contact_range
    return smooth_minimum(
        u,
        contacts.particle,
        contacts.real,
        count,
        sharpness=parameters.contact_sharpness,
        reach=CUTOFF,
    )


def contact_energy(
    particles: Particles,
    membrane: Membrane,
    contacts: Contacts,
    parameters: Parameters,
    distance: Float[Array, " p"] | None = None,
) -> Float[Array, ""]:
    """Return the contact energy, in F(0) r0.

    Args:
        particles: dead ones do not count.
        membrane: the faces of which are listed.
        contacts: pairs within reach.
        parameters: of the contact, its barrier, and the smoothing.
        distance: of every pair, see `contact_distances`, if it is known.
    """
    if distance is None:
        distance = contact_distances(particles, membrane, contacts)
    count = particles.position.shape[0]
    u = smooth_distance(distance, contacts, count, parameters)
    each = CONTACT.energy(u, values_of(CONTACT, parameters))
    return jnp.sum(jnp.where(particles.alive, each, 0))


def clearances(
    distance: Float[Array, " p"],
    contacts: Contacts,
    membrane: Membrane,
    count: int,
) -> tuple[Float[Array, " n"], Float[Array, " m"]]:
    """Return the least distance of each particle, and of each vertex.

    The clearance of a vertex is that of its triangles: if no particle and no vertex
    moves by half of its clearance, no particle meets a triangle anywhere on the way.

    Args:
        distance: exact distance of every listed pair, in r0.
        contacts: the list of the pairs.
        membrane: the faces of which are listed.
        count: number of particles n.

    Returns:
        Both in r0, infinite where nothing is listed.
    """
    of_particle = jax.ops.segment_min(
        distance, contacts.particle, count, indices_are_sorted=True
    )
    of_vertex = jnp.full(membrane.vertices.shape[0], jnp.inf, distance.dtype)
    return of_particle, of_vertex.at[contacts.corners].min(distance[None, :])
