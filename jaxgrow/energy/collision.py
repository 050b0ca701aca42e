r"""Energy of the membrane's collisions with itself and with static walls.

"Collisions of the pathology's surface with the uterine cavity" are handled by "a purely
repulsive force profile" (paper §5): A2 without its attractive branch, against the other
wall of the organ, its other static parts, and the membrane itself. With
:math:`u = d / r_c` in collision ranges,

.. math::
    E = r_c \Big( c \sum_v U_0(u_v)
        + \kappa \sum_{(v, t)} b(u_{vt})
        + \kappa \sum_{(e, e')} m_{ee'}\, b(u_{ee'}) \Big).

- :math:`u_v` is the smooth minimum over the triangles t near vertex v that are *apart*
  from it: farther along the surface than `LOCAL` ranges. Neighbours in the surface do
  not repel each other.
- The barrier b of all listed pairs, vertices against triangles and edges against edges,
  keeps sheets from going through each other (cf. incremental potential contact, Li et
  al., ACM Trans. Graph. 39, 2020). Of pairs that are apart it sets in at the barrier's
  range, of neighbours at half of the distance that they had when the springs were last
  reset, so that a surface at rest has no such force.
- The distance of edges has a kink where they are parallel; there m fades their term out
  (:math:`m = s (2 - s)` for :math:`s = \sin^2 \angle / 10^{-3} < 1`), as ends against
  triangles cover that case.

Pairs that share a vertex are left out. Where two triangles that share vertices begin to
intersect, a vertex meets a triangle, or an edge an edge, without a common vertex, so no
intersection is missed.
"""

from typing import Any, ClassVar, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.energy.a2 import A2
from jaxgrow.energy.contact import barrier
from jaxgrow.energy.distance import (
    point_triangle_distance,
    segment_distance,
    split_corners,
)
from jaxgrow.energy.parameters import Parameters
from jaxgrow.energy.smooth_minimum import smooth_minimum
from jaxgrow.energy.term import values_of
from jaxgrow.energy.vectors import cross, dot, minus
from jaxgrow.numerics.bitmask import list_true
from jaxgrow.numerics.guards import farthest_two
from jaxgrow.runtime.types import Columns, Scalar
from jaxgrow.state import Membrane


LOCAL = 3.0
"""Distance along the surface, in collision ranges, up to which it is one sheet."""

PARALLEL = 1e-3
"""Squared sine of the angle below which two edges count as nearly parallel."""


PairDistances: TypeAlias = tuple[Float[Array, " p"], Float[Array, " q"]]
"""Distances of all vertex-triangle pairs, and of all edge-edge pairs, in r0."""


class Collision(eqx.Module):
    """Repulsion of parts of the surface that must not pass through each other.

    Class attributes:
        name: of the term.
        parameters: the fields of `Parameters` that it uses.
    """

    name: ClassVar[str] = "collision"
    parameters: ClassVar[tuple[str, ...]] = (
        *("collision_range", "collision_stiffness", "smoothing", "barrier_stiffness"),
    )

    def energy(self, u: Array, p: Any) -> Array:
        """Return the repulsion of one vertex, in F(0) r0.

        Args:
            u: smooth distance to the triangles that are apart, in collision ranges.
            p: has the `parameters` by name.
        """
        near = u < 1
        value = A2(0.0, p.smoothing).energy(jnp.where(near, u, 1))
        return p.collision_range * p.collision_stiffness * jnp.where(near, value, 0)

    def wall(self, distance: Array, margin: Array, p: Any) -> Array:
        """Return the barrier of a vertex and a triangle, in F(0) r0.

        Args:
            distance: of the two, in r0.
            margin: where it sets in, in collision ranges.
            p: has the `parameters` by name.
        """
        u = distance / p.collision_range
        return p.collision_range * p.barrier_stiffness * barrier(u, margin)

    def wall_of_edges(
        self, x: tuple[Columns, ...], distance: Array, margin: Array, p: Any
    ) -> Array:
        """Return the barrier of two edges, in F(0) r0.

        Args:
            x: ends of the one, then of the other, in r0.
            distance: of the two, in r0.
            margin: where it sets in, in collision ranges.
            p: has the `parameters` by name.
        """
        return _skewness(x) * self.wall(distance, margin, p)


