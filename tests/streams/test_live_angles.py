"""Angles of the live arm, with their sigmas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from live_engine import answer

from smoother.streams.lsl import live_angles


def test_angles_and_their_sigmas_agree_with_drawn_joints():
    output = answer(1.0, 70.0)
    angles = live_angles(output.now, np.array([0.0, 1.0, 0.0]))
    assert angles["elbow_flexion"][0] == pytest.approx(70.0, abs=1e-6)
    assert angles["shoulder_elevation"][0] == pytest.approx(0.0, abs=1e-6)
    assert angles["forearm_elevation"][0] == pytest.approx(-20.0, abs=1e-6)
    rng, drawn = np.random.default_rng(1), []
    for _ in range(2000):
        joints = {joint: at + rng.normal(0.0, 0.01, 3) for joint, at in output.now.joints.items()}
        drawn.append(live_angles(replace(output.now, joints=joints), None)["elbow_flexion"][0])
    assert angles["elbow_flexion"][1] == pytest.approx(np.std(drawn), rel=0.08)  # 2000 draws: 1.6 %
    assert set(live_angles(output.now, None)) == {"elbow_flexion"}
