"""Arrays that a user gives, checked before they are used: a sentence for each fault.

What an array must be is read from its annotation in `jaxgrow.state`. NumPy arrays and
lists are put on the device; real numbers get the precision of the positions. What JAX
traces has no values yet: its shape and dtype are checked alone.
"""

import dataclasses
import functools
from typing import Any, NamedTuple, NoReturn, TypeVar
from weakref import WeakValueDictionary

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.dtypes import canonicalize_dtype
from jaxtyping import AbstractArray, Array

from jaxgrow.state import Membrane, Particles, Species
from jaxgrow.transfer.device import get, put


Body = TypeVar("Body", Particles, Membrane)
Numbers = TypeVar("Numbers", np.ndarray, Array)

MAKERS = {Particles: "make_particles(position)", Membrane: "make_membrane(...)"}
"""What makes a body from the arrays that a user has."""

PRECISIONS = (np.dtype(np.float32), np.dtype(np.float64))
"""Dtypes that positions may have, the wider one last."""

ROWS = {"n": "particle", "m": "vertex", "f": "face", "e": "edge"}
"""What the letters of annotations count."""

RANGES: dict[str, tuple[int, int | str]] = {
    "species": (0, len(Species)),
    "faces": (0, "vertices"),
    "edges": (0, "vertices"),
    "opposite": (-1, "vertices"),
    "source": (-1, "vertices"),
}
"""The least value of a field, and one more than the largest: a number, or the rows of
another field."""


class Kind(NamedTuple):
    """A kind of numbers.

    Attributes:
        of: the kinds of dtypes that are taken for it, as NumPy abbreviates them.
        words: what it is, in a sentence.
        advice: what to call where it is another.
    """

    of: str
    words: str
    advice: str


KINDS = {
    "Float": Kind("fiu", "real numbers of 32 or 64 bits", ".astype(float)"),
    "Int": Kind("iu", "integers", ".astype(int)"),
    "Bool": Kind("b", "booleans", ".astype(bool) if it is a mask"),
}
"""By the name that annotations have for it."""


class Leaf(NamedTuple):
    """An array of a body, as its field is annotated.

    Attributes:
        name: of the field.
        kind: of its numbers, see `KINDS`.
        shape: a number or a letter for each dimension.
    """

    name: str
    kind: str
    shape: tuple[int | str, ...]


def accept_bodies(
    particles: Any, membrane: Any
) -> tuple[Particles | None, Membrane | None]:
    """Check the arrays of particles and membrane, and put them on the device.

    If one has positions of 32 bits and the other of 64, both get 64. What is right as
    it is comes back itself.

    Raises:
        ValueError: one is something else, or an array of it has another shape, other
            numbers, or (where it is not traced) numbers out of range.
    """
    _check_type("particles", particles, Particles)
    _check_type("membrane", membrane, Membrane)
    signature = _signature(particles), _signature(membrane)
    if signature not in _right:
        given = particles, membrane
        precision = _common_precision(particles, membrane)
        if particles is not None:
            particles = _put_right("particles", particles, precision)
        if membrane is not None:
            membrane = _put_right("membrane", membrane, precision)
        if particles is given[0] and membrane is given[1]:
            _right.add(signature)
    if particles is not None:
        _check_ranges("particles", particles)
    if membrane is not None:
        _check_ranges("membrane", membrane)
    return particles, membrane


def accept_vectors(name: str, given: Any, positions: Array | None) -> Array | None:
    """Check vectors that act on nodes: one for every position, padding included.

    Args:
        name: of the vectors, for a sentence.
        given: the vectors; None for none.
        positions: of the nodes; None if there are no such nodes.

    Returns:
        The vectors in the precision of the positions.

    Raises:
        ValueError: there are more or fewer than positions, or they are no real numbers.
    """
    array = None if given is None else on_device(name, given)
    shape, wanted = (None if a is None else a.shape for a in (array, positions))
    if shape != wanted:
        why = "one vector for every node, padding counts"
        if wanted is None:
            why = "there are no such nodes"
        _refuse_shape(name, shape, wanted, why)
    if array is None or positions is None:
        return None
    return of_kind(name, array, "Float", positions.dtype)


