r"""Solution of the Hessian's linear system by conjugate gradients.

At an equilibrium :math:`x^*` the free forces vanish, and small forces f move it by

.. math:: H\, \delta x = f, \qquad H = \nabla^2 E(x^*)

which is what a Newton step and the derivative of an equilibrium need. H is never
formed: conjugate gradients use Hessian products (Hestenes and Stiefel 1952), each of
which costs about two force evaluations.

*Null modes.* If nothing is pinned, the null space of H holds the six rigid motions
(under a load, only the three translations), and always the motions of a particle that
touches nothing. Response and forces are projected on its complement; its dimension is
reported.

*Checks.* A direction of negative or zero curvature means that this is not a minimum, or
that it has further null modes (SINGULAR); a residual that stays too large gives
NOT_SOLVED. Then the response is NaN, never a number. Forces that share a symmetry of
the equilibrium do not excite modes that break it, so a column that is about to buckle
responds to a load along its axis as if it were stable. `probe` therefore solves for a
force without any symmetry: residual polynomials of conjugate gradients are 1 at the
eigenvalue 0, and above 1 at negative ones as long as all curvatures met are positive,
so the component of that force along such an eigenvector does not vanish, and
convergence proves that there is none (up to the residual).
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from jaxgrow.equilibrium import loops
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.products import hessian_product
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.types import Scalar
from jaxgrow.state import Nodes


MAX_PRODUCTS = 4000
"""Bound on the Hessian products of one response."""

_SEEN = 1e-6
"""Least relative component of the force without symmetry that is assumed in every
mode."""

Product = Callable[[Nodes], Nodes]


class Response(eqx.Module):
    """Linear response of an equilibrium to forces.

    Attributes:
        nodes: displacement of every node, in r0; NaN if `code` is not CONVERGED.
        residual: |H δx − f| / |f|.
        products: number of Hessian products.
        softest: smallest curvature met, in F(0)/r0: an upper bound of the lowest
            eigenvalue of H (null modes apart); infinite if none was met.
        null_modes: rigid modes, and three for each particle that touches nothing.
        code: of the `Result`: CONVERGED, SINGULAR or NOT_SOLVED.
    """

    nodes: Nodes
    residual: Float[Array, ""]
    products: Int[Array, ""]
    softest: Float[Array, ""]
    null_modes: Int[Array, ""]
    code: Int[Array, ""]


class Linearised(NamedTuple):
    """Problem linearised at its nodes.

    Attributes:
        force: on all nodes, in F(0), 0 on those that may not move.
        product: H v.
        feel: sets rows of a vector to 0 that may not move or touch nothing.
        project: removes the rigid modes as well.
        null_modes: their number.
        uneven: a force without any symmetry, on every row.
        respond: the response to a force, by one loop; None where there is none.
    """

    force: Nodes
    product: Product
    feel: Product
    project: Product
    null_modes: Int[Array, ""]
    uneven: Nodes
    respond: Callable[[Nodes, Scalar], Response] | None = None


def solved(dtype: DTypeLike) -> float:
    """Return the relative residual at which a response counts as exact."""
    return 1e-10 if jnp.finfo(dtype).bits > 32 else 1e-4


def _flat(dtype: DTypeLike) -> float:
    """Return the relative curvature below which a direction is a null mode."""
    return 1e-9 if jnp.finfo(dtype).bits > 32 else 1e-5


def dot(first: Nodes, second: Nodes) -> Float[Array, ""]:
    """Return the scalar product over all nodes."""
    products = jax.tree.map(lambda a, b: jnp.sum(a * b), first, second)
    return jnp.sum(jnp.stack(jax.tree.leaves(products)))


def _plus(first: Nodes, factor: Scalar, second: Nodes) -> Nodes:
    return jax.tree.map(lambda a, b: a + factor * b, first, second)


def linearise(problem: Problem, lists: Lists) -> Linearised:
    """Compute the forces and their derivative at the problem's nodes."""
    free = problem.free()

    def masked(nodes: Nodes) -> Nodes:
        return jax.tree.map(jnp.multiply, free, nodes)

    force = problem.forces(problem.nodes(), lists)
    hessian = hessian_product(problem, problem.nodes(), lists)

    def product(vector: Nodes) -> Nodes:
        return masked(hessian(masked(vector)))

    uneven = jax.tree.map(_uneven, problem.nodes())
    touching, rigid, count = _null_modes(problem, product(uneven))

    def feel(vector: Nodes) -> Nodes:
        return jax.tree.map(jnp.multiply, touching, vector)

    def project(vector: Nodes) -> Nodes:
        return _without(rigid, feel(vector))

    looped = problem.loops is not None and problem.loops.product is not None
    looped = looped and problem.is_looped(lists)

    def respond(vector: Nodes, relative: Scalar) -> Response:
        loose = _unpinned(problem)
        may = loose, loose & _unloaded(problem)
        limits = relative, MAX_PRODUCTS, _flat(problem.dtype)
        found = loops.solve(problem, lists, vector, limits, uneven=uneven, loose=may)
        (residual, softest), (products, modes, code) = found.numbers, found.counts
        nodes = found.displacement
        return Response(nodes, residual, products, softest, modes, code)

    given = masked(force), product, feel, project, count, uneven
    return Linearised(*given, respond if looped else None)


