r"""Focal hyperplasia: the patch of endometrium that grows.

Polyps "originate as focal hyperplasias of the endometrium" (paper §1). The paper's rule
marks one vertex; a focus of radius R_f is the patch

.. math::
    m_v = S\!\left(3 - 2 \frac{d_v}{R_f}\right), \qquad
    S(s) = s^2 (3 - 2 s), \quad s \in [0, 1],

with the distance :math:`d_v` of a vertex v to the nearest centre: 1 up to the radius,
0 from 3/2 of it on. Inside, the membrane flows: its springs get new rest lengths after
every division, and large triangles are subdivided. Outside, the healthy endometrium is
elastic about its shape before growth (`jaxgrow.energy.healthy`). So the rim of a focus
is a ring of nearly fixed length, out of which the hyperplastic lining balloons: the
lesion's neck. The marks are carried linearly by every remeshing, and so differentiable
in the radius.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.cluster.vq import kmeans2
from scipy.spatial import KDTree

from jaxgrow.mesh.quality import areas
from jaxgrow.mesh.surface import Surface
from jaxgrow.mesh.topology import connected_parts
from jaxgrow.numerics.guards import safe_norm
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Frame, Membrane, replaced, State
from jaxgrow.transfer.device import as_reference, get, get_surface


GROWING = 0.5
"""Hyperplasia from which on a vertex emits particles."""


def mark_foci(
    state: State, centres: Sequence[int], radius: Scalar, source: int = -1
) -> State:
    """Mark foci of hyperplasia on the membrane; all else is healthy.

    The present positions become the reference of the healthy tissue.

    Args:
        state: an equilibrium, with a membrane.
        centres: vertices.
        radius: R_f, in r0, positive.
        source: vertex that emits all particles; -1 if the foci do.
    """
    assert state.membrane is not None
    given = map(jnp.asarray, (centres, radius, source))
    marked = _marked(state.membrane, *given)
    return State(state.particles, as_reference(marked), state.frame)


@jax.jit
def _marked(
    membrane: Membrane,
    centres: Int[Array, " c"],
    radius: Float[Array, ""],
    source: Int[Array, ""],
) -> Membrane:
    offset = membrane.vertices[:, None] - membrane.vertices[centres][None]
    distance = jnp.min(safe_norm(offset), axis=1)
    share = jnp.clip(1 + 2 * (radius - distance) / radius, 0, 1)
    marks = jnp.where(membrane.vertex_alive, share**2 * (3 - 2 * share), 0)
    source = source.astype(membrane.source.dtype)
    return replaced(membrane, hyperplasia=marks, source=source)


def least_distance(state: State, centres: Sequence[int]) -> Float[Array, ""]:
    """Compute the least distance between two of several vertices, in r0."""
    assert state.membrane is not None
    points = state.membrane.vertices[jnp.asarray(centres)]
    first, second = np.triu_indices(len(centres), 1)
    return jnp.min(safe_norm(points[first] - points[second]))


def emitting(membrane: Membrane) -> Bool[np.ndarray, " m"]:
    """Mark the vertices of the foci, one entry per vertex alive."""
    alive = get(membrane.vertex_alive)
    free = ~get(membrane.pinned)[alive]
    return (get(membrane.hyperplasia)[alive] >= GROWING) & free


def draw_emitters(
    membrane: Membrane, count: int, rng: np.random.Generator
) -> tuple[int, ...]:
    """Draw vertices: of every focus equally often, there by their areas.

    Args:
        membrane: with foci.
        count: number of vertices; fewer if the foci have fewer.
        rng: draws them.
    """
    surface, chosen = get_surface(membrane), emitting(membrane)
    weight = np.where(chosen, vertex_areas(surface), 0)
    count = min(count, int(np.count_nonzero(weight)))
    if count == 0:
        return ()
    focus = connected_parts(surface.faces, chosen)
    weight /= np.bincount(focus, weight)[focus].clip(min=np.finfo(float).tiny)
    drawn = rng.choice(len(weight), count, replace=False, p=weight / weight.sum())
    return tuple(int(vertex) for vertex in drawn)


def vertex_areas(surface: Surface) -> Float[np.ndarray, " m"]:
    """Compute a third of the area of the triangles around each vertex."""
    share = areas(surface.vertices[surface.faces]) / 3
    count = len(surface.vertices)
    return np.bincount(surface.faces.ravel(), np.repeat(share, 3), minlength=count)


def spread_out(membrane: Membrane, count: int, frame: Frame) -> tuple[int, ...]:
    """Choose vertices spread evenly over the upper half of the foci.

    They are nearest to the means of k clusters of its vertices, found by Lloyd's
    iteration from points that are far apart (Gonzalez 1985).

    Args:
        membrane: with foci.
        count: number of vertices; fewer if the foci have fewer.
        frame: with the axis.
    """
    chosen = np.flatnonzero(emitting(membrane))
    points = get(membrane.vertices)[chosen]
    height = points @ get(frame.axis)
    upper = height >= 0.5 * height.max(initial=0.0)
    chosen, points = chosen[upper], points[upper]
    starts, distance = [0], np.full(len(points), np.inf)
    while len(starts) < min(count, len(points)):
        latest = np.linalg.norm(points - points[starts[-1]], axis=1)
        distance = np.minimum(distance, latest)
        starts.append(int(distance.argmax()))
    means, _ = kmeans2(points, points[starts], minit="matrix")
    _, nearest = KDTree(points).query(means)
    return tuple(int(chosen[index]) for index in dict.fromkeys(np.atleast_1d(nearest)))
