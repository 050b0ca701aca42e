"""The A2 profile: exact values as printed, and its smooth extension."""

import itertools
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.a2 import A2, CUTOFF, STABLE_ADHESION


EPS = 64 * np.finfo(float).eps  # identities
PAIRS = [
    (adhesion, smoothing)
    for adhesion in (0.0, 0.2, STABLE_ADHESION, 1.0, 3.0)
    for smoothing in (0.0, 1e-3, 0.1, 0.25, 0.5)
]


@jax.jit
def energy_of(u, adhesion, smoothing):
    return A2(adhesion, smoothing).energy(u)


@jax.jit
def force_of(u, adhesion, smoothing):
    return A2(adhesion, smoothing).force(u)


slope_of = jax.jit(jax.vmap(jax.grad(energy_of), (0, None, None)))


def at(*u):
    return jnp.array(u, float)


def breaks(smoothing):
    """Where the force changes its formula."""
    edges = {0.0, 0.5 - smoothing, 0.5 + smoothing, 1.0, CUTOFF - smoothing, CUTOFF}
    return sorted(edges)


def integral(adhesion, low, weight=np.ones_like, high=CUTOFF, smoothing=0.0):
    """∫ F weight over [low, high]: Gauss-Legendre per branch, exact for polynomials."""
    node, share = np.polynomial.legendre.leggauss(8)
    total = 0.0
    stops = [low, *[b for b in breaks(smoothing) if low < b < high], high]
    for start, stop in itertools.pairwise(stops):
        u = (start + stop) / 2 + (stop - start) / 2 * node
        force = np.asarray(force_of(jnp.asarray(u), adhesion, smoothing))
        total += (stop - start) / 2 * np.sum(share * force * weight(u))
    return total


def test_printed_energy_has_the_exact_values():
    energy = energy_of(at(0, 0.5, 1, 1.5), 1.0, 0.0)
    np.testing.assert_allclose(energy, [1 / 2, 1 / 24, -1 / 24, 0], atol=EPS, rtol=0)


def test_printed_force_is_the_printed_polynomial_on_each_branch():
    u = np.linspace(0, 2, 401)  # 1/2 and 3/2 belong to the far branch
    far = np.where(u <= 1.5, (1 - u) * (2 - u) / 2, 0)
    wanted = np.where(u < 0.5, 1 - u**2, far)
    np.testing.assert_allclose(
        force_of(jnp.asarray(u), 1.0, 0.0), wanted, atol=EPS, rtol=0
    )


def test_printed_force_jumps_from_three_quarters_to_three_eighths_at_one_half():
    below = np.nextafter(0.5, 0)
    np.testing.assert_allclose(
        force_of(at(below, 0.5), 1.0, 0.0), [0.75, 0.375], atol=EPS
    )


def test_printed_force_jumps_from_minus_an_eighth_to_zero_at_three_halves():
    above = np.nextafter(1.5, 2)
    force = force_of(at(1.5, above), 1.0, 0.0)
    np.testing.assert_allclose(force, [-0.125, 0], atol=EPS)
    assert force[1] == 0


def test_printed_force_has_slope_minus_one_half_at_rest():
    slope = jax.jit(jax.grad(lambda u: A2().force(u)))
    assert force_of(at(1.0), 1.0, 0.0)[0] == 0
    # the two sides meet in the same slope: an adhesion of 1 changes nothing at u = 1
    assert slope(jnp.asarray(1.0)) == pytest.approx(-0.5, abs=EPS)
    assert slope(jnp.asarray(1 + 1e-9)) == pytest.approx(-0.5, abs=1e-8)


@pytest.mark.parametrize("adhesion, smoothing", [(1.0, 0.0), (0.2, 0.1), (1.0, 0.5)])
def test_nothing_acts_beyond_the_cutoff(adhesion, smoothing):
    u = at(np.nextafter(1.5, 2), 1.6, 10, 1e6)
    assert not np.any(force_of(u, adhesion, smoothing))
    assert not np.any(energy_of(u, adhesion, smoothing))


def test_virial_integrals_are_149_and_minus_371_of_3840():
    repulsive = integral(1.0, 0.0, lambda u: u**3, high=1.0)
    attractive = integral(1.0, 1.0, lambda u: u**3)
    assert repulsive == pytest.approx(149 / 3840, abs=EPS)
    assert attractive == pytest.approx(-371 / 3840, abs=EPS)


def test_stable_adhesion_cancels_the_virial_in_three_dimensions():
    assert Fraction(149, 371) == Fraction(149, 3840) / Fraction(371, 3840)
    assert STABLE_ADHESION == 149 / 371
    stable = integral(STABLE_ADHESION, 0.0, lambda u: u**3)
    assert stable == pytest.approx(0, abs=EPS)
    assert integral(1.0, 0.0, lambda u: u**3) < -0.05


