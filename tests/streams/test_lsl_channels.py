"""What streams say of their channels, well and badly; halves of an IMU; angles of the live arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from live_engine import answer

from smoother.errors import RecordingError
from smoother.recording import CameraFrame, JointState
from smoother.streams.arrivals import Rows
from smoother.streams.channels import ImuChannels, SkeletonChannels, StreamLabels, belongs, is_accelerometer
from smoother.streams.lsl import ImuHalves, live_angles

AXES = "xyz"


def stream(labels, units=None, types=None, name="wrist", kind="IMU") -> StreamLabels:
    units = [units] * len(labels) if isinstance(units, str) else units or [""] * len(labels)
    return StreamLabels(name, kind, list(labels), list(types or [""] * len(labels)), list(units))


def imu_labels(acc="acc", gyro="gyro"):
    return [f"{kind}_{axis}" for kind in (acc, gyro) for axis in AXES]


def arm_labels(*sides, joints=("shoulder", "elbow", "wrist")):
    return [f"{joint}_{side}_{axis}" for side in sides for joint in joints for axis in AXES]


def test_labels_and_units_of_devices():
    channels = ImuChannels.of(stream(imu_labels(), ["g"] * 3 + ["deg/s"] * 3))
    values = channels.values(np.array([[0, 0, 1, 180, 0, 0]], np.float32))
    np.testing.assert_allclose(np.hstack([*values.values()]), [[0, 0, 9.80665, np.pi, 0, 0]], rtol=1e-6)
    assert list(values) == ["acc", "gyro"]
    labels = ["timestamp", *(f"{kind}{axis}" for kind in ("Acc", "Gyr", "Mag") for axis in "XYZ")]
    channels = ImuChannels.of(stream(labels, ["s", *["m/s²"] * 3, *["°/s"] * 3, *["uT"] * 3]))
    assert channels.axes == {"acc": (1, 2, 3), "gyro": (4, 5, 6), "mag": (7, 8, 9)}
    types = [f"{kind}{axis}" for kind in ("Acc", "Gyro") for axis in "XYZ"]
    channels = ImuChannels.of(stream([""] * 6, ["m/s^2"] * 3 + ["rad/s"] * 3, types))
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


@pytest.mark.parametrize(
    ("value", "state"),
    [(0, JointState.NOT_TRACKED), (1, JointState.INFERRED), (2, JointState.TRACKED)],
)
def test_states_of_a_kinect_stay_states_in_every_batch(value, state):
    channels = arm(stream([*arm_labels("right"), "wrist_right_state"], "m"))
    assert channels.values(np.append(np.ones(9), value)[None])["state"][0, 2] == state


def test_which_arm():
    both = stream(arm_labels("left", "right"), "m", name="kinect")
    with pytest.raises(RecordingError, match="kinect shows both arms; choose the one with the IMU by --side"):
        arm(both)
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
        arm(both)
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


def sent(rate_hz: float, begin_s: float = 0.0, step_s: float = 0.0) -> Rows:
    """A half of 6 s whose values are linear in time, and whose clock steps at 3 s."""
    t = begin_s + np.arange(0.0, 6.0, 1 / rate_hz)
    values = np.stack([t, 2.0 * t, -t], axis=1)
    return Rows(t + np.where(t > 3.0, step_s, 0.0), t + 0.004, {"values": values})


def played(acc: Rows, gyro: Rows) -> tuple[Rows, list[str]]:
    """All joined samples, and what was said, played by arrival."""
    halves, out, said = ImuHalves("acc", "gyro"), [], []
    for now in np.arange(0.0, 6.2, 0.033):
        new = [each.select((each.arrival_s > now - 0.033) & (each.arrival_s <= now)) for each in (acc, gyro)]
        joined, events = halves.joined(*new)
        out.append(joined)
        said += events
    assert max(map(len, halves._waiting)) <= 201  # two seconds
    return Rows.joined(out), said


def test_the_accelerometer_is_interpolated_at_the_gyroscopes_stamps_but_not_where_it_pauses():
    acc, gyro = sent(52, begin_s=0.003), sent(100)
    acc = acc.select((acc.t_s < 1.0) | (acc.t_s > 2.0))
    joined, said = played(acc, gyro)
    t, first, second = gyro.t_s, *acc.t_s[np.searchsorted(acc.t_s, 1.5) + np.array([-1, 0])]
    inside = (t >= acc.t_s[0]) & (t <= acc.t_s[-1]) & ((t <= first) | (t >= second))
    assert not said
    np.testing.assert_array_equal(joined.t_s, t[inside])
    np.testing.assert_allclose(joined["values"][:, :3], gyro["values"][inside], atol=1e-12)  # linear: exact
    np.testing.assert_array_equal(joined["values"][:, 3:], gyro["values"][inside])
    assert not len(played(Rows(), gyro)[0])


def test_each_halfs_clock_is_put_right():
    joined, said = played(sent(50, step_s=50.0), sent(100))
    assert len(said) == 1 and "the clock of acc stepped by +50.0" in said[0]
    assert joined.t_s[-1] > 5.9
    np.testing.assert_allclose(joined["values"][:, 0], joined.t_s, atol=0.011)  # to an interval's accuracy


def muse(kind: str, unit: str = "g") -> StreamLabels:
    return stream("XYZ", unit, name="Muse", kind=kind)


def test_what_a_stream_is_shows_in_its_name_and_type():
    assert [is_accelerometer(muse(kind)) for kind in ("ACC", "GYRO", "EEG")] == [True, False, False]
    assert belongs("Muse", "GYRO", "Muse")
    assert belongs("phone_gyroscope", "", "phone_accelerometer")
    assert not belongs("watch_gyroscope", "", "phone_accelerometer")
    halves = ImuChannels.of(muse("ACC"), "acc"), ImuChannels.of(muse("GYRO", "deg/s"), "gyro")
    values = halves[0].with_gyroscope(halves[1], 3).values(np.array([[0.0, 0.0, 1.0, 180.0, 0.0, 0.0]]))
    np.testing.assert_allclose(np.hstack([values["acc"], values["gyro"]]), [[0, 0, 9.80665, np.pi, 0, 0]])
    with pytest.raises(RecordingError, match="cannot be used as gyroscope: its channels are X, Y, Z; gyro_x"):
        ImuChannels.of(muse("ACC"), "gyro")


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
