"""What a hard case is, and how it is measured."""

import re
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Found:
    """The state at the end of a case, examined on the host by exact means.

    Attributes:
        outcome: name of the `jaxgrow.Result` member.
        steps: of relaxation, over all divisions.
        residual: largest force left in any accepted equilibrium, in F(0).
        penetrations: particles on the wrong side of the membrane, or on it.
        intersections: pairs of triangles that meet where they should not.
        quality: smallest 2 r_in / r_circ of the triangles; None without a membrane.
        defects: whatever else the audit found, with its count.
        figures: what else is worth telling of this case.
    """

    outcome: str
    steps: int = 0
    residual: float | None = None
    penetrations: int = 0
    intersections: int = 0
    quality: float | None = None
    defects: dict[str, int] = field(default_factory=dict)
    figures: dict[str, Any] = field(default_factory=dict)

    @property
    def clean(self) -> bool:
        """Whether nothing crosses, meets or coincides."""
        return not (self.penetrations or self.intersections or self.defects)


@dataclass(frozen=True)
class Case:
    """Something made to break a run.

    Attributes:
        name: for the table, the command line and the test.
        about: what is hard about it, in a few words.
        run: does it. What it refuses by a ValueError is an outcome too.
        expected: names of the outcomes allowed: `jaxgrow.Result` members, or the class
            of the error that refuses it.
        match: pattern of the sentence that refuses it; needed if an error may do so.
        slow: more than about five seconds.
    """

    name: str
    about: str
    run: Callable[[], Found]
    expected: tuple[str, ...]
    match: str = ""
    slow: bool = False


@dataclass(frozen=True)
class Row:
    """A line of the table: a case and what came of it.

    Attributes:
        name: of the case.
        about: what is hard about it.
        expected: the outcomes allowed.
        found: what came.
        sentence: that the user reads, for a refusal.
        seconds: it took, with compilation.
        wrong: why this is not what is expected; empty if it is.
    """

    name: str
    about: str
    expected: tuple[str, ...]
    found: Found
    sentence: str
    seconds: float
    wrong: str

    def as_dict(self) -> dict[str, Any]:
        """Everything, for JSON."""
        return asdict(self)


def measure(case: Case) -> Row:
    """Run a case. Only a refusal by a ValueError is caught: anything else is a bug."""
    start = time.perf_counter()
    sentence = ""
    try:
        found = case.run()
    except ValueError as error:
        found, sentence = Found(type(error).__name__), str(error)
    seconds = time.perf_counter() - start
    wrong = complaint(case, found, sentence)
    return Row(
        case.name, case.about, case.expected, found, sentence, round(seconds, 2), wrong
    )


def complaint(case: Case, found: Found, sentence: str) -> str:
    """What is wrong with the outcome of a case; empty if nothing is.

    Whatever the outcome, the state that is handed back must be valid.
    """
    wrong = []
    if found.outcome not in case.expected:
        wrong.append(f"ended with {found.outcome}, not {' or '.join(case.expected)}")
    if sentence and not (case.match and re.search(case.match, sentence)):
        wrong.append(f"said {sentence!r}, which is not about {case.match!r}")
    if found.penetrations:
        wrong.append(f"{found.penetrations} particles crossed the membrane")
    if found.intersections:
        wrong.append(f"{found.intersections} pairs of triangles intersect")
    wrong += [f"{count} {name}" for name, count in found.defects.items() if count]
    return "; ".join(wrong)