def test_printed_law_cancels_the_virial_in_two_dimensions():
    assert integral(1.0, 0.0, lambda u: u**2) == pytest.approx(0, abs=EPS)


@pytest.mark.parametrize("adhesion, smoothing", PAIRS)
def test_energy_is_the_integral_of_the_force(adhesion, smoothing):
    u = np.linspace(0, 1.5, 16)
    wanted = [integral(adhesion, low, smoothing=smoothing) for low in u]
    # the antiderivatives of blend and taper are divided by ε, and their rounding is too
    atol = EPS * max(1, 0.05 * max(adhesion, 1) / smoothing) if smoothing else EPS
    found = energy_of(jnp.asarray(u), adhesion, smoothing)
    np.testing.assert_allclose(found, wanted, atol=atol, rtol=0)


@pytest.mark.parametrize("adhesion, smoothing", PAIRS)
def test_force_is_minus_the_derivative_of_the_energy(adhesion, smoothing):
    u = np.linspace(0.013, 1.6, 83)
    if not smoothing:  # where the printed force jumps the energy has no derivative
        u = np.where((abs(u - 0.5) > 1e-6) & (abs(u - 1.5) > 1e-6), u, 0.7)
    u = jnp.asarray(u)
    slope = slope_of(u, adhesion, smoothing)
    atol = EPS * max(1, 0.2 * max(adhesion, 1) / smoothing) if smoothing else EPS
    force = force_of(u, adhesion, smoothing)
    np.testing.assert_allclose(force, -slope, atol=atol, rtol=0)


@pytest.mark.parametrize("smoothing", [1e-3, 0.1, 0.25, 0.5])
def test_smoothed_force_is_continuous(smoothing):
    h = 1e-5
    u = jnp.asarray(np.arange(0, 1.7, h))
    largest = float(np.abs(np.diff(np.asarray(force_of(u, 1.0, smoothing)))).max())
    # steepest: the jump of 3/8 over 2 ε, on top of the branches' own slopes below 2
    assert largest <= (0.375 / (2 * smoothing) + 0.125 / smoothing + 2) * h


def test_printed_force_is_not_continuous():
    u = jnp.asarray(np.arange(0, 1.7, 1e-5))
    assert np.abs(np.diff(np.asarray(force_of(u, 1.0, 0.0)))).max() > 0.3


def test_energy_tends_to_the_printed_one_in_first_order_of_the_smoothing():
    u = jnp.asarray(np.linspace(0, 1.6, 321))
    printed = np.asarray(energy_of(u, 1.0, 0.0))
    errors = [
        np.abs(np.asarray(energy_of(u, 1.0, width)) - printed).max()
        for width in (0.02, 0.01, 0.005)
    ]
    # at u = 1/2, to first order in ε: 1/8 · ε/2 by the taper and 3/8 · ε/4 by the blend
    widths = np.array([0.02, 0.01, 0.005])
    np.testing.assert_allclose(errors, 5 / 32 * widths, rtol=0.01)


def test_force_away_from_the_jumps_is_the_printed_one_at_any_small_smoothing():
    u = jnp.asarray([0.0, 0.3, 0.39, 0.61, 0.9, 1.0, 1.2, 1.39])
    np.testing.assert_array_equal(force_of(u, 1.0, 0.1), force_of(u, 1.0, 0.0))


@pytest.mark.parametrize("quantity", ["energy", "force"])
@pytest.mark.parametrize("name", ["adhesion", "smoothing"])
def test_derivative_in_a_parameter_is_that_of_differences(quantity, name):
    u = jnp.asarray([0.1, 0.43, 0.52, 0.58, 0.8, 1.2, 1.42, 1.47])
    start = {"adhesion": 0.3, "smoothing": 0.12}

    @jax.jit
    def value(theta):
        law = A2(**{k: jnp.asarray(v) for k, v in (start | {name: theta}).items()})
        return getattr(law, quantity)(u)

    exact = jax.jit(jax.jacfwd(value))(jnp.asarray(start[name]))
    h = 1e-6
    difference = (value(start[name] + h) - value(start[name] - h)) / (2 * h)
    np.testing.assert_allclose(exact, difference, atol=1e-8)
    assert np.abs(exact).max() > 1e-3


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_precision_of_the_distance_is_kept(smoothing):
    u = jnp.linspace(0, 1.6, 9, dtype=jnp.float32)
    assert force_of(u, 0.2, smoothing).dtype == jnp.float32
    assert energy_of(u, 0.2, smoothing).dtype == jnp.float32


def test_adhesion_may_differ_by_pair():
    u = jnp.asarray([1.2, 1.2])
    force = A2(jnp.asarray([0.2, 1.0])).force(u)
    np.testing.assert_allclose(force[0], 0.2 * force[1], rtol=EPS)
