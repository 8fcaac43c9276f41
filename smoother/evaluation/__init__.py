"""How good a recovery is: against a reference, or against what was hidden from it."""

from __future__ import annotations

from .gaps import GapTable, evaluate_gaps
from .truth_file import read_truth
from .validate import Validation, validate

__all__ = ["GapTable", "Validation", "evaluate_gaps", "read_truth", "validate"]