COLLISION = Collision()


def _skewness(x: tuple[Columns, ...]) -> Array:
    """Return the factor m: 1, less for nearly parallel edges, 0 for parallel."""
    one, other = minus(x[1], x[0]), minus(x[3], x[2])
    normal = cross(one, other)
    scale = dot(one, one) * dot(other, other)
    sine = dot(normal, normal) / jnp.where(scale > 0, scale, 1)
    share = jnp.minimum(sine / PARALLEL, 1)
    return share * (2 - share)


class Collisions(eqx.Module):
    """Collision list: parts of the surface that may be within reach.

    Vertices are numbered through: first the membrane's slots, then the static ones.

    Attributes:
        still: static vertices, in r0.
        vertex: of each pair of a vertex and a triangle, ascending.
        corners: of its triangle.
        apart: whether the two are far from each other along the surface.
        vertex_margin: where the barrier of the pair sets in, in collision ranges; 0 for
            padding.
        edges: the four ends of each pair of edges.
        edge_margin: where the barrier of the pair of edges sets in, as `vertex_margin`.
        reference: vertices of the membrane when the list was made.
        skin: the list is valid until the farthest moves of two vertices exceed it
            together, in r0.
        stale: whether they have.
        full: whether its capacity was exceeded; then it must not be used.
    """

    still: Float[Array, "s 3"]
    vertex: Int[Array, " p"]
    corners: Int[Array, "p 3"]
    apart: Bool[Array, " p"]
    vertex_margin: Float[Array, " p"]
    edges: Int[Array, "q 4"]
    edge_margin: Float[Array, " q"]
    reference: Float[Array, "m 3"]
    skin: Float[Array, ""]
    stale: Bool[Array, ""]
    full: Bool[Array, ""]

    def checked(self, vertices: Float[Array, "m 3"]) -> "Collisions":
        """Return the same list with `stale` for these vertices."""
        shift = farthest_two(vertices - self.reference)
        return eqx.tree_at(lambda c: c.stale, self, ~(shift <= self.skin))

    def distances(self, membrane: Membrane) -> PairDistances:
        """Return exact distances of all pairs, in r0; infinite for padding."""
        points = jnp.concatenate([membrane.vertices, self.still])
        of_vertex = point_triangle_distance(points[self.vertex], points[self.corners])
        of_edge = segment_distance(*split_corners(points[self.edges]))
        return (
            jnp.where(self.vertex_margin > 0, of_vertex, jnp.inf),
            jnp.where(self.edge_margin > 0, of_edge, jnp.inf),
        )


def narrow_collisions(
    wide: Collisions,
    membrane: Membrane,
    parameters: Parameters,
    *,
    least: Scalar,
    skin: Scalar,
    room: int,
) -> Collisions:
    """Filter a collision list to the pairs within a shorter reach.

    They are those that matter until two vertices have moved by a skin together.

    Args:
        wide: a valid list.
        membrane: at its present position.
        parameters: give the ranges.
        least: distance, in r0, up to which pairs are listed in any case.
        skin: extra distance, in r0.
        room: capacity for vertex-triangle pairs; twice as much for edge-edge pairs.
    """
    scale = parameters.collision_range
    of_vertex, of_edge = wide.distances(membrane)
    force = jnp.where(wide.apart, scale, scale * wide.vertex_margin)
    near = of_vertex < jnp.maximum(force, least) + skin
    chosen, count = list_true(near, room)
    real = jnp.arange(room, dtype=jnp.int32) < count
    near_edge = of_edge < jnp.maximum(scale * wide.edge_margin, least) + skin
    of_edges, edge_count = list_true(near_edge, 2 * room)
    real_edge = jnp.arange(2 * room, dtype=jnp.int32) < edge_count
    last = membrane.vertices.shape[0] + wide.still.shape[0] - 1
    return Collisions(
        still=wide.still,
        vertex=jnp.where(real, wide.vertex[chosen], last),
        corners=wide.corners[chosen],
        apart=wide.apart[chosen] & real,
        vertex_margin=jnp.where(real, wide.vertex_margin[chosen], 0),
        edges=wide.edges[of_edges],
        edge_margin=jnp.where(real_edge, wide.edge_margin[of_edges], 0),
        reference=membrane.vertices,
        skin=jnp.asarray(skin, wide.skin.dtype),
        stale=jnp.zeros((), bool),
        full=wide.full | (count > room) | (edge_count > 2 * room),
    )


