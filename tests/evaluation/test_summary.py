"""What a recovery says of itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import make_recording, make_recovery

from smoother.evaluation.summary import gap_summaries, recovery_figures


def occluded_recovery():
    recording = make_recording(20.0)
    t = recording.arm.t_s
    return make_recovery(replace(recording, arm=recording.arm.hide((t > 5) & (t < 7))), sigma_m=0.02)


def test_gap_summary():
    recovery = occluded_recovery()
    position = recovery.position.copy()
    position[(recovery.t_s > 6.0)] = np.nan
    (found,) = gap_summaries(replace(recovery, position=position))
    assert found.gap.length_s == pytest.approx(2.0, abs=0.1)
    assert found.sigma_max_m == pytest.approx(0.02)
    assert found.sigma_max_deg == pytest.approx(np.degrees(0.01 * np.sqrt(3)))
    assert found.answered == pytest.approx(0.5, abs=0.05)


def test_figures_without_a_covariance():
    recovery = occluded_recovery()
    blank = replace(
        recovery, pose_covariance=np.full_like(recovery.pose_covariance, np.nan), calibration=None
    )
    figures = recovery_figures(blank)
    assert figures["sigma_m"]["occluded"] == {"median": None, "max": None}
    assert figures["error_95_m"]["occluded"] == {"all": None, "max": None}
    assert figures["calibration"] is None
    assert figures["gaps"][0]["sigma_max_m"] is None
    assert recovery_figures(recovery)["calibration"]["upper_arm_m"] == 0.31
