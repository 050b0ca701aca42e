"""Results are codes in compiled code and sentences for a user."""

import jax.numpy as jnp
import pytest

from jaxgrow.runtime.results import Result


@pytest.mark.parametrize("member", list(Result))
def test_code_leads_back_to_its_member(member):
    assert Result.of(member.code) is member
    assert Result.of(jnp.asarray(member.code)) is member


def test_codes_differ():
    assert len({member.code for member in Result}) == len(Result)


@pytest.mark.parametrize("member", list(Result))
def test_member_reads_as_one_sentence(member):
    assert str(member) == member.sentence
    assert member.sentence[0].isupper()
    assert member.sentence.endswith(".")


def test_only_what_was_asked_for_is_a_success():
    assert {m for m in Result if m.success} == {Result.CONVERGED, Result.REACHED}