def _uneven(rows: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """Return numbers of either sign without pattern, none of them 0."""
    index = jnp.arange(rows.size).reshape(rows.shape)
    return jnp.sin(1.0 + index.astype(rows.dtype) ** 2)


def _null_modes(problem: Problem, felt: Nodes) -> tuple[Nodes, Nodes, Int[Array, ""]]:
    """Find the rows with stiffness, the rigid modes, and the nullity.

    A row of H that gives exactly 0 for a vector without zeros is a particle that
    touches nothing. A rigid mode that does not exist (something is pinned or loaded,
    fewer than three particles) is 0; the others are orthonormal.

    Args:
        problem: at the equilibrium.
        felt: the product of H with a vector without zeros.

    Returns:
        1 for rows with stiffness, else 0; the rigid modes; the number of null modes.
    """
    nodes, free = problem.nodes(), problem.free()

    def rows_felt(row: Float[Array, "n 3"], able: Float[Array, "n 3"]) -> Array:
        return jnp.where(jnp.any(row != 0, axis=1, keepdims=True), able, 0)

    touching = jax.tree.map(rows_felt, felt, free)

    def rows(flags: Nodes) -> Array:
        return jnp.sum(jnp.concatenate(jax.tree.leaves(flags))[:, 0])

    count = (3 * (rows(free) - rows(touching))).astype(int)
    loose, unloaded = _unpinned(problem), _unloaded(problem)
    centre = sum(
        jnp.sum(t * x, axis=0)
        for t, x in zip(jax.tree.leaves(touching), jax.tree.leaves(nodes), strict=True)
    )
    centre = centre / jnp.maximum(rows(touching), 1)
    axes = jnp.eye(3, dtype=centre.dtype)[:, None, :]

    def motions(t: Float[Array, "n 3"], x: Float[Array, "n 3"]) -> Array:
        shifts = jnp.broadcast_to(axes, (3, *x.shape))
        turns = jnp.cross(axes, (x - centre[None, :])[None])
        return t[None] * jnp.concatenate([shifts, turns])

    modes = jax.tree.map(motions, touching, nodes)
    able = loose & jnp.array([True] * 3 + [False] * 3) | loose & unloaded
    rounding = jnp.sqrt(jnp.finfo(centre.dtype).eps)

    def add(number: Array, found: tuple[Nodes, Array]) -> tuple[Nodes, Array]:
        """Make a mode orthonormal to those before (the rest of them is still 0)."""
        known, count = found
        mode = jax.tree.map(lambda m: m[number], modes)
        size = jnp.sqrt(dot(mode, mode))
        mode = _without(known, _without(known, mode))  # twice is enough
        length = jnp.sqrt(dot(mode, mode))
        there = able[number] & (length > rounding * jnp.maximum(size, 1))
        scale = jnp.where(there, 1 / jnp.where(there, length, 1), 0)
        known = jax.tree.map(lambda k, m: k.at[number].set(scale * m), known, mode)
        return known, count + there.astype(int)

    nothing = jax.tree.map(jnp.zeros_like, modes)
    rigid, count = jax.lax.fori_loop(0, 6, add, (nothing, count))
    return touching, rigid, count


def _without(modes: Nodes, vector: Nodes) -> Nodes:
    """Project orthonormal modes out of a vector (Gram and Schmidt).

    The modes are stacked along the first axis; a mode that is 0 has no effect.
    """
    each = jax.tree.map(lambda m, v: jnp.tensordot(m, v, 2), modes, vector)
    parts = jnp.sum(jnp.stack(jax.tree.leaves(each)), axis=0)
    return jax.tree.map(lambda m, v: v - jnp.tensordot(parts, m, 1), modes, vector)


def _unpinned(problem: Problem) -> Bool[Array, ""]:
    """Return whether nothing at all is held."""
    loose = jnp.ones((), bool)
    if problem.particles is not None:
        loose &= ~jnp.any(problem.particles.alive & problem.particles.held)
    if problem.membrane is not None:
        loose &= ~jnp.any(problem.membrane.vertex_alive & problem.membrane.pinned)
    return loose


def _unloaded(problem: Problem) -> Bool[Array, ""]:
    """Return whether there is no load, which would break rotation symmetry."""
    if problem.load is None or problem.membrane is None:
        return jnp.ones((), bool)
    return ~jnp.any((problem.load != 0) & problem.membrane.free[:, None])


class _Search(eqx.Module):
    """State of the conjugate gradients.

    The last iteration computes the product with the solution, so that a product is
    compiled once.
    """

    x: Nodes
    r: Nodes
    p: Nodes
    square: Float[Array, ""]
    stiffest: Float[Array, ""]
    softest: Float[Array, ""]
    products: Int[Array, ""]
    flat: Bool[Array, ""]
    hx: Nodes
    checked: Bool[Array, ""]


def solve(linear: Linearised, force: Nodes, relative: Scalar | None = None) -> Response:
    """Solve for the response to forces, by conjugate gradients.

    Args:
        linear: of a problem at an equilibrium, or near one.
        force: on every node, in F(0); its part in the null modes is left out.
        relative: residual at which to stop, over the force; by default that of
            `solved`.
    """
    if relative is None:
        relative = solved(jax.tree.leaves(force)[0].dtype)
    if linear.respond is not None:
        return linear.respond(force, relative)
    given = linear.feel(force)
    b, whole = linear.project(given), dot(given, given)
    dtype = whole.dtype
    # the projection of a purely rigid force is rounding, which has no solution
    rounding = (100 * jnp.finfo(dtype).eps) ** 2 * whole
    nothing = jnp.isfinite(whole) & (dot(b, b) <= rounding)
    b = jax.tree.map(lambda a: jnp.where(nothing, 0, a), b)
    size = dot(b, b)
    zero = jax.tree.map(jnp.zeros_like, b)
    start = _Search(
        zero,
        b,
        b,
        size,
        jnp.zeros((), dtype),
        jnp.asarray(jnp.inf, dtype),
        jnp.zeros((), int),
        jnp.zeros((), bool),
        zero,
        jnp.zeros((), bool),
    )
    goal = relative**2 * size

    def step(now: _Search) -> _Search:
        searching = (now.square > goal) & (now.products < MAX_PRODUCTS) & ~now.flat
        x = linear.project(now.x)
        vector = jax.tree.map(lambda p, x: jnp.where(searching, p, x), now.p, x)
        product = linear.project(linear.product(vector))
        after = searched(now, product)
        checked = eqx.tree_at(
            lambda s: (s.x, s.hx, s.checked), now, (x, product, jnp.ones((), bool))
        )
        return jax.tree.map(lambda a, b: jnp.where(searching, a, b), after, checked)

    def searched(now: _Search, hp: Nodes) -> _Search:
        length = dot(now.p, now.p)
        curvature = dot(now.p, hp) / length
        stiffest = jnp.maximum(now.stiffest, jnp.abs(curvature))
        flat = ~(curvature > _flat(dtype) * stiffest)
        rate = now.square / jnp.where(flat, 1, curvature * length)
        rate = jnp.where(flat, 0, rate)
        r = _plus(now.r, -rate, hp)
        square = dot(r, r)
        return _Search(
            _plus(now.x, rate, now.p),
            r,
            _plus(r, square / now.square, now.p),
            square,
            stiffest,
            jnp.minimum(now.softest, curvature),
            now.products + 1,
            flat,
            now.hx,
            now.checked,
        )

    end = jax.lax.while_loop(lambda now: ~now.checked, step, start)
    x, hx = end.x, end.hx
    left, length = _plus(hx, -1.0, b), dot(x, x)
    residual = jnp.sqrt(dot(left, left) / jnp.where(size > 0, size, 1))
    residual = jnp.where(jnp.isfinite(size), residual, jnp.nan)
    curvature = dot(x, hx) / jnp.where(length > 0, length, 1)
    code = jnp.where(
        end.flat,
        Result.SINGULAR.code,
        jnp.where(
            residual <= 10 * relative, Result.CONVERGED.code, Result.NOT_SOLVED.code
        ),
    )
    return Response(
        _or_nan(x, code),
        residual,
        end.products,
        jnp.minimum(end.softest, jnp.where(length > 0, curvature, jnp.inf)),
        linear.null_modes,
        code,
    )


def probe(linear: Linearised) -> Response:
    """Test for a strict minimum: the response to a force without symmetry.

    Only there it is CONVERGED.

    It is solved only to the residual that the proof needs.

    Args:
        linear: of a problem at an equilibrium.
    """
    dtype = jax.tree.leaves(linear.force)[0].dtype
    return solve(linear, linear.uneven, max(_SEEN, solved(dtype)))


def respond(linear: Linearised, force: Nodes) -> Response:
    """Solve for the response to forces, if the equilibrium is stable.

    Args:
        linear: of a problem at an equilibrium.
        force: on every node, in F(0); its part in the null modes is left out.
    """
    dtype = jax.tree.leaves(linear.force)[0].dtype
    forces = jax.tree.map(lambda a, b: jnp.stack([a, b]), force, linear.uneven)
    relative = jnp.asarray([solved(dtype), max(_SEEN, solved(dtype))], dtype)
    # a loop over both, so that the solver is compiled once
    both = jax.lax.map(lambda one: solve(linear, *one), (forces, relative))
    found, any_force = (jax.tree.map(lambda a, k=k: a[k], both) for k in (0, 1))
    stable = any_force.code == Result.CONVERGED.code
    code = jnp.where(stable, found.code, any_force.code)
    return Response(
        _or_nan(found.nodes, code),
        found.residual,
        any_force.products + found.products,
        jnp.minimum(any_force.softest, found.softest),
        found.null_modes,
        code,
    )


def _or_nan(nodes: Nodes, code: Int[Array, ""]) -> Nodes:
    good = code == Result.CONVERGED.code
    return jax.tree.map(lambda a: jnp.where(good, a, jnp.nan), nodes)
