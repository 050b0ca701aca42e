"""Handlers are called as they declare, and a refusal has its reason, said once."""

import subprocess
import sys
import warnings
from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow import kernels
from jaxgrow.kernels import ffi
from jaxgrow.kernels.arguments import Argument, codes_of
from jaxgrow.kernels.layout import NEAR_ARGUMENTS, NEAR_RESULTS
from jaxgrow.kernels.refusals import Refusal, said
from jaxgrow.runtime import slow_path
from jaxgrow.runtime.slow_path import SlowPathWarning, UnvalidatedVersionWarning


pytest.importorskip("numba")

VALUES = {
    "position": jnp.asarray([[0.0, 0, 0], [1, 0, 0], [5, 0, 0]]),
    "wide": jnp.asarray([[1, 2], [0, 2], [0, 1]], np.int32),
    "square": jnp.full(1, 4.0),
}
SHAPES = {"listed": (2, 3), "most": (1,)}


def near(values, shapes, **options):
    return ffi.call("near", NEAR_ARGUMENTS, NEAR_RESULTS, values, shapes, **options)


def test_call_by_names_and_in_order_is_the_same():
    assert ffi.registered("near")
    named = near(dict(reversed(VALUES.items())), SHAPES)
    ordered = near(list(VALUES.values()), list(SHAPES.values()))
    np.testing.assert_array_equal(named[0], [[1, 0, 3], [3, 3, 3]])
    for one, other in zip(named, ordered, strict=True):
        np.testing.assert_array_equal(one, other)


def test_call_is_traced_and_batched():
    def most(position):
        found = near(VALUES | {"position": position}, SHAPES, vmap_method="sequential")
        return found[1][0]

    both = jnp.stack([VALUES["position"], 9 * VALUES["position"]])
    assert jax.jit(jax.vmap(most))(both).tolist() == [1, 0]


@pytest.mark.parametrize(
    "change, sentence",
    [
        (
            {"position": jnp.zeros((3, 3), np.float32)},
            "argument 'position' of the loop 'near' is float32 of rank 2; it must be "
            "float64 of rank 2",
        ),
        (
            {"square": jnp.asarray(4.0)},
            "argument 'square' of the loop 'near' is float64 of rank 0; it must be "
            "float64 of rank 1",
        ),
        ({"radius": 1}, "argument 'radius' of the loop 'near' is unknown; it has posi"),
    ],
)
def test_argument_that_is_not_as_declared_is_named(change, sentence):
    with pytest.raises(TypeError, match=sentence):
        near(VALUES | change, SHAPES)


def test_argument_that_is_missing_is_named():
    few = {name: VALUES[name] for name in ("position", "square")}
    with pytest.raises(
        TypeError, match="argument 'wide' of the loop 'near' is missing"
    ):
        near(few, SHAPES)
    with pytest.raises(TypeError, match="given 2 arguments; it has 3: position, wide"):
        near(list(few.values()), SHAPES)


def test_result_that_is_not_as_declared_is_named():
    with pytest.raises(
        TypeError, match=r"result 'most' .* has the shape \(\); it must"
    ):
        near(VALUES, SHAPES | {"most": ()})


def test_result_that_begins_as_another_array_is_named():
    # both are whole numbers of 32 bits, but the one is no vector
    with pytest.raises(
        TypeError, match=r"'listed' .* begin as argument 'wide', but has"
    ):
        near(VALUES, SHAPES, aliases={"wide": "listed"})


def test_result_may_begin_as_an_argument():
    traced = jax.jit(
        lambda wide: near(
            VALUES | {"wide": wide},
            {"listed": wide.shape, "most": (1,)},
            aliases={"wide": "listed"},
        )
    ).lower(VALUES["wide"])
    assert "output_operand_alias" in traced.as_text()


def test_loops_know_no_complex_numbers():
    with pytest.raises(
        ValueError, match="phase is of complex128; loops know bool, int8"
    ):
        Argument("phase", np.complex128, 1)
    with pytest.raises(ValueError, match="phase is of rank -1"):
        Argument("phase", np.float64, -1)


def test_codes_are_counts_then_types_and_ranks():
    codes = codes_of([Argument("a", bool, 1)], [Argument("b", "float64", 2)])
    assert codes.tolist() == [2, 1, 256 * 1 + 1, 256 * 12 + 2]
    more = codes_of([Argument("a", bool, 1)], [Argument("b", "float64", 2)], more=True)
    assert more.tolist() == [3, *codes.tolist()[1:]]


