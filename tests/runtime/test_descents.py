"""A growth knows which path its descents ran on."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrow.equilibrium import native_lists as looped_lists
from jaxgrow.equilibrium.relax import relax
from jaxgrow.io.report import make_report
from jaxgrow.kernels.refusals import Refusal
from jaxgrow.runtime.descents import count_descents, Descents, note_descent
from jaxgrow.state import Particles


pytest.importorskip("numba")


@pytest.fixture
def pair():
    return Particles(
        jnp.asarray([[0.0, 0, 0], [0.9, 0, 0]]),
        *(jnp.ones(2, int), jnp.ones(2, bool), jnp.ones(2, bool)),
    )


def test_report_tells_what_ran(tiny_cluster):
    found = make_report(tiny_cluster, None)["loops"]
    count = found.pop("by_loop")
    terms = {"pair": "loop"}
    assert found == {"ran": True, "by_program": 0, "reason": None, "terms": terms}
    assert count >= tiny_cluster.events.divisions


def test_a_loop_counts_as_one(pair):
    with count_descents() as seen:
        relax(pair)
    assert seen == Descents(by_loop=1, terms={"pair": "loop"})


def test_refused_loop_counts_as_a_program_with_its_reason(pair, monkeypatch):
    monkeypatch.setattr(looped_lists, "registered", lambda _name: False)
    refusal = Refusal("the loop is on holiday", "wait")
    monkeypatch.setattr(looped_lists, "refused", lambda _name: refusal)
    with count_descents() as seen:
        relax(pair)
    assert seen.entry() == {
        "ran": False,
        "by_loop": 0,
        "by_program": 1,
        "reason": "the loop is on holiday",
        "terms": {"pair": "loop"},
    }


def test_single_precision_is_a_reason(pair):
    single = eqx.tree_at(lambda p: p.position, pair, pair.position.astype(np.float32))
    with count_descents() as seen:
        relax(single, tolerance=1e-2)
    assert seen.by_loop == 0
    assert seen.reason == "numbers are float32, and loops know 64 bits only"


def test_other_methods_have_no_loop_and_are_not_counted(pair):
    with count_descents() as seen:
        relax(pair, method="fire")
    assert seen == Descents()


def test_counts_do_not_mix():
    with count_descents() as outer:
        note_descent(None, {"pair": "loop"})
        with count_descents() as inner:
            note_descent("a reason", {"pair": "XLA"})
    note_descent(None, {"pair": "loop"})
    loop, program = {"pair": "loop"}, {"pair": "XLA"}
    assert outer == Descents(1, terms=loop)
    assert inner == Descents(0, 1, "a reason", program)
