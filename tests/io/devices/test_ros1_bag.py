"""ROS 1 bags."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import skeleton_files as made
from library_files import ZERO, write_bag
from numpy.testing import assert_allclose, assert_array_equal
from other_recordings import read, turning

from smoother.errors import RecordingError
from smoother.recording import CameraFrame

FRAMES = 60


def test_ros1_bag(tmp_path: Path) -> None:
    path = tmp_path / "any"
    write_bag(path)
    (body,), (imu,) = read(path, "rosbag1")
    t, acc, gyro = turning(200, 100.0)
    assert imu.name == "wrist/imu"
    assert_allclose(imu.t_s - ZERO * 1e-9, t, atol=1e-6)  # seconds since 1970 in double precision
    assert_array_equal(imu.acc, acc)
    assert_array_equal(imu.gyro, gyro)
    assert imu.mag is not None
    assert_allclose(imu.mag[:, 1], np.arange(200), atol=1e-3)
    assert (body.body, body.frame, len(body.t_s)) == (3, CameraFrame.OPTICAL, FRAMES)
    there = np.delete(np.arange(FRAMES), np.arange(20, 25))
    wanted = made.expected("wrist_right", FRAMES, "optical")
    assert_array_equal(body.position["wrist_right"][there], wanted[there])
    assert np.isnan(body.position["wrist_right"][20:25]).all()
    assert any("/joint_states: sensor_msgs/JointState contains angles" in note for note in body.notes)


def test_ros1_bag_that_is_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    write_bag(path)
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(RecordingError, match=r"a\.bag is damaged.*rosbag reindex"):
        read(path, "rosbag1")
