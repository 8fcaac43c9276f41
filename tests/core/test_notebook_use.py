"""What a notebook does: a recording from arrays, recordings and recoveries that show themselves, a table."""

from __future__ import annotations

from dataclasses import replace

import made_results
import numpy as np
import pyarrow as pa
import pytest
from scenes import ALONE, moving

from smoother import JointState, Recording, Recovery, UnoccludeError
from smoother.recording import JOINTS
from smoother.simulation import SimulatedArm
from smoother.smoothing import smooth


@pytest.fixture(scope="module")
def made() -> SimulatedArm:
    return moving(4, "white", 12.0)


@pytest.fixture(scope="module")
def recovery(made: SimulatedArm) -> Recovery:
    return smooth(made.recording, made.calibration, ALONE)


def arrays(made: SimulatedArm) -> dict:
    imu, arm = made.recording.imu, made.recording.arm
    joints = {joint: arm.joint(joint) for joint in arm.present}
    return {
        "imu_t_s": imu.t_s,
        "acc": imu.acc,
        "gyro": imu.gyro,
        "frame_t_s": arm.t_s,
        "joints": joints,
        "states": {joint: arm.state[:, JOINTS.index(joint)] for joint in joints},
        "side": "right",
        "camera_frame": "kinect",
    }


def test_arrays_give_the_same_answer_as_the_recording(made: SimulatedArm, recovery: Recovery) -> None:
    built = Recording.from_arrays(**arrays(made))
    again = smooth(built, made.calibration, ALONE)
    np.testing.assert_array_equal(again.position, recovery.position)
    assert again.gaps == recovery.gaps
    # without states a finite position is tracked
    stateless = Recording.from_arrays(**(arrays(made) | {"states": None})).arm
    finite = np.isfinite(stateless.joint("wrist")).all(axis=1)
    np.testing.assert_array_equal(stateless.tracked("wrist"), finite)
    assert set(np.unique(stateless.state)) <= {JointState.NOT_TRACKED, JointState.TRACKED}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"acc": np.zeros((3, 3))}, r"acc has the shape \(3, 3\); it must be"),
        ({"imu_t_s": np.zeros(0)}, "imu_t_s must contain at least two times"),
        ({"joints": {"knee": np.zeros((5, 3))}}, "knee is not a joint; joints are shoulder, elbow"),
        ({"side": "middle"}, "left or right, not middle"),
        ({"camera_frame": "upside"}, "one of kinect, optical, zup, not upside"),
        ({"gravity_hint": [0.0, np.nan, 0.0]}, "gravity_hint contains values that are not finite"),
        ({}, "times that increase"),
    ],
)
def test_what_does_not_fit_is_one_sentence(made: SimulatedArm, change: dict, sentence: str) -> None:
    if sentence == "times that increase":
        change = {"imu_t_s": np.round(made.recording.imu.t_s, 1)}
    with pytest.raises(UnoccludeError, match=sentence):
        Recording.from_arrays(**(arrays(made) | change))


@pytest.fixture(scope="module")
def shown() -> Recovery:
    return made_results.recovery()


def test_recordings_and_recoveries_show_themselves(made: SimulatedArm, shown: Recovery) -> None:
    nothing = slice(0, 0)
    nowhere = {"position": np.full_like(shown.position, np.nan), "joints": {}, "joint_covariance": {}}
    spread = np.full_like(shown.pose_covariance, np.nan)
    recording = made.recording
    nobody = replace(recording, imu=recording.imu.select(nothing), arm=recording.arm.select(nothing))
    for value, words in (
        (recording, ("12.0 s", "80.0 Hz", "360 frames", "truth")),
        (shown, (shown.name, f"{len(shown)} samples", f"{len(shown.gaps)} gap", "in 95 of 100 cases")),
        (replace(shown.rows(nothing), gaps=()), ("0 samples", "no gaps")),
        (replace(shown, pose_covariance=spread, **nowhere), ("no answer",)),
        (nobody, ("0 frames", "joints none")),
    ):
        lines = repr(value).splitlines()
        assert 3 <= len(lines) <= 5 and all(word in repr(value) for word in words)


def test_the_table_has_units_and_nulls_where_nothing_is_known(shown: Recovery) -> None:
    table, wrist_y = shown.to_table(), shown.joints["wrist"][:, 1]
    units = {
        "t_s": "s",
        "occluded": "",
        "imu_qw": "",
        "velocity_z": "m/s",
        "sigma_deg": "deg",
        "wrist_x": "m",
    }
    assert {name: table.schema.field(name).metadata[b"unit"].decode() for name in units} == units
    assert table.num_rows == len(shown) and table["occluded"].type == pa.bool_()
    assert table["imu_x"].null_count == np.isnan(shown.position[:, 0]).sum() > 0
    np.testing.assert_array_equal(table["wrist_y"].to_numpy(zero_copy_only=False), wrist_y)
    pytest.importorskip("pandas")
    np.testing.assert_array_equal(shown.to_dataframe()["wrist_y"], wrist_y)
