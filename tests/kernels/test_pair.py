"""The loop over pairs computes what XLA does, and is used where it may be."""

import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.energy.pair import _force_by_blocks, pair_force
from jaxgrow.kernels import ffi, SWITCH
from jaxgrow.parameters import Parameters
from jaxgrow.state import Particles


COUNT = 70
CALL = "jaxgrow_pair"


@pytest.fixture(scope="module")
def cluster():
    """A dense cluster, a tenth of it dead, a half tumour, two at one point."""
    rng = np.random.default_rng(5)
    position = rng.uniform(0, 3, (COUNT, 3))
    position[7] = position[8]
    return Particles(
        jnp.asarray(position),
        jnp.asarray(rng.integers(0, 2, COUNT)),
        jnp.asarray(rng.random(COUNT) > 0.1),
        jnp.zeros(COUNT, bool),
    )


@pytest.fixture(scope="module")
def listed():
    """All pairs, with empty entries in between as lists that were patched have them."""
    rng = np.random.default_rng(6)
    index = np.arange(COUNT)
    full = (index[None, :] + index[1:, None]) % COUNT
    columns = [np.concatenate([c, np.full(9, COUNT)]) for c in full.T]
    return jnp.asarray(np.stack([rng.permutation(c) for c in columns], 1), np.int32)


def law(adhesion=0.3, smoothing=0.1, tumour_stiffness=2.0):
    values = Parameters(
        adhesion=adhesion, smoothing=smoothing, tumour_stiffness=tumour_stiffness
    )
    return jax.tree.map(lambda v: jnp.asarray(v, float), values)


def text(*args):
    return jax.jit(pair_force).lower(*args).as_text()


@pytest.mark.parametrize(
    "values", [{}, {"smoothing": 0.0}, {"smoothing": 0.5}, {"tumour_stiffness": 1.0}]
)
def test_force_is_that_of_the_program(cluster, listed, values):
    given = cluster, listed, law(**values)
    assert CALL in text(*given)
    found, wanted = jax.jit(pair_force)(*given), jax.jit(_force_by_blocks)(*given)
    assert np.abs(wanted).max() > 1
    np.testing.assert_allclose(found, wanted, atol=1e-14)


@pytest.mark.parametrize("u", [0.5, 1.0, 1.5])
def test_law_is_the_same_at_its_branches(u):
    # without smoothing the force jumps at 1/2 and ends at 3/2
    position = jnp.zeros((3, 3)).at[1, 0].set(u).at[2, 0].set(40.0)
    pair = Particles(position, jnp.zeros(3, int), jnp.ones(3, bool), jnp.zeros(3, bool))
    listed = jnp.asarray([[1, 0, 3], [3, 3, 3]], np.int32)
    for smoothing in (0.0, 0.1):
        given = pair, listed, law(smoothing=smoothing)
        np.testing.assert_allclose(
            pair_force(*given), _force_by_blocks(*given), atol=1e-15
        )


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_force_on_what_is_lost_is_not_finite(cluster, listed, value):
    alive = int(jnp.argmax(cluster.alive))
    lost = eqx.tree_at(
        lambda p: p.position, cluster, cluster.position.at[alive, 1].set(value)
    )
    nobody = jnp.full_like(listed, COUNT)
    for neighbours in (listed, nobody):
        force = pair_force(lost, neighbours, law())
        assert not np.isfinite(force[alive]).all()


def test_derivatives_are_those_of_the_program(cluster, listed):
    rng = np.random.default_rng(7)
    # not the two at one point, where the force has no derivative
    apart = cluster.position.at[7].add(jnp.asarray([0.4, 0.3, 0.2]))
    push, pull = jnp.asarray(rng.normal(size=(2, COUNT, 3)))

    def derivatives(force):
        def of(position, parameters):
            at = eqx.tree_at(lambda p: p.position, cluster, position)
            return force(at, listed, parameters)

        given, moves = (apart, law()), (push, law(0.2, 0.02, 0.3))
        value, forward = jax.jvp(of, given, moves)
        _, back = jax.vjp(of, *given)
        return value, forward, back(pull)

    found, wanted = (
        jax.jit(derivatives, static_argnums=0)(f)
        for f in (pair_force, _force_by_blocks)
    )
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-11)


def test_batch_is_one_after_the_other(cluster, listed):
    shifts = jnp.asarray([0.0, 0.1, -0.2])

    def force(shift):
        at = eqx.tree_at(lambda p: p.position, cluster, cluster.position * (1 + shift))
        return pair_force(at, listed, law())

    together = jax.vmap(force)(shifts)
    np.testing.assert_array_equal(together, jnp.stack([force(s) for s in shifts]))


def test_other_types_are_left_to_xla(cluster, listed):
    single = jax.tree.map(
        lambda x: x.astype(jnp.float32) if x.dtype == jnp.float64 else x,
        (cluster, law()),
    )
    assert CALL not in text(single[0], listed, single[1])
    assert CALL not in text(cluster, listed.astype(jnp.int64), law())


@pytest.mark.parametrize(
    "where, name, sentence",
    [
        (jax.ffi, "register_ffi_target", "incompatible API version"),
        (ffi, "import_module", "cannot cache function: no locator available"),
    ],
)
def test_a_loop_that_cannot_be_had_is_not_used(where, name, sentence, monkeypatch):
    def refuse(*_args, **_options):
        raise RuntimeError(sentence)

    monkeypatch.setattr(where, name, refuse)
    assert not ffi.registered.__wrapped__("pair")


CODE = """
import jax, jaxgrow as jg
jax.config.update("jax_enable_x64", True)
grown = jg.grow(jg.Scene(organ=None, lesion=jg.Myoma(divisions=6)))
import sys
print(grown.result.name, "jaxgrow.kernels.descent" in sys.modules)
print(grown.size_mm)
"""


def test_switch_leaves_the_programs_to_xla(monkeypatch):
    said = []
    for switch in ("on", "off"):
        monkeypatch.setenv(SWITCH, switch)
        done = subprocess.run(
            [sys.executable, "-c", CODE], capture_output=True, text=True, check=True
        )
        said.append(done.stdout.split())
    assert said[0][:2] == ["REACHED", "True"]
    assert said[1][:2] == ["REACHED", "False"]
    assert float(said[0][2]) == pytest.approx(float(said[1][2]), rel=1e-3)
