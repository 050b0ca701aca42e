"""Yardsticks of speed, and the check that they compute what jaxgrow computes.

    python experiments/benchmarks/baselines.py --check

compares every yardstick with jaxgrow's own functions on random input, prints the
relative errors, and ends with status 1 if one is above its bound. All are numba loops
on one thread in 64 bits, but jax-md:

- `list_neighbours`: full list by a cell sort;
- `pair_forces`: A2 over such a list, each pair from both sides, nothing scattered;
- `contact_forces`, `add_spring_forces`: exact point-triangle contact and the springs;
- `relax_lbfgs`: force-only L-BFGS, all of it one program;
- `relax_jax_md`: jax-md as it comes.
"""

import argparse
import sys
from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from speed.contact import (
    add_spring_forces as add_spring_forces,
    contact_forces as contact_forces,
    ContactLaw as ContactLaw,
)
from speed.errors import errors_of, relative, residual, superposed
from speed.fire import a2_energy, FIRE as FIRE, relax_jax_md as relax_jax_md
from speed.lbfgs import relax_lbfgs as relax_lbfgs, Relaxed as Relaxed
from speed.measure import configure, Options
from speed.pairs import list_neighbours as list_neighbours, pair_forces as pair_forces
from speed.scenes import contact_law, dense_ball, particles_of, runs_of

import jaxgrow as jg
from jaxgrow.energy.contact import (
    contact_distances,
    contact_energy,
    Contacts,
    list_contacts,
    reach,
)
from jaxgrow.energy.distance import point_triangle_distance
from jaxgrow.energy.pair import pair_force
from jaxgrow.energy.springs import Springs
from jaxgrow.energy.term import energy_of_elements
from jaxgrow.transfer.device import put_particles


BOUND = 1e-12
"""Of errors that only rounding may cause."""

LEAST_GAP = 0.02
"""Distance, in r0, below which rounding of places makes directions unsure."""

LAWS = {
    "default": jg.Parameters(),
    "stiff tumour": jg.Parameters(tumour_stiffness=3.0),
    "no smoothing": jg.Parameters(adhesion=0.3, smoothing=0.0, tumour_stiffness=2.0),
    "no adhesion, wide": jg.Parameters(adhesion=0.0, smoothing=0.5),
}


def check_list() -> Iterator[tuple[str, float, float]]:
    """The same pairs as those of a tree, in a ball, a line and a far-flung pair."""
    rng = np.random.default_rng(0)
    line = np.zeros((500, 3))
    line[:, 1] = rng.uniform(0, 200, 500)
    shapes = {
        "ball": dense_ball(3000, rng) + np.array([7.0, -40.0, 0.3]),
        "line": line,
        "one": np.zeros((1, 3)),
        "far apart": np.concatenate([dense_ball(300, rng), np.full((1, 3), 1e5)]),
    }
    for name, position in shapes.items():
        start, index = list_neighbours(position)
        owner = np.repeat(np.arange(len(position)), np.diff(start))
        pairs = KDTree(position).query_pairs(1.9, output_type="ndarray")
        wanted = {tuple(p) for p in np.concatenate([pairs, pairs[:, ::-1]]).tolist()}
        found = list(zip(owner.tolist(), index.tolist(), strict=True))
        twice = len(found) - len(set(found))
        yield f"list, {name}: pairs wrong", len(set(found) ^ wanted) + twice, 0


def check_pairs() -> Iterator[tuple[str, float, float]]:
    """Pair forces of a mixed, crowded ball with two particles at one place."""
    rng = np.random.default_rng(1)
    position = 0.9 * dense_ball(2000, rng, 0.2)
    position[1] = position[0]
    tumour = rng.random(len(position)) < 0.5
    start, index = list_neighbours(position)
    width = int(np.diff(start).max())
    listed = np.full((width, len(position)), len(position))
    for i in range(len(position)):
        mine = index[start[i] : start[i + 1]]
        listed[: len(mine), i] = mine
    particles = put_particles(
        position, tumour.astype(np.int64), np.zeros(len(position), bool), len(position)
    )
    for name, law in LAWS.items():
        wanted = np.asarray(pair_force(particles, jnp.asarray(listed), law))
        found = pair_forces(
            position,
            start,
            index,
            adhesion=float(law.adhesion),
            smoothing=float(law.smoothing),
            tumour_stiffness=float(law.tumour_stiffness),
            tumour=tumour,
        )
        yield f"pair forces, {name}", relative(found, wanted), BOUND


def by_rows(force: Float[np.ndarray, "n 3"], wanted: Float[np.ndarray, "n 3"]) -> float:
    """Largest error of a row, relative to it where it is larger than F(0)."""
    size = np.maximum(np.linalg.norm(wanted, axis=1), 1.0)
    return float((np.linalg.norm(force - wanted, axis=1) / size).max())


