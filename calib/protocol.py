"""The form in which every calibration answers: motion, forearm, panel, world, IMU, magnetometer, clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .file import CalibrationFile


@dataclass(frozen=True)
class Verdict:
    """The answer in words."""

    grade: str  # "good", "usable" or "not good enough"
    sentence: str  # The value's sigma and what it is good for
    findings: tuple[str, ...] = ()  # What else is to be known
    next: tuple[str, ...] = ()  # What to record next

    @property
    def words(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {
            "grade": self.grade,
            "verdict": self.sentence,
            "findings": self.findings,
            "next": self.next,
        }


@dataclass(frozen=True)
class Answer:
    """What a calibration found."""

    estimate: dict[str, Any]  # The values, in SI units; rotations are matrices
    sigma: dict[str, Any]  # Their standard deviations under the same names, rotations in rad
    verdict: Verdict  # What the answer is good for, and what to record next
    open_questions: tuple[str, ...]  # What was not determined, one sentence each
    table: CalibrationFile  # What belongs into the calibration file, for `write_calibration`
    figures: dict[str, Any]  # What `--json` writes
