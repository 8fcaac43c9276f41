"""What the tool that holds measures against truth counts, on samples that are known."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.simulation import ArmSimulation, simulate_arm
from tools.accuracy.measures import NEAR_DEG, Sample, coverage_table, hidden_extremes, markdown


def sample(value: float, truth: float, scope: str = "session", key: str = "hand_path_length_m") -> Sample:
    return Sample(key, scope, value, truth, 0.5, value - 0.95, value + 0.95)


def test_coverage_and_errors_are_counted_by_scope_and_key():
    samples = [sample(10.0, 10.5), sample(10.0, 8.5), sample(10.0, 10.0, "movement"), sample(np.nan, 1.0)]
    session, movement = coverage_table(samples)
    assert (session["cases"], session["coverage"], movement["coverage"]) == (2, 0.5, 1.0)
    assert session["rms"] == pytest.approx(np.sqrt((0.5**2 + 1.5**2) / 2)) and session["bias"] == 0.5
    assert session["width"] == pytest.approx(1.9)
    row = markdown({"azure": [session, movement]}).splitlines()[-1]
    assert row == "| `hand_path_length_m` | 50 % of 2 | 100 % of 1 | 1.1 |"


def test_zones_of_an_angle_count_together():
    keys = [f"elbow_flexion_zone_{low}_to_{low + 10}_percent" for low in (30, 40)]
    (row,) = coverage_table([sample(20.0, 20.0, key=key) for key in keys])
    assert (row["key"], row["cases"]) == ("elbow_flexion_zones_percent", 2)


def test_two_thirds_about_the_extremes_are_hidden():
    from smoother.joint_angles import arm_angles

    config = ArmSimulation.preset("white", protocol="random", occlusion_lengths_s=(), duration_s=20.0)
    simulated = simulate_arm(config, 1)
    arm, hidden = simulated.recording.arm, hidden_extremes(simulated).recording.arm
    lost = arm.tracked("wrist") & ~hidden.tracked("wrist")
    truth = simulated.recording.truth
    assert truth is not None
    flexion = arm_angles(truth.joints, len(truth.t_s))["elbow_flexion"]
    at = np.interp(arm.t_s, truth.t_s, flexion)
    near = (at >= flexion.max() - NEAR_DEG) | (at <= flexion.min() + NEAR_DEG)
    # the camera's stamps are those of the IMU in this preset: what is hidden lies about the extremes
    assert lost.sum() > 5 and near[lost].mean() > 0.9
    for extreme in (np.argmax(flexion), np.argmin(flexion)):
        assert lost[np.argmin(np.abs(arm.t_s - truth.t_s[extreme]))]