def on_host(name: str, given: Any) -> np.ndarray:
    """The array of NumPy that lists, or something like an array, make.

    Raises:
        ValueError: they make none, or one of other things than numbers.
    """
    try:
        array = get(given) if isinstance(given, jax.Array) else np.asarray(given)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{name} is no array ({error}); give an array, or lists of equal length."
        ) from error
    if array.dtype.kind not in "biuf":
        _refuse_kind(name, array.dtype, "Float")
    return array


def on_device(name: str, given: Any) -> Array:
    """The same on the device; lists may hold what JAX traces.

    Raises:
        ValueError: as of `on_host`.
    """
    if isinstance(given, jax.Array):
        return given
    if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(given)):
        return jnp.asarray(given)
    return put(on_host(name, given))


def precision_of(name: str, given: Any) -> np.dtype:
    """The dtype of positions, or that which whole numbers get as positions.

    Raises:
        ValueError: they are no real numbers of 32 or 64 bits.
    """
    own = on_device(name, given).dtype
    if own.kind in "iu":
        return canonicalize_dtype(float)
    if own not in PRECISIONS:
        _refuse_kind(name, own, "Float")
    return own


def of_kind(name: str, array: Numbers, kind: str, wanted: np.dtype) -> Numbers:
    """The array with the wanted dtype.

    Raises:
        ValueError: it holds numbers of another kind, see `KINDS`.
    """
    own = array.dtype
    if own == wanted:
        return array
    if own.kind not in KINDS[kind].of or (own.kind == "f" and own not in PRECISIONS):
        _refuse_kind(name, own, kind)
    return array.astype(wanted)


def check_shape(
    name: str,
    shape: tuple[int, ...],
    annotated: tuple[int | str, ...],
    sizes: dict[str, int],
) -> None:
    """Refuse a shape that contradicts the annotation, or the arrays before.

    Args:
        name: of the array, for a sentence.
        shape: that it has.
        annotated: a number or a letter for each dimension.
        sizes: what letters stand for in the arrays before, which is added to.

    Raises:
        ValueError: it does.
    """
    wanted = tuple(sizes.get(d, d) if isinstance(d, str) else d for d in annotated)
    fits = len(shape) == len(wanted) and all(
        isinstance(most, str) or size == most
        for size, most in zip(shape, wanted, strict=True)
    )
    if fits:
        new = zip(annotated, shape, strict=True)
        sizes.update({letter: n for letter, n in new if isinstance(letter, str)})
        return
    why = "a single number"
    if annotated:
        why = f"one row for every {ROWS[str(annotated[0])]}"
    _refuse_shape(name, shape, str(wanted).replace("'", ""), why)


def check_range(name: str, array: np.ndarray | Array, low: int, end: int) -> None:
    """Refuse values below the first number, or not below the second.

    Nobody can change an array of JAX, so that it is looked at once as long as it
    lives. Of one that is traced nothing is known.

    Raises:
        ValueError: there is one.
    """
    known = id(array), low, end
    if _in_range.get(known) is array or isinstance(array, Tracer):
        return
    values = get(array) if isinstance(array, jax.Array) else array
    if values.size and not low <= (least := int(values.min())):
        _refuse_value(name, least, low, end)
    if values.size and not (most := int(values.max())) < end:
        _refuse_value(name, most, low, end)
    if isinstance(array, jax.Array):
        _in_range[known] = array


def check_finite(name: str, array: np.ndarray | Array) -> None:
    """Refuse values that are not finite; of what is traced nothing is known.

    Raises:
        ValueError: there is one.
    """
    if isinstance(array, Tracer):
        return
    values = get(array) if isinstance(array, jax.Array) else array
    if not np.isfinite(values).all():
        row = int(np.argwhere(~np.isfinite(values))[0][0])
        raise ValueError(f"{name} is not finite in row {row}; remove that row.")


_in_range: WeakValueDictionary[tuple[int, int, int], Array] = WeakValueDictionary()
"""Arrays that were found to be in a range."""

_right: set[tuple[Any, ...]] = set()
"""Signatures of bodies whose arrays have the right shapes and dtypes: as many as there
are programs compiled for them."""


def _check_type(name: str, given: Any, wanted: type) -> None:
    if given is not None and not isinstance(given, wanted):
        raise ValueError(
            f"{name} is of type {type(given).__name__}; give jaxgrow.{wanted.__name__},"
            f" as jaxgrow.{MAKERS[wanted]} makes it, or None."
        )


