"""The form in which every calibration answers: motion, forearm, panel, world, IMU, magnetometer, clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .file import CalibrationFile


@dataclass(frozen=True)
class Verdict:
    """The answer in words.

    Attributes
    ----------
    grade : str
        "good", "usable" or "not good enough".
    sentence : str
        The value's sigma and what it is good for.
    findings : tuple of str
        What else is to be known.
    next : tuple of str
        What to record next.
    """

    grade: str
    sentence: str
    findings: tuple[str, ...] = ()
    next: tuple[str, ...] = ()

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
    """What a calibration found.

    Attributes
    ----------
    estimate : dict of str to float or ndarray
        The values, in SI units; rotations are matrices.
    sigma : dict of str to float or ndarray
        Their standard deviations under the same names, rotations in rad; what has none is left out.
    verdict : Verdict
        What the answer is good for, and what to record next.
    open_questions : tuple of str
        What was not determined, one sentence each.
    table : CalibrationFile
        What belongs into the calibration file, for `write_calibration`.
    figures : dict
        What `--json` writes.
    """

    estimate: dict[str, Any]
    sigma: dict[str, Any]
    verdict: Verdict
    open_questions: tuple[str, ...]
    table: CalibrationFile
    figures: dict[str, Any]
