"""Compiled loops of a problem's terms: addresses and buffers.

Addresses are those of this process. They are arguments of a compiled program, never
constants of it, as programs are kept on disk.
"""

import functools
import warnings
from collections.abc import Sequence
from types import ModuleType
from typing import Any, NamedTuple, TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.energy.a2 import CUTOFF
from jaxgrow.energy.collision import COLLISION
from jaxgrow.energy.contact import CONTACT
from jaxgrow.energy.pair import PAIRS
from jaxgrow.energy.term import MembraneTerm, Term
from jaxgrow.equilibrium.roots import (
    BUFFERS,
    collision_root,
    contact_root,
    element_root,
    Kind,
    pair_root,
)
from jaxgrow.kernels.arguments import checked
from jaxgrow.kernels.ffi import registered, target
from jaxgrow.kernels.printer import UnprintableError
from jaxgrow.kernels.roots import load
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Nodes, Species
from jaxgrow.transfer.device import put


if TYPE_CHECKING:
    from jaxgrow.equilibrium.lists import Lists
    from jaxgrow.equilibrium.problem import Problem


AWAY = 1e9
"""Coordinate, in r0, at which dead particles are passed to loops."""


class Loops(eqx.Module):
    """Compiled loops of the terms of a problem.

    Attributes:
        names: of the terms, in their order.
        force: addresses of the loops of forces.
        product: addresses of the loops of Hessian products; None unless requested.
        blocks: addresses of the loops of the Hessian's diagonal blocks; None unless
            requested.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    force: Int[Array, " t"]
    product: Int[Array, " t"] | None
    blocks: Int[Array, " t"] | None = None


class Wired(NamedTuple):
    """Term as its root takes it: its name, and its buffers in their order."""

    name: str
    buffers: tuple[Array, ...]


class PrintingWarning(UserWarning):
    """Warning of a term that cannot be printed as a loop; XLA evaluates it."""


def wired(problem: "Problem", lists: "Lists") -> list[Wired]:
    """List the terms that a problem has with these lists, in root order."""
    terms: list[Wired] = []
    particles, membrane = problem.particles, problem.membrane
    if lists.neighbors is not None and particles is not None:
        tumour = particles.species == Species.TUMOUR
        numbers = _numbers(problem, PAIRS, CUTOFF)
        terms.append(Wired("pair", (tumour, lists.neighbors.listed, numbers)))
    for term in problem.terms:
        elements = term.elements(particles, membrane)
        if elements is not None:
            index, rest = elements.nodes.astype(int), elements.rest
            numbers = _numbers(problem, term)
            terms.append(Wired(term.name, (index, rest, elements.alive, numbers)))
    parameters = problem.parameters
    if lists.contacts is not None and particles is not None:
        c, half = lists.contacts, 0.5 * parameters.contact_sharpness
        numbers = _numbers(problem, CONTACT, parameters.contact_range, half, CUTOFF)
        own = particles.alive, c.particle, c.corners, c.real, numbers
        terms.append(Wired("contact", own))
    if lists.collisions is not None:
        c, half = lists.collisions, 0.5 * parameters.contact_sharpness
        numbers = _numbers(problem, COLLISION, parameters.collision_range, half)
        own = c.vertex, c.corners, c.apart, c.vertex_margin, c.edges, c.edge_margin
        terms.append(Wired("collision", (*own, numbers)))
    for term in terms:
        buffers = BUFFERS.get(term.name, BUFFERS["elements"])
        checked(term.name, [buffer.argument for buffer in buffers], term.buffers)
    return terms


def _numbers(problem: "Problem", term: Any, *first: Any) -> Float[Array, " p"]:
    """Stack the numbers of a term: geometry, parameters, then its own."""
    by_name = [getattr(problem.parameters, name) for name in term.parameters]
    numbers = [*first, *by_name, *jax.tree.leaves(term)]
    return jnp.stack([jnp.asarray(number, problem.dtype) for number in numbers])


class _Key(NamedTuple):
    """Key of a root: a term, and the number of rest data of its elements."""

    term: Any
    rest: int

    @property
    def name(self) -> str:
        return self.term.name


def _keys(problem: "Problem", lists: "Lists") -> tuple[_Key, ...]:
    """Return the keys of the terms of `wired`, without evaluating anything."""
    particles, membrane = problem.particles, problem.membrane
    keys = []
    if lists.neighbors is not None and particles is not None:
        keys.append(_Key(PAIRS, 0))
    for term in problem.terms:
        if isinstance(term, MembraneTerm):
            if membrane is not None:
                keys.append(_Key(_shape_of(term), membrane.rest[term.name].shape[1]))
            continue
        elements = eqx.filter_eval_shape(term.elements, particles, membrane)
        if elements is not None:
            keys.append(_Key(_shape_of(term), elements.rest.shape[1]))
    if lists.contacts is not None and particles is not None:
        keys.append(_Key(CONTACT, 0))
    if lists.collisions is not None:
        keys.append(_Key(COLLISION, 0))
    return tuple(keys)


def _shape_of(term: Term) -> Term:
    """Return the term with 0 for its own parameters.

    These are arguments of its root.
    """
    return jax.tree.map(lambda _: 0.0, term)


_MAKERS = {"pair": pair_root, "contact": contact_root, "collision": collision_root}


@functools.cache
def root_module(key: _Key, kind: Kind) -> ModuleType | None:
    """Load the compiled root of a term; None, with a warning, if unprintable."""
    term = key.term
    make = functools.partial(element_root, term, key.rest)
    if not isinstance(term, Term):
        make = _MAKERS[term.name]
    of_package = type(term).__module__.startswith("jaxgrow.")
    try:
        return load(f"{key.name}_{kind}", lambda: make(kind), of_package=of_package)
    except UnprintableError as error:
        warnings.warn(
            f"the energy term {key.name!r} uses {error}, which cannot be printed as a "
            "loop, so XLA evaluates it and relaxations take several times as long; "
            "write it with arithmetic of scalars (see jaxgrow.energy.vectors).",
            PrintingWarning,
            stacklevel=2,
        )
        return None


def pair_module() -> ModuleType | None:
    """Load the compiled root of pairs, if loops are available."""
    return root_module(_Key(PAIRS, 0), "force") if registered("terms") else None


@functools.lru_cache(maxsize=64)
def _loops(keys: tuple[_Key, ...], products: bool) -> Loops:
    found = [key for key in keys if root_module(key, "force") is not None]
    if products:
        found = [key for key in found if root_module(key, "product") is not None]

    def addresses(kind: Kind, loop: str = "root") -> Array:
        roots = (root_module(key, kind) for key in found)
        return put(np.array([getattr(r, loop).address for r in roots if r], np.int64))

    return Loops(
        tuple(key.name for key in found),
        addresses("force"),
        addresses("product") if products else None,
        addresses("product", "blocks") if products else None,
    )


def handler(name: str) -> str:
    """Register a handler with XLA; return the name that XLA knows it by."""
    if not registered(name):
        raise RuntimeError(f"XLA refuses the loop {name!r}; set JAXGROW_KERNELS=off.")
    return target(name)


def may_loop(problem: "Problem") -> bool:
    """Return whether loops can be used: on a CPU, in 64 bits."""
    if not (problem.dtype == jnp.float64 and registered("terms")):
        return False
    nodes = problem.particles or problem.membrane
    rows = jax.tree.leaves(nodes)[0]
    if isinstance(rows, Tracer):
        return False
    return all(device.platform == "cpu" for device in rows.devices())


def with_loops(
    problem: "Problem", lists: "Lists", *, products: bool = False
) -> "Problem":
    """Return the problem with the loops of its terms, where loops can be used.

    Args:
        problem: on the host.
        lists: of it.
        products: whether those of Hessian products are needed too.
    """
    loops = _loops(_keys(problem, lists), products) if may_loop(problem) else None
    return problem.with_loops(loops)


def how_terms_run(problem: "Problem", lists: "Lists") -> dict[str, str]:
    """Return for each term whether a "loop" or "XLA" evaluates it.

    If all are loops, a descent can be one.
    """
    looped = () if problem.loops is None else problem.loops.names
    names = [key.name for key in _keys(problem, lists)]
    terms = {name: "loop" if name in looped else "XLA" for name in names}
    functions = [getattr(f, "name", type(f).__name__) for f in problem.functions]
    return terms | dict.fromkeys(functions, "XLA")


def evaluate(
    problem: "Problem", nodes: Nodes, lists: "Lists", along: Nodes | None = None
) -> tuple[Nodes, Nodes]:
    """Evaluate the terms that have loops.

    Args:
        problem: with loops.
        nodes: positions to evaluate at.
        lists: valid there.
        along: a displacement; None for forces.

    Returns:
        Forces in F(0), or the Hessian's product with the displacement, and the
        clearance of each node, in r0 (infinite where nothing is near; only with
        forces).
    """
    loops, at = problem.loops, problem.at(nodes)
    assert loops is not None
    if along is None:
        out, clear = _run(at, lists, loops.force)
    else:
        out, clear = _run(at, lists, loops.product, along)
    return _split(problem, out), _split(problem, clear)


def blocks(problem: "Problem", lists: "Lists") -> Float[Array, "q 9"]:
    """Compute approximate 3 x 3 diagonal blocks of the Hessian, in rows.

    They are exact for terms that are sums over pairs or elements, in F(0)/r0.

    Args:
        problem: with loops of products.
        lists: valid there.
    """
    assert problem.loops is not None
    return _run(problem, lists, problem.loops.blocks, columns=9)[0]


def _run(
    problem: "Problem",
    lists: "Lists",
    addresses: Int[Array, " t"] | None,
    along: Nodes | None = None,
    columns: int = 3,
) -> Sequence[Array]:
    """Run the loops at these addresses; return their sums and the clearances."""
    assert addresses is not None
    alive, place = placed(problem, lists)
    moved = jnp.zeros((0, 3), problem.dtype)
    if along is not None:
        rows = jnp.concatenate(jax.tree.leaves(along))
        moved = jnp.pad(rows, ((0, place.shape[0] - rows.shape[0]), (0, 0)))
    count = place.shape[0]
    results = [
        jax.ShapeDtypeStruct(shape, place.dtype)
        for shape in ((count, columns), (count,))
    ]
    wiring, buffers = _buffers(problem, lists, first=5)
    call = jax.ffi.ffi_call(handler("terms"), results)
    return call(addresses, wiring, alive, place, moved, *buffers)


class Solved(NamedTuple):
    """Outcome of the loop of conjugate gradients; see `jaxgrow.kernels.solve`."""

    displacement: Nodes
    numbers: Float[Array, "2"]
    counts: Int[Array, "3"]


def solve(
    problem: "Problem",
    lists: "Lists",
    force: Nodes,
    limits: tuple[Scalar, Scalar, Scalar],
    *,
    uneven: Nodes,
    loose: tuple[Bool[Array, ""], Bool[Array, ""]],
) -> Solved:
    """Solve for the displacement by which a force moves an equilibrium.

    Args:
        problem: at the equilibrium, with loops of all terms' products.
        lists: valid there.
        force: on every node.
        limits: relative residual at which to stop; most products; curvature, relative
            to the largest met, below which a direction is a null mode.
        uneven: a force without symmetry.
        loose: whether the whole may translate, and rotate.
    """
    assert problem.loops is not None
    assert problem.loops.product is not None
    lists = _of_free(problem, lists)
    alive, place = placed(problem, lists)

    def rows(nodes: Nodes) -> Array:
        return jnp.concatenate(jax.tree.leaves(nodes))

    results = [
        jax.ShapeDtypeStruct(rows(force).shape, place.dtype),
        jax.ShapeDtypeStruct((2,), place.dtype),
        jax.ShapeDtypeStruct((3,), jnp.int64),
    ]
    wiring, buffers = _buffers(problem, lists, first=10)
    x, numbers, counts = jax.ffi.ffi_call(handler("solve"), results)(
        *(problem.loops.product, wiring, alive, place),
        *(rows(problem.free())[:, 0] > 0, jnp.stack(loose), rows(force)),
        jnp.stack([jnp.asarray(limit, place.dtype) for limit in limits]),
        *(rows(uneven), blocks(problem, lists), *buffers),
    )
    return Solved(_split(problem, x), numbers, counts)


def _of_free(problem: "Problem", lists: "Lists") -> "Lists":
    """Remove the neighbours of held particles, on which no product is needed.

    They are half of all entries in a patch, and pairs take half of the time of a
    product.
    """
    particles = problem.particles
    if particles is None or lists.neighbors is None:
        return lists
    listed = lists.neighbors.listed
    nobody = jnp.asarray(listed.shape[1], listed.dtype)
    kept = jnp.where(particles.free[None], listed, nobody)
    return eqx.tree_at(lambda found: found.neighbors.listed, lists, kept)


def _buffers(
    problem: "Problem", lists: "Lists", first: int
) -> tuple[Int[Array, "t b"], list[Array]]:
    """Return wiring and buffers of the looped terms, numbered from `first`."""
    assert problem.loops is not None
    terms = [t for t in wired(problem, lists) if t.name in problem.loops.names]
    buffers = [buffer for term in terms for buffer in term.buffers]
    number = iter(range(first, first + len(buffers)))
    wiring = make_wiring([[next(number) for _ in term.buffers] for term in terms])
    return jnp.asarray(wiring), buffers


def placed(
    problem: "Problem", lists: "Lists"
) -> tuple[Bool[Array, " n"], Float[Array, "q 3"]]:
    """Return liveness, and all nodes: dead ones moved away, static ones last."""
    rows, alive = [], jnp.zeros(0, bool)
    if problem.particles is not None:
        alive = problem.particles.alive
        rows.append(jnp.where(alive[:, None], problem.particles.position, AWAY))
    if problem.membrane is not None:
        rows.append(problem.membrane.vertices)
    if lists.collisions is not None:
        rows.append(lists.collisions.still)
    return alive, jnp.concatenate(rows)


def _split(problem: "Problem", rows: Float[Array, "q *_"]) -> Nodes:
    """Split rows into those of particles and of vertices."""
    particles, membrane, count = problem.particles, problem.membrane, 0
    if particles is not None:
        count = particles.position.shape[0]
    return Nodes(
        None if particles is None else rows[:count],
        None if membrane is None else rows[count : count + membrane.vertices.shape[0]],
    )


def make_wiring(buffers: Sequence[Sequence[int]]) -> Int[np.ndarray, "t b"]:
    """Return the argument numbers of each term's buffers, padded by -1."""
    most = max(map(len, buffers), default=0)
    wiring = np.full((len(buffers), most), -1, np.int64)
    for row, numbers in zip(wiring, buffers, strict=True):
        row[: len(numbers)] = numbers
    return wiring
