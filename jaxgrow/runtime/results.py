"""Result codes of a computation, with the sentence that a user reads."""

import enum
from typing import SupportsInt


class Result(enum.Enum):
    """Outcome of a relaxation or of a growth.

    Compiled code carries `code`; `Result.of` turns it back. Only CONVERGED and
    REACHED are successes.
    """

    CONVERGED = (0, "The equilibrium was reached.")
    REACHED = (
        1,
        "The lesion has the size that was asked for, or it lacks at most 3 % of it and "
        "cannot grow on.",
    )
    STEP_LIMIT = (
        2,
        "The forces did not fall below the tolerance within the allowed number of "
        "steps; allow more steps or ask for a larger tolerance.",
    )
    NON_FINITE = (
        3,
        "A position or force became infinite or NaN; use softer springs, or start "
        "from a state without overlaps.",
    )
    OVERFLOW = (
        4,
        "A neighbour or contact list became too small; the relaxation goes on from the "
        "last valid state with a larger one.",
    )
    DIVISION_LIMIT = (
        5,
        "The allowed number of divisions was used up before the lesion had its size.",
    )
    TIME_LIMIT = (
        6,
        "The allowed time was used up before the lesion had its size.",
    )
    CAVITY_FULL = (
        7,
        "The cavity does not hold a lesion of that size: it has filled the room that "
        "there is, and further divisions no longer enlarge it.",
    )
    EVAPORATED = (
        8,
        "The relaxation threw particles out of each other's reach, even with short "
        "steps; use smaller stiffnesses.",
    )
    INTERSECTION = (
        9,
        "The surface would have intersected itself or the organ, and no other way to "
        "its equilibrium was found.",
    )
    PATCH_TOO_SMALL = (
        10,
        "The border of the simulated patch feels the lesion, and the organ has no more "
        "surface to enlarge the patch by; ask for a smaller lesion.",
    )
    ON_MEMBRANE = (
        11,
        "A particle lies exactly on the membrane, or two sheets of it touch, so there "
        "is no side for it to be on; move them apart.",
    )
    SLIVER = (
        12,
        "A triangle of the surface degenerated and could not be repaired; use stiffer "
        "springs, or an organ's mesh with edges of at most 3 r0 around the site.",
    )
    SINGULAR = (
        13,
        "The equilibrium is not a strict minimum: a direction without stiffness, or "
        "with a negative one, was found, so it has no derivative.",
    )
    NOT_SOLVED = (
        14,
        "The linear system of the equilibrium's derivative was not solved to its "
        "tolerance.",
    )

    STOPPED = (
        15,
        "The caller ended the growth before the lesion had its size.",
    )
    INTERRUPTED = (
        16,
        "The growth was interrupted before the lesion had its size.",
    )

    def __init__(self, code: int, sentence: str) -> None:
        self.code = code
        self.sentence = sentence

    @classmethod
    def of(cls, code: SupportsInt) -> "Result":
        """Return the member with this code."""
        return next(member for member in cls if member.code == int(code))

    @property
    def success(self) -> bool:
        """Whether what was asked for was reached."""
        return self in (Result.CONVERGED, Result.REACHED)

    def __str__(self) -> str:
        """The sentence itself."""
        return self.sentence
