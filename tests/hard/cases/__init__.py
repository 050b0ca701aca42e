"""The hard cases: made to break a run, each with the outcome that it must have."""

from . import clusters, growths, sheets
from .case import Case as Case, complaint as complaint, Found as Found, measure, Row


__all__ = ["CASES", "Case", "Found", "Row", "complaint", "measure"]

CASES = {
    case.name: case for module in (clusters, sheets, growths) for case in module.cases()
}
