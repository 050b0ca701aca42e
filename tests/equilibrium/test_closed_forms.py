"""Derivatives of equilibria that can be written down."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import root_scalar

from jaxgrow.energy.parameters import Parameters
from jaxgrow.equilibrium.relax import relax

from .springs import springs


def changed(**values):
    """The default parameters but for these, as arrays."""
    return jax.tree.map(lambda v: jnp.asarray(v, float), Parameters(**values))


def law(u, adhesion, smoothing):
    """The A2 force beyond u = 1/2 + ε, and how it changes with each argument."""
    base, slope = (1 - u) * (2 - u) / 2, u - 1.5
    if u < 1:
        return base, (slope, 0.0, 0.0)
    if u < 1.5 - smoothing:
        return adhesion * base, (adhesion * slope, base, 0.0)
    taper = (1.5 - u) / smoothing
    return adhesion * base * taper, (
        adhesion * (slope * taper - base / smoothing),
        base * taper,
        -adhesion * base * taper / smoothing,
    )


def root(force, low, high):
    """Where the first component of a function is 0."""
    found = root_scalar(lambda x: force(x)[0], bracket=(low, high), xtol=1e-15)
    return found.root


# particles


@pytest.mark.parametrize("name", ["adhesion", "smoothing", "tumour_stiffness"])
def test_distance_of_a_dimer_depends_on_nothing(make_particles, name):
    dimer = make_particles([[0, 0, 0], [0.3, 0.8, 0.1]], None, np.ones(2, int))

    def distance(parameters):
        position = relax(dimer, parameters=parameters).state[0].position
        return jnp.linalg.norm(position[1] - position[0])

    value, slope = jax.value_and_grad(distance)(changed())
    assert float(value) == pytest.approx(1, abs=1e-9)
    assert float(getattr(slope, name)) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("radius", [1.0, 1.2])
@pytest.mark.parametrize("stiffness", [1.0, 1.5])
def test_dimer_that_a_held_triangle_squeezes(make_particles, radius, stiffness):
    """Two tumour particles at ±h over the middle of three that are held.

    3 F(d) h / d + s F(2 h) = 0 with d² = R² + h²: the triangle attracts both, and they
    repel each other.
    """
    adhesion, smoothing = 0.2, 0.1
    angle = 2 * np.pi * np.arange(3) / 3
    triangle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    start = np.concatenate([radius * triangle, [[0, 0, 0.45], [0, 0, -0.45]]])
    scene = make_particles(start, np.arange(5) < 3, (np.arange(5) > 2).astype(int))

    def force(h):
        d = np.hypot(radius, h)
        bond, (slope, by_adhesion, _) = law(d, adhesion, smoothing)
        pair, (pair_slope, _, _) = law(2 * h, adhesion, smoothing)
        along_d = 3 * h * (slope / d - bond / d**2)
        return (
            3 * bond * h / d + stiffness * pair,
            3 * bond / d + along_d * h / d + 2 * stiffness * pair_slope,
            3 * by_adhesion * h / d,
            pair,
            along_d * radius / d,
        )

    height = root(force, 0.31, 0.499)
    _, by_height, *others = force(height)
    wanted = -np.array(others) / by_height

    def found(parameters, radius):
        position = scene.position.at[:3].set(radius * jnp.asarray(triangle))
        moved = eqx.tree_at(lambda p: p.position, scene, position)
        return relax(moved, parameters=parameters).state[0].position[3, 2]

    parameters = changed(adhesion=adhesion, tumour_stiffness=stiffness)
    value, (slope, by_radius) = jax.value_and_grad(found, (0, 1))(
        parameters, jnp.asarray(radius)
    )
    np.testing.assert_allclose(value, height, atol=1e-9)
    slopes = [slope.adhesion, slope.tumour_stiffness, by_radius]
    np.testing.assert_allclose(slopes, wanted, rtol=1e-8)
    assert np.abs(wanted).min() > 1e-3


def test_particle_in_a_hollow_feels_the_smoothing(make_particles):
    """At the height h over three that are held; one below pulls, in its taper.

    3 F(d) h / d + F(h + c) = 0 with d² = R² + h².
    """
    radius, below = 0.8, 0.88
    angle = 2 * np.pi * np.arange(3) / 3
    triangle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    start = np.concatenate([radius * triangle, [[0, 0, -below], [0, 0, 0.55]]])
    scene = make_particles(start, np.arange(5) < 4)

    def force(h):
        d = np.hypot(radius, h)
        bond, (slope, by_adhesion, _) = law(d, 0.2, 0.1)
        foot, (foot_slope, foot_adhesion, foot_smoothing) = law(h + below, 0.2, 0.1)
        return (
            3 * bond * h / d + foot,
            3 * (bond / d + (slope / d - bond / d**2) * h**2 / d) + foot_slope,
            3 * by_adhesion * h / d + foot_adhesion,
            foot_smoothing,
        )

    height = root(force, 0.5, 0.6)
    assert 1.4 < height + below < 1.5
    _, by_height, *others = force(height)
    wanted = -np.array(others) / by_height

    def found(parameters):
        return relax(scene, parameters=parameters).state[0].position[4, 2]

    value, slope = jax.value_and_grad(found)(changed())
    np.testing.assert_allclose(value, height, atol=1e-9)
    slopes = [slope.adhesion, slope.smoothing]
    np.testing.assert_allclose(slopes, wanted, rtol=1e-8)
    assert np.abs(wanted).min() > 1e-3


# springs


def test_loaded_chain():
    """Pinned at one end and pulled at the other by f along x.

    Its vertices are at j f / k + (1 - τ) Σ ℓ; across, at a share of the pull's slope.
    """
    count, stiffness, pretension, pull = 6, 0.5, 0.1, 0.2
    edges = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    lengths = np.linspace(0.8, 1.2, count - 1)
    start = np.zeros((count, 3))
    start[:, 0] = np.arange(count)

    def found(parameters, lengths, pull, pin):
        vertices = jnp.asarray(start).at[0].set(pin)
        chain = springs(vertices, edges, lengths, np.arange(count) == 0)
        force = jnp.zeros((256, 3)).at[count - 1].set(pull)
        outcome = relax(None, chain, parameters=parameters, load=force)
        return outcome.state[1].vertices[3]

    parameters = changed(spring_stiffness=stiffness, pretension=pretension)
    given = parameters, jnp.asarray(lengths), jnp.asarray([pull, 0, 0]), jnp.zeros(3)
    where, along = jax.value_and_grad(lambda *g: found(*g)[0], (0, 1, 2, 3))(*given)
    across = jax.grad(lambda *g: found(*g)[1], (0, 1, 2, 3))(*given)

    place = (1 - pretension) * lengths[:3].sum() + 3 * pull / stiffness
    near = {"rtol": 1e-8, "atol": 1e-10}
    np.testing.assert_allclose(where, place, atol=1e-8)
    slope, by_length, by_pull, by_pin = along
    np.testing.assert_allclose(slope.spring_stiffness, -3 * pull / stiffness**2, **near)
    np.testing.assert_allclose(slope.pretension, -lengths[:3].sum(), **near)
    share = (1 - pretension) * (np.arange(count - 1) < 3)
    np.testing.assert_allclose(by_length, share, **near)
    np.testing.assert_allclose(by_pull, [3 / stiffness, 0, 0], **near)
    np.testing.assert_allclose(by_pin, [1, 0, 0], **near)
    slope, by_length, by_pull, by_pin = across
    np.testing.assert_allclose(slope.spring_stiffness, 0, **near)
    np.testing.assert_allclose(by_length, 0, **near)
    np.testing.assert_allclose(by_pull, [0, place / pull, 0], **near)
    np.testing.assert_allclose(by_pin, [0, 1, 0], **near)


@pytest.mark.parametrize("lift", [0.05, 0.4])
def test_inflated_cap(lift):
    """A hub on eight spokes to a pinned rim of radius R, which a force f lifts.

    8 k (l - (1 - τ) ℓ) h / l = f with the length l² = R² + h² of the spokes.
    """
    count, stiffness, pretension, rest, radius = 8, 0.3, 0.1, 1.0, 1.1
    angle = 2 * np.pi * np.arange(count) / count
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    ring = np.arange(1, count + 1)
    spokes = np.stack([0 * ring, ring], axis=1)
    edges = np.concatenate([spokes, np.stack([ring, np.roll(ring, 1)], axis=1)])

    def force(h):
        length = np.hypot(radius, h)
        stretch = length - (1 - pretension) * rest
        by_length = count * stiffness * h * (1 - stretch / length) / length
        return (
            count * stiffness * stretch * h / length - lift,
            count * stiffness * stretch / length + by_length * h / length,
            count * stretch * h / length,
            count * stiffness * rest * h / length,
            -count * stiffness * (1 - pretension) * h / length,
            by_length * radius / length,
            -1.0,
        )

    height = root(force, 0, 3)
    _, by_height, *others = force(height)
    wanted = -np.array(others) / by_height

    def found(parameters, rest, radius, lift):
        vertices = jnp.concatenate([jnp.asarray([[0, 0, 0.01]]), radius * rim])
        lengths = jnp.full(len(edges), 1.0) * rest
        cap = springs(vertices, edges, lengths, np.arange(count + 1) > 0)
        load = jnp.zeros((256, 3)).at[0, 2].set(lift)
        outcome = relax(None, cap, parameters=parameters, load=load)
        return outcome.state[1].vertices[0, 2]

    parameters = changed(spring_stiffness=stiffness, pretension=pretension)
    given = parameters, *(jnp.asarray(v) for v in (rest, radius, lift))
    value, (slope, *slopes) = jax.value_and_grad(found, (0, 1, 2, 3))(*given)
    np.testing.assert_allclose(value, height, atol=1e-9)
    slopes = [slope.spring_stiffness, slope.pretension, *slopes]
    np.testing.assert_allclose(slopes, wanted, rtol=1e-8)
