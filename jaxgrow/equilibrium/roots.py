"""Roots of all terms: the energies that their loops are printed from.

Each term has a root for its forces and one for its Hessian: for the product with a
displacement, and for the diagonal blocks. See `jaxgrow.kernels.roots` for the
definition of a root.
"""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxgrow.energy.collision import COLLISION
from jaxgrow.energy.contact import CONTACT
from jaxgrow.energy.distance import segment_distance
from jaxgrow.energy.pair import PAIRS
from jaxgrow.energy.term import Term
from jaxgrow.kernels.roots import Buffer, Printed, Root


Kind = Literal["force", "product"]

_NUMBERS = Buffer("numbers", "reals")

BUFFERS = {
    "pair": (Buffer("tumour", "flags"), Buffer("listed", "short", 2), _NUMBERS),
    "contact": (
        Buffer("alive", "flags"),
        Buffer("particle", "short"),
        Buffer("corners", "long", 2),
        Buffer("real", "flags"),
        _NUMBERS,
    ),
    "collision": (
        Buffer("vertex", "long"),
        Buffer("corners", "long", 2),
        Buffer("apart", "flags"),
        Buffer("margin", "reals"),
        Buffer("edges", "long", 2),
        Buffer("edge_margin", "reals"),
        _NUMBERS,
    ),
    "elements": (
        Buffer("stencil", "long", 2),
        Buffer("rest", "reals", 2),
        Buffer("alive", "flags"),
        _NUMBERS,
    ),
}
"""Buffers that the roots read, by the kind of the term."""


def _names(prefix: str, count: int) -> tuple[str, ...]:
    return tuple(f"{prefix}{number}" for number in range(count))


def _tuple(first: int, count: int) -> str:
    """Return the source of a tuple of consecutive numbers of the buffer."""
    entries = "".join(f"numbers[{first + k}], " for k in range(count))
    return f"({entries})"


def _law(
    name: str,
    energy: Callable[..., Array],
    inputs: Sequence[str],
    given: Any,
    kind: Kind,
) -> Printed:
    """Print the derivative of an energy in its first input; for products two."""
    arguments = (*inputs, *(f"p_{n}" for n in given.parameters))

    def derivatives(*numbers: Array) -> tuple[Array, ...]:
        own, rest = numbers[: len(inputs)], numbers[len(inputs) :]
        p = SimpleNamespace(**dict(zip(given.parameters, rest, strict=True)))

        def slope(first: Array) -> Array:
            return jax.grad(lambda u: energy(u, *own[1:], p))(first)

        if kind == "force":
            return (slope(own[0]),)
        return jax.jvp(slope, (own[0],), (jnp.ones_like(own[0]),))

    return Printed(name, derivatives, arguments)


def _in_nodes(
    name: str,
    energy: Callable[..., Array],
    size: int,
    rest: Sequence[str],
    parameters: Sequence[str],
    kind: Kind,
) -> Printed:
    """Print the gradient of an element's energy in its nodes, or its JVP.

    Args:
        name: of the printed function.
        energy: of tuples of coordinates, rest data, and parameters by order.
        size: number of nodes.
        rest: names of the rest data.
        parameters: names of the parameters.
        kind: "force" for the gradient.
    """
    here, way = _names("x", 3 * size), _names("v", 3 * size)
    arguments = (*here, *(way if kind == "product" else ()), *rest, *parameters)

    def derivatives(*numbers: Array) -> tuple[Array, ...]:
        behind = len(arguments) - len(rest) - len(parameters)
        data = numbers[behind : behind + len(rest)]
        p = numbers[behind + len(rest) :]

        def gradient(*x: Array) -> tuple[Array, ...]:
            def of_element(*at: Array) -> Array:
                nodes = tuple(tuple(at[3 * k : 3 * k + 3]) for k in range(size))
                return energy(nodes, data, p)

            return jax.grad(of_element, argnums=tuple(range(3 * size)))(*x)

        x = numbers[: 3 * size]
        if kind == "force":
            return gradient(*x)
        return jax.jvp(gradient, x, numbers[3 * size : 6 * size])[1]

    return Printed(name, derivatives, arguments)


def pair_root(kind: Kind) -> Root:
    """Build the root of `jaxgrow.energy.pair`; the first number is the cutoff."""
    law = _law("law", PAIRS.energy, ("u", "one", "other"), PAIRS, kind)
    given = (
        f"nodes[:count], tumour, listed, numbers[0], {_tuple(1, len(PAIRS.parameters))}"
    )
    call = f"pair.add_forces(law, {given}, out[:count])"
    loops, blocks = "", ()
    if kind == "product":
        call = f"pair.add_products(law, {given}, along[:count], out[:count])"
        blocks = (f"pair.add_blocks(law, {given}, out[:count])",)
    else:
        loops = _RENEW.format(p=_tuple(1, len(PAIRS.parameters)))
    return Root(f"pair_{kind}", (law,), loops, BUFFERS["pair"], (call,), blocks)


_RENEW = """
@njit(cache=True)
def renew(position, tumour, alive, before, alive_before, changed, numbers, force):
    cutoff, p = numbers[0], {p}
    vicinity.renew(
        law, position, tumour, alive, before, alive_before, changed, cutoff, p, force
    )
"""


