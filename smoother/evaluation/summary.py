"""What a recovery says of itself, in a few numbers: its gaps and how sure it is in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..measurements.visibility import Gap
from ..recording import BoolArray, FloatArray
from ..result import Recovery


@dataclass(frozen=True)
class GapSummary:
    """One gap of a recovery.

    Attributes
    ----------
    gap : the stretch, on the IMU's clock.
    sigma_max_m : largest standard deviation of the IMU's position in it, m an axis; None without one.
    sigma_max_deg : largest standard deviation of the orientation in it, degrees; None without one.
    answered : part of the samples in it that have an answer, 0 to 1.
    """

    gap: Gap
    sigma_max_m: float | None
    sigma_max_deg: float | None
    answered: float

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return {
            "start_s": self.gap.start_s,
            "end_s": self.gap.end_s,
            "length_s": self.gap.length_s,
            "open_start": self.gap.open_start,
            "open_end": self.gap.open_end,
            "sigma_max_m": self.sigma_max_m,
            "sigma_max_deg": self.sigma_max_deg,
            "answered": self.answered,
        }


def gap_summaries(recovery: Recovery) -> list[GapSummary]:
    """The recovery's gaps, in order of time, with how sure it is in each."""
    starts = np.searchsorted(recovery.t_s, [gap.start_s for gap in recovery.gaps], "left")
    stops = np.searchsorted(recovery.t_s, [gap.end_s for gap in recovery.gaps], "right")
    summaries = []
    for gap, start, stop in zip(recovery.gaps, starts.tolist(), stops.tolist(), strict=True):
        inside = recovery.rows(slice(start, stop))
        answered = float(inside.answered.mean()) if len(inside) else 0.0
        sigma_m, sigma_deg = _largest(inside.worst_sigma_m), _largest(inside.sigma_deg)
        summaries.append(GapSummary(gap, sigma_m, sigma_deg, answered))
    return summaries


def recovery_figures(recovery: Recovery) -> dict[str, object]:
    """The figures of a recovery as plain values, as `smooth --json` writes them."""
    t = recovery.t_s
    rate_hz = _rate(t)
    sigma = recovery.worst_sigma_m
    return {
        "method": recovery.method,
        "recording": recovery.name,
        "side": recovery.side,
        "samples": len(recovery),
        "answered": int(recovery.answered.sum()),
        "duration_s": float(t[-1] - t[0]) if len(t) else 0.0,
        "rate_hz": rate_hz,
        "occluded_samples": int(recovery.occluded.sum()),
        "occluded_s": float(sum(gap.length_s for gap in recovery.gaps)),
        "gaps": [summary.to_dict() for summary in gap_summaries(recovery)],
        "sigma_m": {
            "visible": _sigmas(sigma, ~recovery.occluded),
            "occluded": _sigmas(sigma, recovery.occluded),
        },
        "clock_offset_s": recovery.clock_offset_s,
        "clock_offset_sigma_s": recovery.clock_offset_sigma_s,
        "gravity_direction": recovery.gravity_direction,
        "calibration": _calibration(recovery),
        "figures": recovery.figures,
        "notes": list(recovery.notes),
        "config": recovery.config,
    }


def _rate(t_s: FloatArray) -> float | None:
    """Median rate, Hz; None for fewer than two samples."""
    return float(1.0 / np.median(np.diff(t_s), overwrite_input=True)) if len(t_s) > 1 else None


def _sigmas(sigma: np.ndarray, chosen: BoolArray) -> dict[str, float | None]:
    values = sigma[chosen & np.isfinite(sigma)]
    largest = _largest(values)
    median = float(np.median(values, overwrite_input=True)) if len(values) else None
    return {"median": median, "max": largest}


def _largest(values: np.ndarray) -> float | None:
    found = np.max(values, initial=-np.inf, where=np.isfinite(values))
    return float(found) if np.isfinite(found) else None


def _calibration(recovery: Recovery) -> dict[str, object] | None:
    found = recovery.calibration
    if found is None:
        return None
    return {
        "side": found.side,
        "lever_arms": {
            joint: {"position_m": lever.position_m, "sigma_m": lever.sigma_m}
            for joint, lever in found.lever_arms.items()
        },
        "upper_arm_m": None if found.upper_arm is None else found.upper_arm.value_m,
        "upper_arm_sigma_m": None if found.upper_arm is None else found.upper_arm.sigma_m,
        "R_F_A": found.R_F_A,
        "accelerometer_bias": found.accelerometer_bias,
        "gyroscope_bias": found.gyroscope_bias,
    }
