"""Mistakes that are undone as a recording is read: twice is none, the rest stays, and it is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import arm

from smoother.errors import RecordingError
from smoother.io import write_recording
from smoother.io.recording.read import read_arms
from smoother.measurements.remedy import Remedy
from smoother.recording import JOINTS, CameraFrame, Recording

ALL = Remedy("z", ("elbow", "wrist"), ("accelerometer", "gyroscope"), CameraFrame.OPTICAL)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return arm(1, repetitions=1).recording


def test_what_each_changes(recording: Recording) -> None:
    corrected = ALL.applied(recording)
    np.testing.assert_array_equal(corrected.imu.acc, -recording.imu.acc)
    np.testing.assert_array_equal(corrected.imu.gyro, -recording.imu.gyro)
    np.testing.assert_array_equal(corrected.arm.joint("elbow"), recording.arm.joint("wrist") * [1, 1, -1])
    np.testing.assert_array_equal(corrected.arm.joint("hand"), recording.arm.joint("hand") * [1, 1, -1])
    wrist, elbow = JOINTS.index("wrist"), JOINTS.index("elbow")
    np.testing.assert_array_equal(corrected.arm.state[:, wrist], recording.arm.state[:, elbow])
    assert corrected.camera_frame is CameraFrame.OPTICAL
    assert corrected.truth is recording.truth and corrected.imu.t_s is recording.imu.t_s
    assert len(corrected.notes) == len(recording.notes) + 5
    again = ALL.applied(corrected)  # twice is none
    for one, other in ((again.arm.position, recording.arm.position), (again.imu.acc, recording.imu.acc)):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(again.arm.state, recording.arm.state)
    assert Remedy().options == "" and Remedy().applied(recording) is recording
    expected = "--mirror z --swap elbow,wrist --negate accelerometer,gyroscope --camera-frame optical"
    assert ALL.options == expected


def test_left_and_right_are_swapped_as_a_file_is_read(recording: Recording, tmp_path: Path) -> None:
    path = tmp_path / "arm.mcap"
    write_recording(recording, path)
    [(read, _)] = read_arms(path, swap_sides=True, remedy=Remedy(mirror="x"), alone=True)
    assert (recording.side, read.side) == ("right", "left")
    assert any("left and right" in note for note in read.notes)
    assert any("--mirror x" in note for note in read.notes)
    assert read.applied_fixes == ("--swap left,right", "--mirror x")
    with pytest.raises(RecordingError, match="the camera saw one arm"):
        Remedy(sides=True).applied(replace(recording, opposite=None))
