"""How exact the answers are that were timed: errors in the gaps against the simulated motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smoother.array_types import BoolArray, FloatArray
from smoother.evaluation.validate import sample_errors
from smoother.io import read_recovery
from smoother.recording import Truth
from smoother.result import Recovery

from .recordings import read_truth


@dataclass(frozen=True)
class Exactness:
    """Errors of a recovery's occluded samples.

    Attributes
    ----------
    rms_cm, max_cm : float, cm
        Of the IMU's position, cm.
    rms_deg : float, deg
        Of its orientation, degrees; nan where the method has none.
    inside_95 : float
        Part of the samples inside the region that should hold 95 %; nan without a covariance.
    samples, unanswered : int
        How many have an answer, and how many have not.
    gaps : int
        Of the recording.
    """

    rms_cm: float
    max_cm: float
    rms_deg: float
    inside_95: float
    samples: int
    unanswered: int
    gaps: int


def exactness(recovery: Recovery, truth: Truth, occluded: BoolArray | None = None) -> Exactness:
    """The errors in the gaps; `occluded` (N,) of another method's recovery, to look at the same samples."""
    chosen = recovery.occluded if occluded is None else occluded
    figures = sample_errors(recovery, truth).figures(chosen)

    def number(value: float | None, scale: float = 1.0) -> float:
        return float("nan") if value is None else scale * value

    return Exactness(
        rms_cm=number(figures.position_rms_m, 100.0),
        max_cm=number(figures.position_max_m, 100.0),
        rms_deg=number(figures.orientation_rms_deg),
        inside_95=number(figures.coverage_95),
        samples=figures.samples,
        unanswered=figures.unanswered,
        gaps=len(recovery.gaps),
    )


def exactness_of_file(result: Path, truth: Path) -> Exactness:
    """The errors of a result file."""
    (recovery,) = read_recovery(result)
    return exactness(recovery, read_truth(truth, recovery.origin_ns))


def apart_cm(one: FloatArray, other: FloatArray) -> float:
    """Rms distance of two answers (N, 3) m, cm; samples that one of them has not are left out."""
    distance = np.linalg.norm(one - other, axis=1)
    return float(100.0 * np.sqrt(np.nanmean(distance**2))) if np.isfinite(distance).any() else float("nan")
