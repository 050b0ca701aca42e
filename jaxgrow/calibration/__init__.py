"""Calibration: parameters from an expert's targets, with uncertainties."""

from jaxgrow.calibration.fit import fit as fit
from jaxgrow.calibration.outcome import Fit as Fit, Outcome as Outcome
from jaxgrow.calibration.spec import (
    Bounds as Bounds,
    FitError as FitError,
    load_task as load_task,
    Target as Target,
    Task as Task,
)
