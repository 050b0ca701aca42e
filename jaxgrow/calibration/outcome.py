"""Outcome of a fit: parameters and targets with their uncertainties."""

import enum
from dataclasses import dataclass
from typing import Any

from jaxgrow.calibration.evaluations import Evaluation
from jaxgrow.calibration.search import End, Tried
from jaxgrow.calibration.spec import Task
from jaxgrow.calibration.uncertainty import Achieved, Fitted
from jaxgrow.io.report import named, plain
from jaxgrow.scene.scene import Scene


class Outcome(enum.Enum):
    """Outcome of a fit; the value is the sentence that a user reads.

    The criterion is the mean that is estimated from all lesions; the few that are grown
    with the fitted parameters scatter around it.
    """

    REACHED = "All targets are reached within their uncertainty."
    UNREACHED = "Not all targets are reached within their uncertainty."
    NOT_GROWN = (
        "No parameters were found with which the lesion of every seed grows to its end."
    )

    @property
    def success(self) -> bool:
        """Whether all targets are reached."""
        return self is Outcome.REACHED


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a fit, whether it reached its targets or not.

    Attributes:
        scene: with the fitted parameters.
        task: targets, bounds and effort.
        outcome: whether the targets are reached.
        end: why the search ended.
        loss: at the fitted parameters.
        parameters: the fitted ones with their uncertainties.
        targets: each target, its achieved value, and the reason if it is missed; empty
            if nothing grew.
        history: every evaluation, in its order.
        growths: all stored growths, including those of an earlier fit in the folder.
    """

    scene: Scene
    task: Task
    outcome: Outcome
    end: End
    loss: float
    parameters: dict[str, Fitted]
    targets: dict[str, Achieved]
    history: tuple[Tried, ...]
    growths: tuple[Evaluation, ...]

    @property
    def failures(self) -> tuple[str, ...]:
        """The failed growth of each failed evaluation, and its result."""
        return tuple(tried.failure for tried in self.history if tried.failure)

    def as_dict(self) -> dict[str, Any]:
        """Return the outcome in JSON's types; non-finite numbers become None."""
        return plain(
            {
                "outcome": self.outcome.name,
                "sentence": self.outcome.value,
                "end": self.end.name,
                "end_sentence": self.end.value,
                "loss": self.loss,
                "parameters": {n: named(p) for n, p in self.parameters.items()},
                "targets": {
                    name: {**named(target), "reached": target.reached}
                    for name, target in self.targets.items()
                },
                "evaluations": len(self.history),
                "growths": len(self.growths),
                "failures": self.failures,
                "history": [named(tried) for tried in self.history],
            }
        )
