"""Linear response (compliance) of an equilibrium to small forces."""

from typing import NamedTuple

import equinox as eqx

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.extra_terms import ExtraTerms
from jaxgrow.equilibrium.hessian_solve import linearise, respond, Response
from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.loops import with_loops
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists, fits, prepared
from jaxgrow.equilibrium.transformations import (
    check_transformations,
    check_undifferentiated,
)
from jaxgrow.numerics.guards import check_precision
from jaxgrow.runtime.results import Result
from jaxgrow.runtime.types import Given
from jaxgrow.state import Membrane, Nodes, Particles
from jaxgrow.transfer.array_checks import accept_bodies, accept_vectors


class LinearResponse(NamedTuple):
    """Outcome of `linear_response`.

    Attributes:
        displacement: of every node, in r0; 0 where it may not move, NaN throughout if
            the result is not CONVERGED.
        result: CONVERGED, SINGULAR (not a strict minimum) or NOT_SOLVED.
        residual: |H δx − f| / |f|, dimensionless.
        products: number of Hessian products; each costs about two force evaluations.
        softest: upper bound of the lowest eigenvalue of H, null modes apart, in
            F(0)/r0; infinite if nothing has a stiffness.
        null_modes: rigid modes, and three for each particle that touches nothing.
    """

    displacement: Nodes
    result: Result
    residual: float
    products: int
    softest: float
    null_modes: int


@eqx.filter_jit
def _respond(problem: Problem, lists: Lists, forces: Nodes) -> Response:
    return respond(linearise(problem, lists), forces)


def linear_response(
    particles: Particles | None,
    membrane: Membrane | None = None,
    *,
    forces: Nodes,
    parameters: Parameters | None = None,
    load: Given | None = None,
    lists: Lists | None = None,
    terms: ExtraTerms = (),
) -> LinearResponse:
    r"""Compute the displacement of an equilibrium under small forces.

    .. math:: H\, \delta x = f, \qquad H = \nabla^2 E(x^*)

    on the free nodes, with the components of :math:`f` and :math:`\delta x` in the null
    modes of H removed (`jaxgrow.equilibrium.hessian_solve`). The derivatives of `relax`
    solve the same system; where they are NaN, the result here says why.

    Args:
        particles: at equilibrium (`relax` them first, to 1e-10); None for a membrane
            alone.
        membrane: at equilibrium; None for particles alone.
        forces: on every particle and vertex, padding included, in F(0). Those on held,
            pinned and padding rows have no effect.
        parameters: of the energy; the default `Parameters()`.
        load: external force on every vertex under which it is an equilibrium, (m, 3),
            in F(0). It has no stiffness, but if nothing is pinned it fixes the
            orientation.
        lists: of the relaxation, to save their allocation. Without them collisions are
            ignored, so a surface that collides requires them.
        terms: additional energies, as in the relaxation.

    Returns:
        The displacement in r0, whether it is valid, and the cost.

    Raises:
        ValueError: there are neither particles nor a membrane, an array has a wrong
            shape or kind of numbers, a vertex has moved since the collisions were
            listed, a derivative is being taken, values are withheld, or JAX computes in
            32 bits and the positions have 64.
    """
    if particles is None and membrane is None:
        raise ValueError("nothing responds: give particles, a membrane, or both.")
    particles, membrane = accept_bodies(particles, membrane)
    position = None if particles is None else particles.position
    vertices = None if membrane is None else membrane.vertices
    acting = Nodes(
        accept_vectors("forces.particles", forces.particles, position),
        accept_vectors("forces.vertices", forces.vertices, vertices),
    )
    check_precision(Problem(particles, membrane, Parameters()).dtype)
    if load is not None:
        load = accept_vectors("load", load, vertices)
    problem = Problem.of(particles, membrane, parameters, load, terms)
    check_transformations((problem, acting))
    check_undifferentiated(
        (problem, acting),
        "a linear response",
        "differentiate what jaxgrow.relax returns",
    )
    lists = _lists(problem, lists)
    found = _respond(with_loops(problem, lists, products=True), lists, acting)
    return LinearResponse(
        found.nodes,
        Result.of(found.code),
        float(found.residual),
        int(found.products),
        float(found.softest),
        int(found.null_modes),
    )


def _lists(problem: Problem, lists: Lists | None) -> Lists:
    """Return lists that are valid at the problem's nodes.

    Raises:
        ValueError: those of collisions are not.
    """
    if lists is None or not fits(problem, lists):
        return allocate_lists(problem)
    now = prepared(problem, lists, None)
    if lists.collisions is None or problem.membrane is None:
        return now
    collisions, vertices = lists.collisions, problem.membrane.vertices
    same = collisions.reference.shape == vertices.shape
    if not same or bool(collisions.checked(vertices).stale):
        raise ValueError(
            "a vertex has moved too far since the collisions were listed; relax the "
            "state, and pass the lists of that relaxation."
        )
    return now.with_collisions(collisions)
