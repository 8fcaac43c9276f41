"""A table that lacks one axis of a sensor or joint is refused by the name of that column."""

from __future__ import annotations

from pathlib import Path

import device_files
import pytest
import skeleton_files

from smoother.errors import RecordingError
from smoother.io.devices.files import ImuFiles, import_files
from smoother.io.tables.columns import missing_axes, missing_axes_words

SENSORS = {
    "xsens_dot": ("Acc_Z", "Gyr_Z"),
    "xsens_mt": ("Acc_Y", "Gyr_Z"),
    "shimmer": ("S_Accel_WR_Z_CAL", "S_Gyro_X_CAL"),
    "ximu": ("Gyroscope Z (deg/s)", "Accelerometer Y (g)"),
    "nilspod": ("gyr_z", "acc_x"),
    "metamotion": ("z-axis (g)",),
    "sensorlog": ("accelerometerAccelerationZ(G)", "gyroRotationY(rad/s)"),
    "phyphox": ("Acceleration Z (m/s^2)", "Gyroscope X (rad/s)"),
    "android": ("az", "gy"),
}
SKELETONS = {
    "kinect_v2": "WristRight_z",
    "mediapipe": "right_wrist_z",
    "joint_table": "right_elbow_x",
    "azure_csv": "WRIST_RIGHT (z)",
}


def without(path: Path, column: str) -> Path:
    """The table of a file without a column."""
    lines = path.read_text(encoding="utf-8").splitlines()
    mark = next((one for one in "\t;" if any(one in line for line in lines)), ",")
    cells = [line.split(mark) for line in lines]
    header, at = next(
        (row, [name.strip('"') for name in names].index(column))
        for row, names in enumerate(cells)
        if column in [name.strip('"') for name in names]
    )
    for names in cells[header:]:
        del names[at]
    path.write_text("\n".join(mark.join(names) for names in cells) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(("made", "column"), [(made, one) for made, all_ in SENSORS.items() for one in all_])
def test_a_sensors_missing_axis_is_named(tmp_path: Path, made: str, column: str) -> None:
    """It was "holds no gyroscope", of a file with two thirds of one."""
    path = tmp_path / "sensor.csv"
    getattr(device_files, made)(path)
    with pytest.raises(RecordingError) as told:
        import_files([], [ImuFiles((without(path, column),), "forearm_right")])
    assert f"has no column {column} beside " in str(told.value)
    assert str(told.value).endswith("; export it again with all three axes.")


def test_a_second_sensor_without_an_axis_is_said(tmp_path: Path) -> None:
    path = tmp_path / "opal.csv"
    device_files.apdm(path)
    file, _ = import_files([], [ImuFiles((without(path, "Sternum/Angular Velocity/Z"),))])
    assert len(file.imus) == 1
    assert any("no column Sternum/Angular Velocity/Z beside" in note for note in file.notes)


@pytest.mark.parametrize(("made", "column"), SKELETONS.items())
def test_a_joints_missing_axis_is_named(tmp_path: Path, made: str, column: str) -> None:
    """It was "the wrist was never tracked", when the recording was recovered."""
    path = tmp_path / "skeleton.csv"
    getattr(device_files if hasattr(device_files, made) else skeleton_files, made)(path)
    with pytest.raises(RecordingError) as told:
        import_files([without(path, column)], [])
    assert f"has no column {column} beside " in str(told.value)


def test_numbered_landmarks_and_rows_of_joints(tmp_path: Path) -> None:
    landmarks = skeleton_files.landmarks(30)
    names = [f"{axis}{number}" for number in range(33) for axis in "xyz"]
    path = tmp_path / "landmarks.csv"
    rows = [",".join(f"{value:.5f}" for value in frame.ravel()) for frame in landmarks]
    path.write_text("\n".join([",".join(names), *rows]) + "\n", encoding="utf-8")
    assert import_files([path], [])[0].arms
    with pytest.raises(RecordingError, match="has no column z16 beside x16 and y16"):
        import_files([without(path, "z16")], [])
    device_files.joint_rows(path)
    with pytest.raises(RecordingError, match=r"no known format \(it has no column z beside x and y\)"):
        import_files([without(path, "z")], [])


def test_only_two_of_three_are_a_vector_without_one() -> None:
    assert missing_axes(["t", "index", "max", "ax", "ay", "az", "Quat_X", "roll_x"]) == []
    assert missing_axes(["Acc_X", "Acc_Y", "acc_z"])[0].missing == "Acc_Z"
    assert [each.missing for each in missing_axes(["LWrist.Y", "LWrist.Z", "x1", "z1"])] == ["LWrist.X", "y1"]
    many = missing_axes([f"m{number}_{axis}" for number in range(9) for axis in "xy"])
    assert missing_axes_words(many).endswith("m2_x and m2_y (and 6 more like it)")


def test_two_axes_of_a_joint_that_is_there_otherwise(tmp_path: Path) -> None:
    """Its place in the image beside its place in the room."""
    path = tmp_path / "skeleton.csv"
    skeleton_files.azure_csv(path)
    lines = path.read_text(encoding="utf-8").splitlines()
    lines = [f"{lines[0]},Wrist.Right.x,Wrist.Right.y", *(f"{line},100,200" for line in lines[1:])]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert import_files([path], [])[0].arms