def bumpy_sheet(side: int, rng: np.random.Generator) -> jg.Membrane:
    """A square grid of triangles with bumps, its springs not at rest."""
    y, x = np.mgrid[:side, :side]
    vertices = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(float)
    vertices += 0.2 * rng.normal(size=vertices.shape)
    index = np.arange(side * side).reshape(side, side)
    a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    c, d = index[1:, 1:].ravel(), index[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    membrane = jg.make_membrane(vertices, faces, pinned=False)
    length = membrane.rest_length
    return membrane.with_rest_length(length * rng.uniform(0.7, 1.3, length.shape))


def nearest_only(contacts: Contacts, distance: Float[np.ndarray, " p"]) -> Contacts:
    """The list with the nearest triangle of each particle alone.

    Of one triangle the smooth minimum is the exact distance.
    """
    particle = np.asarray(contacts.particle)
    order = np.lexsort((distance, particle))
    _, first = np.unique(particle[order], return_index=True)
    chosen = np.zeros(len(particle), bool)
    chosen[order[first]] = True
    real = contacts.real & jnp.asarray(chosen)
    return eqx.tree_at(lambda c: c.real, contacts, real)


def spring_energy(membrane: jg.Membrane, law: jg.Parameters) -> jax.Array:
    """The energy of a membrane's springs, in F(0) r0."""
    elements = Springs().elements(None, membrane)
    assert elements is not None
    return energy_of_elements(Springs(), membrane.vertices, elements, law)


def check_contact() -> Iterator[tuple[str, float, float]]:
    """Contact of particles below and in a bumpy sheet, and its springs."""
    rng = np.random.default_rng(2)
    side = 14
    membrane = bumpy_sheet(side, rng)
    position = rng.uniform([0, 0, -2], [side - 1, side - 1, 0.3], (400, 3))
    vertices, faces = np.asarray(membrane.vertices), np.asarray(membrane.faces)
    position[:5] = vertices[20:25]
    position[:5, 2] -= 0.05  # under a vertex, in the barrier
    corners = vertices[faces]
    gap = point_triangle_distance(position[:, None], corners[None])
    position = position[np.asarray(gap).min(axis=1) > LEAST_GAP]
    particles, count = particles_of(position), len(position)
    for name, law in {
        "default": jg.Parameters(),
        "stiff": jg.Parameters(
            contact_stiffness=2.0, contact_adhesion=1.0, contact_range=0.5
        ),
        "no smoothing": jg.Parameters(smoothing=0.0, contact_sharpness=60.0),
    }.items():
        contacts = list_contacts(particles, membrane, reach(law) + 0.3, 8192)
        assert not bool(contacts.overflow)
        distance = np.asarray(contact_distances(particles, membrane, contacts))
        real = np.asarray(contacts.real)
        runs = runs_of(
            np.asarray(contacts.particle)[real], np.asarray(contacts.face)[real], count
        )
        for smooth in (False, True):
            listed = contacts if smooth else nearest_only(contacts, distance)

            def total(
                at: jg.Particles, sheet: jg.Membrane, c: Contacts = listed, p=law
            ) -> jax.Array:
                return contact_energy(at, sheet, c, p)

            slope = eqx.filter_grad(lambda both, f=total: f(*both))
            slopes = slope((particles, membrane))
            wanted = -np.concatenate([slopes[0].position, slopes[1].vertices])
            terms = contact_law(law, smooth=smooth)
            found = contact_forces(position, vertices, faces, *runs, terms)
            kind = "smooth minimum" if smooth else "nearest"
            error = by_rows(np.concatenate(found), wanted)
            yield f"contact, {name}, {kind}", error, BOUND
        wanted = -np.asarray(
            jax.grad(lambda x, m=membrane, p=law: spring_energy(m.at(x), p))(
                membrane.vertices
            )
        )
        force = np.zeros_like(vertices)
        add_spring_forces(
            vertices,
            np.asarray(membrane.edges),
            np.asarray(membrane.rest_length),
            float(law.spring_stiffness),
            float(law.pretension),
            force,
        )
        yield f"springs, {name}", relative(force, wanted), BOUND


def check_energy() -> Iterator[tuple[str, float, float]]:
    """The energy that jax-md derives."""
    u = jnp.linspace(0.0, 1.6, 1601)
    for name, law in LAWS.items():
        wanted = jg.A2(law.adhesion, law.smoothing).energy(u)
        found = a2_energy(u, float(law.adhesion), float(law.smoothing))
        yield f"energy, {name}", float(jnp.abs(found - wanted).max()), BOUND


def check_relaxations() -> Iterator[tuple[str, float, float]]:
    """The same equilibrium by all; 1e-10 in forces is some 1e-8 in positions."""
    start = dense_ball(400, np.random.default_rng(3), 0.05)
    tolerance = 1e-10
    ends = {
        "numba": relax_lbfgs(start, tolerance=tolerance),
        "jax-md": relax_jax_md(start, tolerance=tolerance),
    }
    own = jg.relax(particles_of(start), tolerance=tolerance)
    assert own.state[0] is not None
    wanted = np.asarray(own.state[0].position)
    yield "jaxgrow's residual by numba", residual(wanted), 1.01 * tolerance
    for name, end in ends.items():
        yield f"residual, {name}", residual(end.position), 1.01 * tolerance
        apart = superposed(end.position, wanted) - wanted
        yield f"position, {name}", float(np.abs(apart).max()), 1e-7
    settled = errors_of(wanted)
    yield "residual of the reference", settled["residual_of_reference"], 1.01e-12


def main() -> None:
    """Check all, print the errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", required=True)
    parser.parse_args()
    configure(Options())
    failed = False
    checks = (check_list, check_pairs, check_contact, check_energy, check_relaxations)
    for check in checks:
        for name, error, bound in check():
            wrong = not error <= bound
            failed |= wrong
            print(f"{name:40} {error:9.2e}  {'ABOVE' if wrong else '<='} {bound:g}")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
