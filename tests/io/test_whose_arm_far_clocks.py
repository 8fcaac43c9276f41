"""Whose arm an IMU is on, when its clock and the camera's are seconds apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from smoother.errors import RecordingError
from smoother.io.recording.assign import choose
from smoother.io.recording.streams import ArmFrames, ImuSamples, RecordingFile
from smoother.recording import JOINTS


def scene(shift_s: float, same: bool = False) -> RecordingFile:
    """Two arms that move each in its own way, and an IMU that turns as the right one does."""
    t = np.arange(0, 40, 0.01)
    arms, rates = [], []
    for seed, side in ((1, "left"), (1 if same else 2, "right")):
        rng = np.random.default_rng(seed)
        angle = gaussian_filter1d(rng.normal(0, 1, (2, len(t))), 30, axis=1) * 8
        direction = np.stack([np.cos(angle[0]) * np.cos(angle[1]), np.sin(angle[0]) * np.cos(angle[1]),
                              np.sin(angle[1])], axis=1)  # fmt: skip
        rates.append(np.cross(direction, np.gradient(direction, 0.01, axis=0)))
        frames = slice(None, None, 3)
        count = len(t[frames])
        position, state = np.full((count, len(JOINTS), 3), np.nan), np.zeros((count, len(JOINTS)), np.int8)
        noise = rng.normal(0, 0.004, (2, count, 3))
        elbow, wrist = JOINTS.index("elbow"), JOINTS.index("wrist")
        position[:, elbow], position[:, wrist] = noise[0], 0.25 * direction[frames] + noise[1]
        state[:, [elbow, wrist]] = 2
        stamp = np.rint(t[frames] * 1e9).astype(np.int64)
        arms.append(ArmFrames("/skeleton", "camera", 0, side, stamp, position, state))
    stamp = np.rint((t + shift_s) * 1e9).astype(np.int64)
    turns = Rotation.from_rotvec(0.01 * rates[1])
    R_K_A = [Rotation.identity()]
    for turn in turns[1:]:
        R_K_A.append(turn * R_K_A[-1])
    to_sensor = Rotation.concatenate(R_K_A).inv()
    acc, gyro = to_sensor.apply([0, 0, 9.81]), to_sensor.apply(rates[1])
    imu = ImuSamples("/imu/device", "device", stamp, acc, gyro)
    return RecordingFile(Path("a.mcap"), imus=[imu], arms=arms)


@pytest.mark.parametrize("shift_s", [0.1, -8.0, 11.8])
def test_the_arm_is_told_by_motion(shift_s: float):
    choice = choose(scene(shift_s))
    assert choice.side == "right"
    assert ("s apart" in choice.notes[0]) == (abs(shift_s) > 1)


def test_arms_that_move_alike_are_left_open():
    with pytest.raises(RecordingError, match="does not tell which belong together; choose with --side"):
        choose(scene(8.0, same=True))
