"""What a notebook does: a recording from arrays, recordings and recoveries that show themselves, a table."""

from __future__ import annotations

from dataclasses import replace

import made_results
import numpy as np
import pyarrow as pa
import pytest
from scenes import ALONE

from smoother import JointState, Recording, Recovery, UnoccludeError
from smoother.recording import JOINTS
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth


@pytest.fixture(scope="module")
def made() -> SimulatedArm:
    return simulate_arm(ArmSimulation.preset("white", protocol="random", duration_s=12.0), 4)


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


def test_without_states_a_finite_position_is_tracked(made: SimulatedArm) -> None:
    given = arrays(made)
    del given["states"]
    built = Recording.from_arrays(**given)
    finite = np.isfinite(built.arm.joint("wrist")).all(axis=1)
    np.testing.assert_array_equal(built.arm.tracked("wrist"), finite)
    assert set(np.unique(built.arm.state)) <= {JointState.NOT_TRACKED, JointState.TRACKED}


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


def test_a_recording_in_some_lines(made: SimulatedArm) -> None:
    lines = repr(made.recording).splitlines()
    assert 3 <= len(lines) <= 5 and max(map(len, lines)) <= 110
    assert (
        "12.0 s" in lines[0] and "80.0 Hz" in lines[1] and "360 frames" in lines[2] and "truth" in lines[-1]
    )


def test_a_recovery_in_some_lines(shown: Recovery) -> None:
    lines = repr(shown).splitlines()
    assert 3 <= len(lines) <= 5 and max(map(len, lines)) <= 230
    assert shown.name in lines[0] and f"{len(shown)} samples" in lines[0]
    assert f"{len(shown.gaps)} gap" in lines[1] and "at worst within" in lines[1]
    worst = max(
        np.nanmax(shown.error_95_m[(shown.t_s >= gap.start_s) & (shown.t_s < gap.end_s)])
        for gap in shown.gaps
    )
    assert f"at worst within {100 * worst:.1f} cm in 95 of 100 cases" in lines[1]


def test_nothing_answered_and_nothing_recorded_still_show(made: SimulatedArm, shown: Recovery) -> None:
    empty = replace(shown.rows(slice(0, 0)), gaps=())
    assert "0 samples" in repr(empty) and "no gaps" in repr(empty)
    nowhere = np.full_like(shown.position, np.nan)
    spread = np.full_like(shown.pose_covariance, np.nan)
    silent = replace(shown, position=nowhere, pose_covariance=spread, joints={}, joint_covariance={})
    assert "no answer" in repr(silent)
    nobody = replace(
        made.recording, imu=made.recording.imu.select(slice(0, 0)), arm=made.recording.arm.select(slice(0, 0))
    )
    assert "0 frames" in repr(nobody) and "joints none" in repr(nobody)


def test_the_table_has_the_columns_of_the_arrays_with_units(shown: Recovery) -> None:
    table = shown.to_table()
    assert isinstance(table, pa.Table) and table.num_rows == len(shown)
    expected = ["t_s", "occluded", "imu_x", "imu_qw", "velocity_z", "sigma_x", "sigma_deg", "wrist_x"]
    assert {*expected, "wrist_sigma_z"} <= set(table.column_names)
    units = {name: table.schema.field(name).metadata[b"unit"].decode() for name in table.column_names}
    assert units["t_s"] == "s" and units["velocity_z"] == "m/s" and units["sigma_deg"] == "deg"
    assert units["wrist_x"] == units["sigma_x"] == "m" and units["imu_qw"] == units["occluded"] == ""
    np.testing.assert_array_equal(
        table["wrist_y"].to_numpy(zero_copy_only=False), shown.joints["wrist"][:, 1]
    )
    assert table["occluded"].type == pa.bool_()
    pytest.importorskip("pandas")
    frame = shown.to_dataframe()
    assert len(frame) == len(shown) and set(expected) <= set(frame.columns)
    np.testing.assert_array_equal(frame["wrist_y"], shown.joints["wrist"][:, 1])


def test_no_answer_is_null_in_the_table(shown: Recovery) -> None:
    position = shown.position.copy()
    position[3:5] = np.nan
    column = replace(shown, position=position).to_table()["imu_x"]
    assert column.null_count == 2 + int(np.isnan(shown.position[:, 0]).sum())
    assert column[3].as_py() is None
