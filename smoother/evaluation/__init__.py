"""How good a recovery is: against a reference, or against what was hidden from it."""

from __future__ import annotations

from .gaps import GapTable, evaluate_gaps
from .reference import ReferenceAlignment, read_reference
from .truth_file import read_truth
from .validate import Validation, validate

__all__ = [
    "GapTable",
    "ReferenceAlignment",
    "Validation",
    "evaluate_gaps",
    "read_reference",
    "read_truth",
    "validate",
]
