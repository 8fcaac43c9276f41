"""What a notebook does: a recording from arrays, a recovery that shows itself, a table."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import ALONE

import smoother
from smoother import JointState, Recording, Recovery, UnoccludeError, smooth
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm


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
        "states": {joint: arm.state[:, smoother.recording.JOINTS.index(joint)] for joint in joints},
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
    ],
)
def test_what_does_not_fit_is_one_sentence(made: SimulatedArm, change: dict, sentence: str) -> None:
    with pytest.raises(UnoccludeError, match=sentence):
        Recording.from_arrays(**(arrays(made) | change))


def test_times_must_increase(made: SimulatedArm) -> None:
    t = made.recording.imu.t_s.copy()
    t[5] = t[4]
    with pytest.raises(UnoccludeError, match="times that increase"):
        Recording.from_arrays(**(arrays(made) | {"imu_t_s": t}))


def test_short_words_for_long_objects(made: SimulatedArm, recovery: Recovery) -> None:
    assert len(repr(recovery)) < 400 and len(repr(made.recording)) < 300
    assert f"{len(recovery.gaps)} gap" in repr(recovery) and "80.0 Hz" in repr(made.recording)
    page = recovery._repr_html_()
    assert page.count("<tr>") == 1 + len(recovery.gaps) and len(page) < 60_000


def test_a_table_has_the_columns_of_the_export(recovery: Recovery) -> None:
    pytest.importorskip("pandas")
    table = recovery.to_dataframe()
    assert len(table) == len(recovery)
    expected = ["t_s", "occluded", "imu_x", "imu_qw", "sigma_x", "sigma_deg", "wrist_x", "wrist_sigma_z"]
    assert set(expected) <= set(table.columns)
    np.testing.assert_array_equal(table["wrist_y"], recovery.joints["wrist"][:, 1])


def test_public_names_are_there() -> None:
    assert set(smoother.__all__) <= set(dir(smoother))
    for name in smoother.__all__:
        assert getattr(smoother, name) is not None