@pytest.fixture
def nothing_said():
    slow_path.warn_once.cache_clear()
    yield
    slow_path.warn_once.cache_clear()


@pytest.mark.parametrize(
    "where, name, text, reason",
    [
        (
            *(jax.ffi, "register_ffi_target", "incompatible API version"),
            f"jaxlib {version('jaxlib')} does not take them .*: incompatible API",
        ),
        (
            *(ffi, "import_module", "no symbol"),
            r"numba cannot compile or load one of them \(RuntimeError: no symbol\)",
        ),
    ],
)
def test_a_loop_that_cannot_be_had_is_refused_with_the_reason(
    where, name, text, reason, monkeypatch, nothing_said
):
    module = kernels.import_module("jaxgrow.kernels.loop_cache")

    def refuse(what, *_arguments, **_options):
        if what == "jaxgrow.kernels.loop_cache":
            return module
        raise RuntimeError(text)

    monkeypatch.setattr(where, name, refuse)
    monkeypatch.setattr(ffi, "refused", ffi.refused.__wrapped__)
    with pytest.warns(SlowPathWarning, match=reason):
        assert not ffi.registered("near")
    assert not ffi.registered("near")  # and says no more


def twice(act):
    act()
    act()


def test_what_nobody_wants_is_not_said(nothing_said):
    Refusal("it is off", None).say()


def test_refusal_says_what_it_costs_and_what_to_do(nothing_said):
    with pytest.warns(SlowPathWarning) as told:
        twice(Refusal("numba is not installed", "install it").say)
    assert [str(one.message) for one in told] == [
        "compiled loops are not used, because numba is not installed; growths take up "
        "to four times longer. To use them, install it."
    ]


@pytest.mark.parametrize(
    "error, text",
    [
        (RuntimeError("one\ntwo"), "RuntimeError: one"),
        (KeyError(), "KeyError()"),
        (ValueError("x" * 300), f"ValueError: {'x' * 185}..."),
    ],
)
def test_errors_are_told_in_one_line(error, text):
    assert said(error) == text


@pytest.mark.parametrize("jaxlib", ["0.10.0", ffi.NEWEST_VALIDATED_JAXLIB, "0.9.99"])
def test_versions_that_were_validated_are_taken_silently(jaxlib, nothing_said):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ffi.warn_if_unvalidated.__wrapped__(jaxlib)


@pytest.mark.parametrize("jaxlib", ["0.10.1.1", "0.10.2.dev20261101", "0.11.0", "1.0"])
def test_newer_versions_are_told_once(jaxlib, nothing_said):
    sentence = f"jaxlib is {jaxlib}, .* tested up to .* JAXGROW_KERNELS=off to be safe"
    with pytest.warns(UnvalidatedVersionWarning, match=sentence) as told:
        twice(lambda: ffi.warn_if_unvalidated.__wrapped__(jaxlib))
    assert len(told) == 1


def test_version_of_these_tests_is_the_newest_validated_one():
    """Raise it when the suite, with its look at the header, passes with a newer."""
    assert ffi._numbers(version("jaxlib")) <= ffi._numbers(ffi.NEWEST_VALIDATED_JAXLIB)


def test_compilation_switched_off_is_told_and_nothing_fails(monkeypatch):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    look = (
        "from jaxgrow.kernels import ffi, wanted;"
        "print(wanted(), ffi.registered('pair'), wanted(), ffi.registered('near'))"
    )
    done = subprocess.run(
        [sys.executable, "-c", look], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["False"] * 4
    assert done.stderr.count("SlowPathWarning") == 1
    assert "because NUMBA_DISABLE_JIT is set; growths take up to four" in done.stderr


def test_numba_that_cannot_be_imported_is_told(monkeypatch, tmp_path):
    (tmp_path / "numba.py").write_text('raise ImportError("Numba needs NumPy 1.0.")')
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    done = subprocess.run(
        [sys.executable, "-c", "from jaxgrow import kernels; print(kernels.wanted())"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["False"]
    assert "cannot be imported (ImportError: Numba needs NumPy 1.0.)" in done.stderr
