"""Rows: one evaluation of the forces, against the numba loop over the same lists."""

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from jaxgrow.equilibrium.lists import Lists
from jaxgrow.equilibrium.problem import Problem
from jaxgrow.equilibrium.refresh_lists import allocate_lists
from jaxgrow.neighbors import cell_list as cells
from jaxgrow.neighbors.verlet_list import find_near
from jaxgrow.state import Nodes
from jaxgrow.transfer.device import get

from .errors import extended_forces, relative
from .measure import measure_in_turns, Options, Row
from .pairs import pair_forces
from .scenes import dense_ball, LOOSE, neighbours_of, particles_of, polyp


IN_LOOP = "jaxgrow in a loop"

SAMPLE = 300
"""Particles whose force is computed in extended precision too."""


@jax.jit
def forces(problem: Problem, lists: Lists) -> Any:
    """What the relaxation of jaxgrow evaluates in every step."""
    return problem.forces(problem.nodes(), lists)


REPEATED = 64
"""Evaluations within a program, for one without the call of the program."""


@jax.jit
def repeated(problem: Problem, lists: Lists) -> Any:
    """Forces so many times, as a relaxation evaluates them: within a compiled loop."""

    def again(_: Any, nodes: Nodes) -> Nodes:
        force = problem.forces(nodes, lists)
        # so little that nothing changes, and yet each needs the one before
        return jax.tree.map(lambda x, f: x + 1e-15 * f, nodes, force)

    return jax.lax.fori_loop(0, REPEATED, again, problem.nodes())


def pair_force(options: Options, count: int) -> Iterator[Row]:
    """Pair forces in a jittered dense ball."""
    position = dense_ball(count, np.random.default_rng(0), spacing=LOOSE)
    particles = particles_of(position)
    problem = Problem.of(particles, None)
    lists = allocate_lists(problem)
    start, index = neighbours_of(lists, get(particles.alive))
    out = np.zeros_like(position)

    def numba(_: int) -> Float[np.ndarray, "n 3"]:
        return pair_forces(position, start, index, out=out)

    measured = measure_in_turns(
        {"jaxgrow": lambda _: forces(problem, lists), "numba": numba},
        options,
    )
    found = get(measured.outcomes["jaxgrow"][-1].particles)
    sample = np.random.default_rng(1).choice(count, SAMPLE, replace=False)
    exact = extended_forces(position, start, index, sample, adhesion=0.2, smoothing=0.1)
    assert lists.neighbors is not None
    yield Row(
        f"pair-force-{count // 1000}k",
        "one pair-force evaluation: jaxgrow over numba, same list",
        **measured.compare("jaxgrow", "numba"),
        bar=1.3,
        errors={
            "jaxgrow against numba": relative(found, out),
            "jaxgrow": relative(found[sample], exact),
            "numba": relative(out[sample], exact),
        },
        details={
            "particles": count,
            "listed_per_particle": len(index) / count,
            "slots_per_particle": lists.neighbors.listed.shape[0],
            "nanoseconds_per_listed_pair": {
                name: 1e9 * float(np.median(all_)) / len(index)
                for name, all_ in measured.seconds.items()
            },
        },
    )


def pair_force_10k(options: Options) -> Iterator[Row]:
    """Pair forces of 10 000 particles."""
    return pair_force(options, 10_000)


def pair_force_100k(options: Options) -> Iterator[Row]:
    """Pair forces of 100 000 particles."""
    return pair_force(options, 100_000)


@jax.jit
def near_anew(problem: Problem, lists: Lists) -> Any:
    """Who is near, found in the wide list."""
    assert problem.particles is not None
    assert lists.neighbors is not None
    room = lists.neighbors.listed.shape[0]
    return find_near(problem.particles.position, lists.neighbors.wide.idx, room)


@jax.jit
def wide_anew(problem: Problem, lists: Lists) -> Any:
    """The wide list, made by cells of space."""
    assert problem.particles is not None
    assert lists.neighbors is not None
    return cells.relist(lists.neighbors.wide, problem.particles.position).idx


def lists_10k(options: Options) -> Iterator[Row]:
    """What it costs to make the lists of 10 000 particles anew, beside their forces."""
    count = 1000 if options.quick else 10_000
    position = dense_ball(count, np.random.default_rng(0), spacing=LOOSE)
    problem = Problem.of(particles_of(position), None)
    lists = allocate_lists(problem)
    measured = measure_in_turns(
        {
            "forces": lambda _: forces(problem, lists),
            "near": lambda _: near_anew(problem, lists),
            "wide": lambda _: wide_anew(problem, lists),
        },
        options,
    )
    listed, _ = measured.outcomes["near"][-1]
    assert lists.neighbors is not None
    wanted = np.sort(get(lists.neighbors.listed), axis=0)
    wrong = float((np.sort(get(listed), axis=0) != wanted).sum())
    for name, what in (("near", "near neighbours found"), ("wide", "wide list made")):
        yield Row(
            f"{name}-list-10k",
            f"{what} anew, over one evaluation of the pair forces",
            **measured.compare(name, "forces"),
            errors={"entries that differ": wrong},
            details={"particles": count},
        )


def contact_force(options: Options) -> Iterator[Row]:
    """Pairs, contact and springs of a polyp, against exact point-triangle contact."""
    scene = polyp(60 if options.quick else 200)
    exact, smooth = scene.loop(smooth=False), scene.loop(smooth=True)
    measured = measure_in_turns(
        {
            "jaxgrow": lambda _: forces(scene.problem, scene.lists),
            IN_LOOP: lambda _: repeated(scene.problem, scene.lists),
            "numba": lambda _: exact(),
            "numba, smooth minimum": lambda _: smooth(),
        },
        options,
    )
    for seconds in (measured.seconds, measured.cpu_seconds):
        seconds[IN_LOOP] = [each / REPEATED for each in seconds[IN_LOOP]]
    found = scene.of_living(measured.outcomes["jaxgrow"][-1])
    loops = {name: measured.outcomes[name][-1] for name in list(measured.outcomes)[2:]}
    assert scene.lists.contacts is not None
    assert scene.lists.neighbors is not None
    shared: dict[str, Any] = {
        "bar": 2.0,
        "errors": {
            "jaxgrow against the same law": relative(
                found, loops["numba, smooth minimum"]
            ),
            "jaxgrow against the nearest triangle": relative(found, loops["numba"]),
        },
        "details": {
            "particles": len(scene.position),
            "slots": scene.lists.neighbors.listed.shape[1],
            "listed_per_particle": len(scene.neighbours[1]) / len(scene.position),
            "slots_per_particle": scene.lists.neighbors.listed.shape[0],
            "faces": len(scene.faces),
            "contacts": len(scene.contacts[1]),
            "slots_of_contacts": scene.lists.contacts.particle.shape[0],
            "over_the_same_law": float(
                np.median(
                    measured.compare("jaxgrow", "numba, smooth minimum")["ratios"]
                )
            ),
        },
    }
    yield Row(
        "contact-force",
        "one force evaluation of a polyp with contact: jaxgrow over numba",
        **measured.compare("jaxgrow", "numba"),
        **shared,
    )
    yield Row(
        "contact-force-in-a-loop",
        "the same within a compiled loop, as in a relaxation: jaxgrow over numba",
        **measured.compare(IN_LOOP, "numba"),
        **shared,
    )
