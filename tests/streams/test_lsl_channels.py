"""What streams say of their channels, well and badly."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.errors import RecordingError
from smoother.recording import CameraFrame, JointState
from smoother.streams.channels import ImuChannels, SkeletonChannels, StreamLabels

AXES = "xyz"


def stream(labels, units=None, types=None, name="wrist", kind="IMU") -> StreamLabels:
    units = [units] * len(labels) if isinstance(units, str) else units or [""] * len(labels)
    return StreamLabels(name, kind, list(labels), list(types or [""] * len(labels)), list(units))


def imu_labels(acc="acc", gyro="gyro"):
    return [f"{kind}_{axis}" for kind in (acc, gyro) for axis in AXES]


def arm_labels(*sides, joints=("shoulder", "elbow", "wrist")):
    return [f"{joint}_{side}_{axis}" for side in sides for joint in joints for axis in AXES]


def test_units_become_si():
    channels = ImuChannels.of(stream(imu_labels(), ["g"] * 3 + ["deg/s"] * 3))
    values = channels.values(np.array([[0, 0, 1, 180, 0, 0]], np.float32))
    np.testing.assert_allclose(values["acc"], [[0, 0, 9.80665]])
    np.testing.assert_allclose(values["gyro"], [[np.pi, 0, 0]], rtol=1e-6)
    assert "mag" not in values


def test_labels_of_devices():
    labels = ["timestamp", "AccX", "AccY", "AccZ", "GyrX", "GyrY", "GyrZ", "MagX", "MagY", "MagZ"]
    units = ["s", *["m/s²"] * 3, *["°/s"] * 3, *["uT"] * 3]
    channels = ImuChannels.of(stream(labels, units))
    assert channels.axes == {"acc": (1, 2, 3), "gyro": (4, 5, 6), "mag": (7, 8, 9)}
    channels = ImuChannels.of(stream([""] * 6, ["m/s^2"] * 3 + ["rad/s"] * 3, [f"Acc{a}" for a in "XYZ"] + [
        f"Gyro{a}" for a in "XYZ"]))  # fmt: skip
    assert channels.axes["acc"] == (0, 1, 2)


def imu(labels: StreamLabels) -> ImuChannels:
    return ImuChannels.of(labels)


def arm(labels: StreamLabels) -> SkeletonChannels:
    return SkeletonChannels.of(labels, None)


SHORT = arm_labels("right", joints=("shoulder", "elbow"))


@pytest.mark.parametrize(
    "read, labels, units, said",
    [
        (imu, [""] * 6, "", "its channels have no labels; acc_x, acc_y, acc_z and gyro_x"),
        (imu, imu_labels()[:3], "g", "gyro_z are missing: send accelerometer and gyroscope"),
        (imu, imu_labels()[:3], "g", "in one stream or in two (--gyro names the second)"),
        (imu, imu_labels(), "", "the unit of its accelerometer is missing; send m/s^2 or g"),
        (imu, imu_labels(), ["g"] * 3 + ["furlong"] * 3, "stated as 'furlong', which is not known"),
        (imu, imu_labels(), ["g", "g", "m/s^2", *["deg/s"] * 3], "accelerometer is stated as 'g, m/s^2'"),
        (imu, ["left_acc_x\x1b", "b", "c"], "", "left_acc_x\\x1b, b, c; acc_x"),
        (arm, [""] * 9, "m", "its channels have no labels; shoulder, elbow and wrist of an arm are missing"),
        (arm, SHORT, "m", "are missing: send their x, y, z"),
        (arm, arm_labels("right"), "", "the unit of its positions is missing; send m or mm"),
        (arm, arm_labels("right"), "pixel", "positions is stated as 'pixel'"),
    ],
)
def test_a_stream_that_does_not_say_enough(read, labels, units, said):
    with pytest.raises(RecordingError) as error:
        read(stream(labels, units))
    assert said in str(error.value) and "\n" not in str(error.value)


def test_a_skeleton_of_the_right_arm_in_mm():
    labels = [*arm_labels("right"), "wrist_right_confidence"]
    channels = SkeletonChannels.of(stream(labels, ["mm"] * 9 + [""], kind="MoCap"), None)
    assert (channels.side, channels.joints) == ("right", ("shoulder", "elbow", "wrist"))
    values = np.full((3, 10), 1000.0)
    values[:, 9] = [0.9, 0.4, np.nan]
    values[1, 0:3], values[2, 3:6] = 0.0, np.nan
    position, state = channels.values(values).values()
    assert position[0, 2].tolist() == [1.0, 1.0, 1.0]
    tracked, inferred, lost = JointState.TRACKED, JointState.INFERRED, JointState.NOT_TRACKED
    assert state.tolist() == [
        [tracked, tracked, tracked, lost, lost],
        [lost, tracked, inferred, lost, lost],  # all of (0, 0, 0) is how programs write a lost joint
        [tracked, lost, tracked, lost, lost],
    ]
    assert np.isnan(position[1, 0]).all()


def test_states_of_a_kinect_stay_states_in_every_batch():
    labels = [*arm_labels("right"), "wrist_right_state"]
    channels = SkeletonChannels.of(stream(labels, "m"), None)
    for value, state in ((0, JointState.NOT_TRACKED), (1, JointState.INFERRED), (2, JointState.TRACKED)):
        values = np.ones((1, 10))
        values[0, 9] = value
        assert channels.values(values)["state"][0, 2] == state


def test_which_arm():
    both = stream(arm_labels("left", "right"), "m", name="kinect")
    with pytest.raises(RecordingError, match="kinect shows both arms; choose the one with the IMU by --side"):
        SkeletonChannels.of(both, None)
    assert SkeletonChannels.of(both, "left").side == "left"
    assert SkeletonChannels.of(both, None, "left").side == "left"
    assert SkeletonChannels.of(both, "right", "left").axes["shoulder"] == (9, 10, 11)
    with pytest.raises(RecordingError, match="shows no left arm"):
        SkeletonChannels.of(stream(arm_labels("right"), "m"), "left")


def test_a_strap_alone_and_the_cameras_axes():
    strap = SkeletonChannels.of(stream(["strap_x", "strap_y", "strap_z"], "m"), "left")
    assert (strap.side, strap.joints) == ("left", ("strap",))
    labels = [f"{j}_{a}" for j in ("SPINE_NAVEL", "ELBOW_LEFT", "WRIST_LEFT") for a in "XYZ"]
    assert SkeletonChannels.of(stream(labels, "m"), None).camera_frame is CameraFrame.OPTICAL


def test_one_of_several_bodies():
    labels = [f"body{n}_{label}" for n in (1, 2) for label in arm_labels("right")]
    both = stream(labels, "m", name="kinect")
    with pytest.raises(RecordingError, match=r"kinect shows several bodies \(1, 2\); choose with --body"):
        SkeletonChannels.of(both, None)
    assert SkeletonChannels.of(both, None, body="2").axes["wrist"] == (15, 16, 17)
    with pytest.raises(RecordingError, match="shows no body 3, but 1, 2"):
        SkeletonChannels.of(both, None, body="3")
    alone = stream([f"Person 7: {label}" for label in arm_labels("left")], "m")
    assert SkeletonChannels.of(alone, None).side == "left"


def test_text_and_two_sensors_in_one_stream():
    text = StreamLabels("notes", "Markers", ["acc_x"], [""], [""], is_text=True)
    for read in (imu, arm):
        with pytest.raises(RecordingError, match="notes sends text, not numbers"):
            read(text)
    ranges = [f"{name}_{axis}" for name in ("acc_ln", "acc_wr", "gyro") for axis in AXES]
    with pytest.raises(RecordingError, match=r"has several accelerometers \(acc_wr_x, acc_wr_y"):
        ImuChannels.of(stream(ranges, ["m/s^2"] * 6 + ["rad/s"] * 3))
    with pytest.raises(RecordingError, match=r"has several accelerometers \(acc_x, acc_y, acc_z\)"):
        ImuChannels.of(stream([*imu_labels()[:3], *imu_labels()], "g"))