def _signature(body: Particles | Membrane | None) -> Any:
    """Kinds, shapes and dtypes of the arrays; itself if they have none.

    They are compared faster than looked at one by one.
    """
    if body is None:
        return None
    try:
        arrays = [getattr(body, leaf.name) for leaf in _leaves(type(body))]
        rest: dict[str, Any] = getattr(body, "rest", {})
        known = tuple([(type(a), a.shape, a.dtype) for a in (*arrays, *rest.values())])
        return *known, *rest
    except AttributeError:  # of lists and numbers
        return object()


def _common_precision(
    particles: Particles | None, membrane: Membrane | None
) -> np.dtype:
    """The wider one of the precisions of the positions."""
    own = []
    if particles is not None:
        own.append(precision_of("particles.position", particles.position))
    if membrane is not None:
        own.append(precision_of("membrane.vertices", membrane.vertices))
    return max(own, key=PRECISIONS.index, default=PRECISIONS[-1])


def _put_right(body: str, given: Body, precision: np.dtype) -> Body:
    """The body with all of its arrays right and on the device; itself if they are."""
    dtypes = {
        "Float": precision,
        "Int": canonicalize_dtype(int),
        "Bool": np.dtype(bool),
    }
    sizes: dict[str, int] = {}
    changed: dict[str, Any] = {}
    for leaf in _leaves(type(given)):
        name, own = f"{body}.{leaf.name}", getattr(given, leaf.name)
        array = on_device(name, own)
        check_shape(name, array.shape, leaf.shape, sizes)
        array = of_kind(name, array, leaf.kind, dtypes[leaf.kind])
        if array is not own:
            changed[leaf.name] = array
    if isinstance(given, Membrane):
        rest = _put_rest_right(given.rest, sizes, precision)
        if any(rest[name] is not own for name, own in given.rest.items()):
            changed["rest"] = rest
    return dataclasses.replace(given, **changed) if changed else given


def _put_rest_right(
    given: dict[str, Any], sizes: dict[str, int], precision: np.dtype
) -> dict[str, Array]:
    """Rest data of each term: a row for every edge, or for every face.

    Raises:
        ValueError: they have another shape, or are no real numbers.
    """
    right = {}
    for term, own in given.items():
        name = f"membrane.rest[{term!r}]"
        array = on_device(name, own)
        if array.ndim != 2 or array.shape[0] not in (sizes["e"], sizes["f"]):
            wanted = f"({sizes['e']}, q) or ({sizes['f']}, q)"
            _refuse_shape(name, array.shape, wanted, "one row for every edge or face")
        right[term] = of_kind(name, array, "Float", precision)
    return right


def _check_ranges(body: str, given: Particles | Membrane) -> None:
    """Refuse values out of their range.

    Raises:
        ValueError: an array has one.
    """
    for leaf in _leaves(type(given)):
        if leaf.name in RANGES:
            low, end = RANGES[leaf.name]
            if isinstance(end, str):
                end = getattr(given, end).shape[0]
            check_range(f"{body}.{leaf.name}", getattr(given, leaf.name), low, end)


@functools.lru_cache(maxsize=8)
def _leaves(body: type) -> tuple[Leaf, ...]:
    """The arrays of a body, as its fields are annotated."""
    found = []
    for field in dataclasses.fields(body):
        annotated: Any = field.type
        if isinstance(annotated, type) and issubclass(annotated, AbstractArray):
            shape = (int(d) if d.isdigit() else d for d in annotated.dim_str.split())
            found.append(Leaf(field.name, annotated.dtype.__name__, tuple(shape)))
    return tuple(found)


def _refuse_shape(name: str, shape: Any, wanted: Any, why: str) -> NoReturn:
    raise ValueError(f"{name} has the shape {shape}; it must be {wanted} ({why}).")


def _refuse_kind(name: str, dtype: np.dtype, kind: str) -> NoReturn:
    _, words, advice = KINDS[kind]
    raise ValueError(f"{name} holds {dtype}; it must hold {words}: call {advice}.")


def _refuse_value(name: str, value: int, low: int, end: int) -> NoReturn:
    raise ValueError(
        f"{name} has the value {value}; its values must be from {low} to {end - 1}, in "
        "rows of padding too."
    )
