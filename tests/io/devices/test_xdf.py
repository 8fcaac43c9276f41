"""XDF of the Lab Streaming Layer, and libraries that are absent."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skeleton_files as made
from numpy.testing import assert_allclose
from other_recordings import read, turning

from smoother.errors import RecordingError
from smoother.io.tables.columns import find_sensors
from smoother.io.tables.joint_columns import KINECT_V2
from smoother.recording import CameraFrame, JointState

FRAMES = 60
ZERO = 1_700_000_000 * 10**9


def imu_stream(unit: tuple[str, str], labels: list[str], **more: Any) -> dict[str, Any]:
    t, acc, gyro = turning(1000, 100.0)
    acc = acc / 9.80665 if unit[0] == "g" else acc
    gyro = np.degrees(gyro) if unit[1] == "deg/s" else gyro
    channels = list(zip(labels, [unit[0]] * 3 + [unit[1]] * 3, strict=True))
    stream = {"name": "Wrist", "type": "IMU", "rate": 100, "channels": channels}
    return {**stream, "t_s": 50 + t, "values": np.hstack([acc, gyro]), **more}


def kinect_stream() -> dict[str, Any]:
    points = made.kinect_v2(FRAMES)
    values = np.concatenate([points, np.ones((FRAMES, 25, 1))], axis=2).reshape(FRAMES, -1)
    channels = [
        (f"{n}_{f}", "meters" if f != "Conf" else "") for n in KINECT_V2 for f in ("X", "Y", "Z", "Conf")
    ]
    t_s = 950.0 + np.arange(FRAMES) / 30
    return {
        "name": "K",
        "type": "MoCap",
        "rate": 30,
        "channels": channels,
        "t_s": t_s,
        "values": values,
        "offset": -900.0,
    }


@pytest.mark.parametrize(
    "labels",
    [
        ["acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z"],
        ["AccX", "AccY", "AccZ", "GyroX", "GyroY", "GyroZ"],
        ["ax", "ay", "az", "gx", "gy", "gz"],
        [
            "Accelerometer X",
            "Accelerometer Y",
            "Accelerometer Z",
            "Gyroscope X",
            "Gyroscope Y",
            "Gyroscope Z",
        ],
    ],
)
@pytest.mark.parametrize("unit", [("m/s^2", "rad/s"), ("g", "deg/s")])
def test_xdf(tmp_path: Path, labels: list[str], unit: tuple[str, str]) -> None:
    path = tmp_path / "any"
    made.xdf(path, [kinect_stream(), imu_stream(unit, labels)])
    (body,), (imu,) = read(path, "xdf")
    t, acc, gyro = turning(1000, 100.0)
    assert_allclose(imu.t_s, 50 + t, atol=1e-9)
    assert_allclose(imu.acc, acc, atol=1e-9)
    assert_allclose(imu.gyro, gyro, atol=1e-9)
    assert imu.units == ", ".join(unit)
    assert imu.rate_hz == 100
    assert_allclose(body.t_s, 50 + np.arange(FRAMES) / 30, atol=1e-6)  # the clock offset is in the file
    assert body.frame is CameraFrame.KINECT
    assert_allclose(body.position["wrist_left"], made.kinect_v2(FRAMES)[:, 6], atol=1e-12)
    assert (body.state["wrist_left"] == JointState.TRACKED).all()


@pytest.mark.parametrize("unit", [("m/s^2", "rad/s"), ("g", "deg/s")])
def test_xdf_without_units(tmp_path: Path, unit: tuple[str, str]) -> None:
    stream = imu_stream(unit, ["ax", "ay", "az", "gx", "gy", "gz"])
    stream["channels"] = [(label, "") for label, _ in stream["channels"]]
    path = tmp_path / "a.xdf"
    made.xdf(path, [stream])
    _, (imu,) = read(path, "xdf")
    assert_allclose(imu.gyro, turning(1000, 100.0)[2], atol=1e-9)
    assert imu.units == ", ".join(unit)
    assert any("it then turns as gravity does" in note for note in imu.notes)


def test_xdf_in_which_nothing_shows_the_unit(tmp_path: Path) -> None:
    stream = imu_stream(("m/s^2", "rad/s"), ["ax", "ay", "az", "gx", "gy", "gz"])
    stream["channels"] = [(label, "") for label, _ in stream["channels"]]
    stream["values"] = np.tile([0.0, 9.81, 0.0, 0.01, 0.0, 0.0], (1000, 1))
    path = tmp_path / "a.xdf"
    made.xdf(path, [stream])
    with pytest.raises(RecordingError, match=r"a\.xdf.*gyroscope's unit is not stated.*and units"):
        read(path, "xdf")


def test_xdf_of_a_sensor_in_two_streams(tmp_path: Path) -> None:
    t, acc, gyro = turning(1000, 100.0)
    streams = [
        {
            "name": f"Phone {name}",
            "type": name,
            "rate": 100,
            "t_s": t,
            "values": values,
            "channels": [("X", unit), ("Y", unit), ("Z", unit)],
        }
        for name, unit, values in (("Accelerometer", "m/s^2", acc), ("Gyroscope", "rad/s", gyro))
    ]
    path = tmp_path / "a.xdf"
    made.xdf(path, streams)
    _, (imu,) = read(path, "xdf")
    assert imu.acc is not None
    assert imu.gyro is not None
    assert_allclose(imu.acc, acc[: len(imu.acc)], atol=1e-9)
    assert_allclose(imu.gyro, gyro[: len(imu.gyro)], atol=1e-9)


def test_xdf_without_motion(tmp_path: Path) -> None:
    eeg = {"name": "Cap", "type": "EEG", "rate": 250, "t_s": np.arange(50) / 250, "values": np.zeros((50, 4))}
    path = tmp_path / "a.xdf"
    made.xdf(path, [{**eeg, "channels": [(name, "uV") for name in ("Fz", "Cz", "Pz", "Oz")]}])
    with pytest.raises(RecordingError, match=r"a\.xdf has no stream.*Cap \(EEG, 4 channels\)"):
        read(path, "xdf")
    path.write_bytes(b"XDF:" + bytes(range(200)))
    with pytest.raises(RecordingError, match=r"a\.xdf"):
        read(path, "xdf")


def test_several_sensors_in_a_stream() -> None:
    labels = [
        f"{name}_{kind}_{axis}" for name in ("wrist", "trunk") for kind in ("acc", "gyro") for axis in "xyz"
    ]
    labels += ["wrist_quat_w", "wrist_quat_x", "wrist_quat_y", "wrist_quat_z"]
    first, second = find_sensors(labels, [""] * len(labels), "Movella IMU")
    assert (first.name, second.name) == ("wrist", "trunk")
    assert first.axes == {"acc": (0, 1, 2), "gyro": (3, 4, 5)}
    assert second.axes == {"acc": (6, 7, 8), "gyro": (9, 10, 11)}


@pytest.mark.parametrize("library", ["pyxdf", "rosbags.rosbag1"])
def test_a_library_that_is_absent(tmp_path: Path, library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name.startswith(library):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    path = tmp_path / "a"
    path.write_bytes(b"XDF:" if library == "pyxdf" else b"#ROSBAG V2.0\n")
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(RecordingError, match="pip install"):
        read(path, "xdf" if library == "pyxdf" else "rosbag1")
