"""The form in which every calibration answers: motion, forearm, panel, world, IMU, magnetometer, clock.

Each has a function that computes (`calibrate_motion` and so on) and one that puts what it found into this
form (`motion_answer` and so on); `write_calibration(path, answer.table)` keeps it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .file import CalibrationFile
from .verdict import Verdict


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