def collision_energy(
    membrane: Membrane,
    collisions: Collisions,
    parameters: Parameters,
    distances: PairDistances | None = None,
) -> Float[Array, ""]:
    """Return the collision energy, in F(0) r0.

    Args:
        membrane: at its present position.
        collisions: pairs within reach.
        parameters: of collisions, their barrier, and the smoothing.
        distances: of all pairs, see `Collisions.distances`, if they are known.
    """
    p, scale = values_of(COLLISION, parameters), parameters.collision_range
    vertex, edge = collisions.distances(membrane) if distances is None else distances
    vertex = jnp.where(jnp.isfinite(vertex), vertex, scale)
    count = membrane.vertices.shape[0] + collisions.still.shape[0]
    nearest = smooth_minimum(
        vertex / scale,
        collisions.vertex,
        collisions.apart,
        count,
        sharpness=parameters.contact_sharpness,
        reach=1.0,
    )
    total = jnp.sum(COLLISION.energy(nearest, p))
    margin = _margin(collisions.vertex_margin, parameters)
    total += jnp.sum(COLLISION.wall(vertex, margin, p))
    points = jnp.concatenate([membrane.vertices, collisions.still])
    ends = split_corners(points[collisions.edges])
    edge = jnp.where(jnp.isfinite(edge), edge, scale)
    margin = _margin(collisions.edge_margin, parameters)
    return total + jnp.sum(COLLISION.wall_of_edges(ends, edge, margin, p))


def _margin(listed: Float[Array, " p"], parameters: Parameters) -> Float[Array, " p"]:
    """Return the listed margins, differentiable in the parameters.

    A margin is the barrier's range, or a length at rest in collision ranges.
    """
    reach = jnp.asarray(parameters.barrier_range, listed.dtype)
    whole = listed == jax.lax.stop_gradient(reach)
    size = jnp.asarray(parameters.collision_range, listed.dtype)
    shrunk = listed * (jax.lax.stop_gradient(size) / size)
    return jnp.where(whole, reach, shrunk)


def collision_clearances(
    membrane: Membrane,
    collisions: Collisions,
    distances: PairDistances | None = None,
) -> Float[Array, " m"]:
    """Return each vertex's clearance, by its listed triangles and edges.

    If no vertex moves by half of its clearance, no listed pair meets on the way.

    Args:
        membrane: at its present position.
        collisions: pairs within reach.
        distances: of all pairs, see `Collisions.distances`, if they are known.

    Returns:
        The clearances in r0, infinite where nothing is listed.
    """
    vertex, edge = collisions.distances(membrane) if distances is None else distances
    total = membrane.vertices.shape[0]
    clear = jnp.full(total, jnp.inf, vertex.dtype)
    clear = clear.at[collisions.vertex].min(vertex, mode="drop")
    clear = clear.at[collisions.corners].min(vertex[:, None], mode="drop")
    return clear.at[collisions.edges].min(edge[:, None], mode="drop")
