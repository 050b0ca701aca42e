"""Validation of the arrays that a user gives, with a sentence per fault.

The wanted shape and dtype are read from the annotations in `jaxgrow.state`. NumPy
arrays and lists are put on the device; real numbers get the precision of the positions.
Traced arrays have no values yet: only their shape and dtype are checked.
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
"""Constructor of each body, for messages."""

PRECISIONS = (np.dtype(np.float32), np.dtype(np.float64))
"""Dtypes that positions may have, the wider one last."""

ROWS = {"n": "particle", "m": "vertex", "f": "face", "e": "edge"}
"""Rows that the letters of annotations count."""

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
    """Kind of numbers that an annotation asks for.

    Attributes:
        of: the kinds of dtypes that are accepted, by NumPy's codes.
        words: its description in a message.
        advice: the conversion to call for other dtypes.
    """

    of: str
    words: str
    advice: str


KINDS = {
    "Float": Kind("fiu", "real numbers of 32 or 64 bits", ".astype(float)"),
    "Int": Kind("iu", "integers", ".astype(int)"),
    "Bool": Kind("b", "booleans", ".astype(bool) if it is a mask"),
}
"""Kinds by the name of their annotation."""


class Leaf(NamedTuple):
    """Annotated array field of a body.

    Attributes:
        name: of the field.
        kind: a key of `KINDS`.
        shape: a number or a letter for each dimension.
    """

    name: str
    kind: str
    shape: tuple[int | str, ...]


def accept_bodies(
    particles: Any, membrane: Any
) -> tuple[Particles | None, Membrane | None]:
    """Validate particles and membrane, and put them on the device.

    If one has positions of 32 bits and the other of 64, both get 64. A body that needs
    no change is returned itself.

    Raises:
        ValueError: one has another type, or an array of it another shape, another kind
            of numbers, or (unless traced) values out of range.
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
    """Validate vectors that act on nodes: one per position, with padding.

    Args:
        name: of the vectors, for messages.
        given: the vectors; None for none.
        positions: of the nodes; None if there are no such nodes.

    Returns:
        The vectors in the precision of the positions.

    Raises:
        ValueError: there are more or fewer than positions, or they are not real
            numbers.
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
    """Convert lists or an array-like object to a NumPy array.

    Raises:
        ValueError: they cannot be converted, or hold other things than numbers.
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
    """Convert to an array on the device; lists may hold traced values.

    Raises:
        ValueError: as `on_host`.
    """
    if isinstance(given, jax.Array):
        return given
    if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(given)):
        return jnp.asarray(given)
    return put(on_host(name, given))


def precision_of(name: str, given: Any) -> np.dtype:
    """Return the dtype of positions; integers get JAX's default float.

    Raises:
        ValueError: they are not real numbers of 32 or 64 bits.
    """
    own = on_device(name, given).dtype
    if own.kind in "iu":
        return canonicalize_dtype(float)
    if own not in PRECISIONS:
        _refuse_kind(name, own, "Float")
    return own


def of_kind(name: str, array: Numbers, kind: str, wanted: np.dtype) -> Numbers:
    """Convert an array to the wanted dtype.

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
    """Raise if a shape contradicts the annotation, or earlier arrays.

    Args:
        name: of the array, for messages.
        shape: its shape.
        annotated: a number or a letter for each dimension.
        sizes: sizes of the letters in earlier arrays; those of this array are added.

    Raises:
        ValueError: the shapes differ.
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
    """Raise if a value is below `low`, or not below `end`.

    Arrays of JAX are immutable, so each is checked once. A traced array passes, as its
    values are unknown.

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
    """Raise if a value is not finite; a traced array passes.

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
"""Arrays whose values were found to be in a range."""

_right: set[tuple[Any, ...]] = set()
"""Signatures of bodies with valid shapes and dtypes: as many as there are programs
compiled for them."""


def _check_type(name: str, given: Any, wanted: type) -> None:
    if given is not None and not isinstance(given, wanted):
        raise ValueError(
            f"{name} is of type {type(given).__name__}; give jaxgrow.{wanted.__name__},"
            f" as jaxgrow.{MAKERS[wanted]} makes it, or None."
        )


def _signature(body: Particles | Membrane | None) -> Any:
    """Return kinds, shapes and dtypes of the arrays of a body.

    A body without arrays returns a unique object.

    Comparing signatures is faster than checking the arrays one by one.
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
    """Return the wider one of the precisions of the positions."""
    own = []
    if particles is not None:
        own.append(precision_of("particles.position", particles.position))
    if membrane is not None:
        own.append(precision_of("membrane.vertices", membrane.vertices))
    return max(own, key=PRECISIONS.index, default=PRECISIONS[-1])


def _put_right(body: str, given: Body, precision: np.dtype) -> Body:
    """Convert all arrays of a body and put them on the device.

    A body that needs no change is returned itself.
    """
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
    """Convert the rest data of each term: a row per edge, or per face.

    Raises:
        ValueError: they have another shape, or are not real numbers.
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
    """Raise if an index or species is out of its range.

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
    """Return the annotated array fields of a body."""
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
