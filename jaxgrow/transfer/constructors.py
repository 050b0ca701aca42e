"""Constructors of particles and membranes from positions and meshes."""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.dtypes import canonicalize_dtype
from jaxtyping import Array

from jaxgrow.mesh.surface import Remeshing
from jaxgrow.mesh.topology import build_topology
from jaxgrow.runtime.types import Given
from jaxgrow.state import Membrane, Particles, Species
from jaxgrow.transfer.array_checks import (
    check_finite,
    check_range,
    check_shape,
    of_kind,
    on_device,
    on_host,
    precision_of,
)
from jaxgrow.transfer.device import get, put, put_at_rest


def make_particles(
    position: Given, *, species: Given = Species.TISSUE, held: Given = False
) -> Particles:
    """Make particles, all alive, from their positions for `jaxgrow.relax`.

    Args:
        position: in r0, (n, 3); of NumPy, lists, or JAX, which may trace them.
        species: a `Species` for each, or one for all.
        held: True for particles that never move, or one flag for all.

    Returns:
        The particles on the device, without padding, in the precision that the
        positions have (whole numbers get JAX's default).

    Raises:
        ValueError: an array has another shape or kind of numbers, a position is not
            finite, or a species is unknown.
    """
    place = _positions("position", position, "n")
    count = place.shape[0]
    kinds = _for_each("species", species, "n", count, "Int", canonicalize_dtype(int))
    check_range("species", kinds, 0, len(Species))
    return Particles(
        position=place,
        species=kinds,
        alive=put(np.ones(count, bool)),
        held=_for_each("held", held, "n", count, "Bool", np.dtype(bool)),
    )


def make_membrane(
    vertices: Given,
    faces: Given,
    *,
    pinned: Given | Literal["rim"] = "rim",
    rest_length: Given | None = None,
    source: int = -1,
) -> Membrane:
    """Make a membrane from a triangle mesh for `jaxgrow.relax`.

    Its springs are the edges of the faces, every edge once, with the smaller number of
    a vertex first and in ascending order.

    Args:
        vertices: in r0, (m, 3); of NumPy, lists, or JAX, which may trace them.
        faces: vertices of each triangle, (f, 3), counter-clockwise seen from the side
            opposite to the tissue; an oriented manifold, closed or with a rim.
        pinned: "rim", or True for vertices that never move, (m,), or one flag for all.
        rest_length: of each edge, in r0, (e,), or one for all, which may be traced; by
            default the current lengths of the edges, differentiable in the vertices.
        source: the vertex that emits a polyp's particles; -1 for none.

    Returns:
        The membrane on the device, without padding, in the precision that the vertices
        have (whole numbers get JAX's default).

    Raises:
        ValueError: an array has another shape or kind of numbers, a vertex or rest
            length is not finite, a rest length is negative, a face names a vertex that
            does not exist, or the faces are not an oriented manifold.
    """
    corners = _positions("vertices", vertices, "m")
    count = corners.shape[0]
    listed = of_kind("faces", on_host("faces", faces), "Int", np.dtype(np.int64))
    check_shape("faces", listed.shape, ("f", 3), {})
    check_range("faces", listed, 0, count)
    check_range("source", np.asarray(source), -1, count)
    if isinstance(pinned, str):
        if pinned != "rim":
            raise ValueError(f'pinned is "{pinned}"; give "rim", or a mask.')
        fixed = build_topology(listed, count).rim_vertices
    else:
        fixed = get(_for_each("pinned", pinned, "m", count, "Bool", np.dtype(bool)))
    mesh = Remeshing((), listed, fixed, source)
    membrane = put_at_rest(corners, mesh, room=False)
    if rest_length is None:
        return membrane
    springs, dtype = membrane.edges.shape[0], corners.dtype
    length = _for_each("rest_length", rest_length, "e", springs, "Float", dtype)
    check_finite("rest_length", length)
    if not isinstance(length, Tracer) and (get(length) < 0).any():
        raise ValueError(
            f"rest_length has the value {get(length).min()}; lengths are not negative."
        )
    return membrane.with_rest_length(length)


def _positions(name: str, given: Given, letter: str) -> Array:
    """Convert and validate positions, and put them on the device."""
    array = on_device(name, given)
    check_shape(name, array.shape, (letter, 3), {})
    array = of_kind(name, array, "Float", precision_of(name, array))
    check_finite(name, array)
    return array


def _for_each(
    name: str, given: Given, letter: str, count: int, kind: str, dtype: np.dtype
) -> Array:
    """Convert values to one per row, from as many or from a scalar."""
    array = on_device(name, given)
    if array.ndim == 0:
        array = jnp.broadcast_to(array, (count,))
    check_shape(name, array.shape, (letter,), {letter: count})
    return of_kind(name, array, kind, dtype)