def contact_root(kind: Kind) -> Root:
    """Build the root of `jaxgrow.energy.contact`.

    Its numbers are range, half sharpness, reach, law.
    """
    law = _law("law", CONTACT.energy, ("u",), CONTACT, kind)
    given = (
        "nodes[:count], nodes[count:], alive, particle, corners, real, "
        f"numbers[0], numbers[1], numbers[2], {_tuple(3, len(CONTACT.parameters))}"
    )
    results = "out[:count], out[count:], clear[:count], clear[count:]"
    call, blocks = f"contact.add_forces(law, {given}, {results})", ()
    if kind == "product":
        results = "along[:count], along[count:], out[:count], out[count:]"
        call = f"contact.add_products(law, {given}, {results})"
        blocks = (f"contact.add_blocks(law, {given}, out[:count], out[count:])",)
    return Root(f"contact_{kind}", (law,), "", BUFFERS["contact"], (call,), blocks)


def collision_root(kind: Kind) -> Root:
    """Build the root of `jaxgrow.energy.collision`.

    Its numbers are range, half sharpness, laws.
    """
    names = COLLISION.parameters

    def of_edges(x: Any, rest: Any, p: Any) -> Array:
        by_name = SimpleNamespace(**dict(zip(names, p, strict=True)))
        return COLLISION.wall_of_edges(x, segment_distance(*x), rest[0], by_name)

    functions = (
        _law("law", COLLISION.energy, ("u",), COLLISION, kind),
        _law("wall", COLLISION.wall, ("distance", "margin"), COLLISION, kind),
        _in_nodes(
            "wall_of_edges", of_edges, 4, ("margin",), [f"p_{n}" for n in names], kind
        ),
    )
    p = _tuple(2, len(names))
    vertices = "points, vertex, corners, apart, margin, numbers[0], numbers[1]"
    edges = "points, edges, edge_margin, numbers[0]"
    results = "out[count:], clear[count:]"
    add, blocks = "forces", ()
    if kind == "product":
        add, results = "products", "along[count:], out[count:]"
        blocks = (
            "points = nodes[count:]",
            f"collision.add_blocks(law, wall, {vertices}, {p}, out[count:])",
        )
    statements = (
        "points = nodes[count:]",
        f"collision.add_{add}(law, wall, {vertices}, {p}, {results})",
        f"collision.add_{add}_of_edges(wall_of_edges, {edges}, {p}, {results})",
    )
    buffers = BUFFERS["collision"]
    return Root(f"collision_{kind}", functions, "", buffers, statements, blocks)


def element_root(term: Term, rest: int, kind: Kind) -> Root:
    """Build the root of a term whose energy is a sum over elements.

    Args:
        term: the term.
        rest: number of rest data of an element.
        kind: "force" or "product".
    """
    names, leaves = term.parameters, jax.tree.leaves(term)
    structure = jax.tree.structure(term)

    def energy(x: Any, data: Any, p: Sequence[Array]) -> Array:
        own = jax.tree.unflatten(structure, p[len(names) :])
        by_name = SimpleNamespace(**dict(zip(names, p, strict=False)))
        return own.energy(x, data, by_name)

    data, count = _names("q", rest), len(names) + len(leaves)
    own = _in_nodes("element", energy, term.size, data, _names("p", count), kind)
    corners = [f"a{k}" for k in range(term.size)]
    here = [f"nodes[{a}, {axis}]" for a in corners for axis in range(3)]
    way = [f"along[{a}, {axis}]" for a in corners for axis in range(3)]
    given = [*here, *(way if kind == "product" else [])]
    given += [f"rest[e, {k}]" for k in range(rest)]
    given += [f"p[{k}]" for k in range(count)]
    sign = "-" if kind == "force" else "+"
    lines = [
        *("@regrouped", "def add(nodes, along, stencil, rest, alive, p, out):"),
        "    for e in range(len(alive)):",
        "        if alive[e]:",
        *(f"            {a} = stencil[e, {k}]" for k, a in enumerate(corners)),
        f"            g = element({', '.join(given)})",
        *(
            f"            out[{a}, {axis}] {sign}= g[{3 * k + axis}]"
            for k, a in enumerate(corners)
            for axis in range(3)
        ),
        "",
    ]
    p = _tuple(0, count)
    call = f"add(nodes, along, stencil, rest, alive, {p}, out)"
    source, blocks = "\n".join(lines), ()
    if kind == "product":
        source += _BLOCKS
        blocks = (f"add_blocks(nodes, stencil, rest, alive, {p}, out)",)
    buffers = BUFFERS["elements"]
    return Root(f"{term.name}_{kind}", (own,), source, buffers, (call,), blocks)


_BLOCKS = """
@regrouped
def add_blocks(nodes, stencil, rest, alive, p, out):
    way, product = np.zeros(nodes.shape), np.zeros(nodes.shape)
    for e in range(len(alive)):
        if not alive[e]:
            continue
        own, data, on = stencil[e : e + 1], rest[e : e + 1], alive[e : e + 1]
        for node in own[0]:
            for axis in range(3):
                way[node, axis] = 1.0
                add(nodes, way, own, data, on, p, product)
                way[node, axis] = 0.0
                for k in range(3):
                    out[node, 3 * axis + k] += product[node, k]
                    for other in own[0]:
                        product[other, k] = 0.0
"""
"""Columns of a node's block are products of one element with its unit displacements."""
