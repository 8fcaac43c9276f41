"""Hidden samples of a strap whose lever arm was solved: compared with the strap, not with the IMU."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from arms import make_recording, make_recovery, turn

from smoother.calibration import LeverArm
from smoother.evaluation.hidden_gaps import HiddenGap, score_gap, strap_position
from smoother.recording import JOINTS, JointState

LEVER = np.array([0.01, -0.02, 0.03])


def test_a_solved_lever_arm_counts():
    recording = make_recording(truth=False)
    recovery = make_recovery(recording)
    assert recovery.calibration is not None
    lever = LeverArm(LEVER, np.full(3, 0.004))
    solved = replace(
        recovery,
        calibration=replace(
            recovery.calibration, lever_arms={**recovery.calibration.lever_arms, "strap": lever}
        ),
    )
    expected = recovery.position + turn(recovery.t_s).apply(LEVER)
    np.testing.assert_allclose(strap_position(solved), expected, atol=1e-12)
    np.testing.assert_array_equal(strap_position(recovery), recovery.position)
    # a camera that sees the strap alone, there
    position, state = np.full_like(recording.arm.position, np.nan), np.zeros_like(recording.arm.state)
    strap = JOINTS.index("strap")
    at_frames = [np.interp(recording.arm.t_s, recovery.t_s, expected[:, k]) for k in range(3)]
    position[:, strap], state[:, strap] = np.stack(at_frames, axis=1), JointState.TRACKED
    seen = replace(recording, arm=replace(recording.arm, position=position, state=state))
    gap = HiddenGap(8.0, 9.0)
    right, wrong = score_gap(seen, solved, gap), score_gap(seen, recovery, gap)
    assert right.reference == "strap"
    assert right.distance_m.max() < 1e-3 < 0.9 * np.linalg.norm(LEVER) < wrong.distance_m.min()
