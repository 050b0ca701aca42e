"""Hard cases: each ends as expected, and with a valid state whatever the outcome.

`experiments/studies/hard_cases.py` makes a table of the same cases.
"""

import pytest

from . import cases as hard


def marked(case):
    marks = [pytest.mark.slow] if case.slow else []
    return pytest.param(case, id=case.name, marks=marks)


@pytest.mark.parametrize("case", [marked(case) for case in hard.CASES.values()])
def test_a_hard_case_converges_or_is_refused_by_name(case):
    row = hard.measure(case)
    assert row.wrong == "", row


def found(**more):
    return hard.Found("CONVERGED", **more)


def case_of(run, expected=("CONVERGED",), match=""):
    return hard.Case("a case", "", run, expected, match)


def refuse(error):
    raise error


@pytest.mark.parametrize(
    "run, match, wrong",
    [
        (lambda: found(), "", ""),
        (lambda: found(penetrations=2), "", "2 particles crossed"),
        (lambda: found(intersections=3), "", "3 pairs of triangles intersect"),
        (lambda: found(defects={"holes": 1}), "", "1 holes"),
        (lambda: found(defects={"holes": 0}), "", ""),
        (lambda: hard.Found("STEP_LIMIT"), "", "ended with STEP_LIMIT"),
        (lambda: refuse(ValueError("too deep")), "deep", "ended with ValueError"),
    ],
)
def test_a_wrong_outcome_is_told(run, match, wrong):
    row = hard.measure(case_of(run, match=match))
    assert row.wrong.startswith(wrong)
    assert bool(row.wrong) == bool(wrong)


@pytest.mark.parametrize("match, right", [("deep", True), ("wide", False), ("", False)])
def test_a_refusal_must_say_why(match, right):
    case = case_of(lambda: refuse(ValueError("too deep")), ("ValueError",), match)
    assert bool(hard.measure(case).wrong) != right


def test_an_error_that_is_no_refusal_is_a_crash():
    with pytest.raises(KeyError):
        hard.measure(case_of(lambda: refuse(KeyError("x"))))
