"""What a calibration from motion says of what it could not find, and the forearm's axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.forearm.forearm_frame import forearm_frame
from calib.motion.motion_calibration import names_given
from calib.motion.motion_summary import (
    ClockOffset,
    Evidence,
    beyond,
    clocks_not_determined,
    not_determined,
    roll_known,
)
from smoother.calibration import ArmCalibration, Length, LeverArm

FRAMES = dict.fromkeys(("shoulder", "elbow", "wrist", "hand", "strap", "upper_arm"), 500)
GOOD = Evidence(visible_s=25.0, frames=FRAMES, turning_rad_s=2.0, axial_rad=2.5)
NOTHING = ArmCalibration(side="right")


def an_arm(sigma_m: float = 0.003, distance_m: float = 0.035) -> ArmCalibration:
    """An IMU over the wrist; {A} has x away from the forearm, y along it."""
    levers = {
        "elbow": [-distance_m, -0.20, 0.0],
        "wrist": [-distance_m, 0.05, 0.0],
        "hand": [-0.03, 0.13, 0.0],
    }
    return ArmCalibration(
        "right",
        {joint: LeverArm(np.array(place), np.full(3, sigma_m)) for joint, place in levers.items()},
        Length(0.3, 0.003),
    )


def said(arm: ArmCalibration, evidence: Evidence = GOOD, known: ArmCalibration = NOTHING) -> str:
    return "\n".join(not_determined(arm, forearm_frame(arm), evidence, known))


def turned(arm: ArmCalibration, R: np.ndarray) -> ArmCalibration:
    levers = {joint: LeverArm(R @ each.position_m, each.sigma_m) for joint, each in arm.lever_arms.items()}
    return replace(arm, lever_arms=levers)


def test_nothing_is_said_of_a_good_calibration():
    assert said(an_arm()) == ""


@pytest.mark.parametrize("seed", range(5))
def test_axes_of_the_forearm(seed):
    R = Rotation.random(random_state=seed).as_matrix()
    frame = forearm_frame(turned(an_arm(), R))
    assert frame is not None and frame.R_F_A is not None
    np.testing.assert_allclose(frame.R_F_A, R.T, atol=1e-12)  # {A} was {F} before it was turned
    assert np.linalg.det(frame.R_F_A) == pytest.approx(1.0)
    assert frame.distance_m == pytest.approx(0.035)
    assert frame.length_m == pytest.approx(0.25)
    # 3 mm on 35 mm
    assert np.degrees(frame.roll_sigma_rad) == pytest.approx(np.degrees(3 / 35), rel=1e-6)
    assert frame.distance_sigma_m == pytest.approx(0.003, rel=1e-6)
    assert frame.length_sigma_m == pytest.approx(0.003 * np.sqrt(2), rel=1e-6)


def test_axes_need_elbow_and_wrist():
    arm = an_arm()
    only = replace(arm, lever_arms={"wrist": arm.lever_arms["wrist"]})
    assert forearm_frame(only) is None
    evidence = replace(GOOD, frames=FRAMES | {"elbow": 0, "hand": 4, "upper_arm": 0})
    text = said(replace(only, upper_arm=None), evidence)
    assert "the elbow was never tracked: its lever arm is open" in text
    assert "the hand was tracked in 4 frames only" in text
    assert "R_F_A) need both elbow and wrist" in text
    assert "never seen together: the upper arm's length is not known" in text


def test_roll_that_nothing_turned_about():
    arm = an_arm(sigma_m=0.012)
    frame = forearm_frame(arm)
    assert frame is not None and frame.R_F_A is None
    text = said(arm, replace(GOOD, axial_rad=np.radians(20)))
    assert (
        "the forearm hardly turned about its own axis (20 degrees): roll is known to 20 degrees only" in text
    )
    assert "hardly turned" not in said(arm)  # it turned; the cause is another one
    assert "roll is known to 20 degrees only" in said(arm)
    assert "the wrist is known only roughly in the IMU's axes: x to 12 mm, y to 12 mm, z to 12 mm" in text
    assert "R_F_A is left open" in text


def test_how_the_axes_are_known():
    text = roll_known(forearm_frame(an_arm()))
    assert text.startswith("R_F_A: direction to 1.0 degrees, roll to 5 degrees")
    assert "35 +- 3 mm from its axis" in text


def test_roll_that_is_not_known_at_all():
    arm = an_arm(sigma_m=0.03)
    frame = forearm_frame(arm)
    assert frame is not None and frame.R_F_A is None
    assert roll_known(frame) == roll_known(None) == ""
    assert "R_F_A is left open" in said(arm)


def test_an_imu_in_the_line():
    arm = an_arm(distance_m=0.006)
    frame = forearm_frame(arm)
    assert frame is not None and frame.R_F_A is None
    assert "found 6 mm from the line between elbow and wrist" in said(arm)


def test_one_axis_alone_is_named():
    arm = an_arm()
    arm.lever_arms["elbow"].sigma_m[2] = 0.02
    text = said(arm)
    assert "the elbow is known only roughly in the IMU's axes: z to 20 mm" in text
    assert "wrist" not in text.split("\n")[0]


def test_what_is_given_is_not_called_open():
    arm = an_arm(sigma_m=0.03)
    known = replace(arm, R_F_A=np.eye(3))
    evidence = replace(GOOD, frames=FRAMES | {"upper_arm": 0})
    assert said(arm, evidence, known) == ""


def test_little_to_see_and_little_motion():
    text = said(an_arm(), replace(GOOD, visible_s=4.0, turning_rad_s=0.05))
    assert "the forearm was visible for 4 s only" in text
    assert "the forearm hardly moved while it was visible (3 degrees/s on average)" in text


def test_upper_arm():
    arm = an_arm()
    assert "together in 5 frames only" in said(arm, replace(GOOD, frames=FRAMES | {"upper_arm": 5}))
    assert "length is known to 40 mm only" in said(replace(arm, upper_arm=Length(0.3, 0.04)))


def test_clocks():
    offsets = [ClockOffset("a", 0.02, 0.001, 0.0), ClockOffset("b", 0.02, 0.04, 0.0), ClockOffset("c")]
    assert clocks_not_determined(offsets) == [
        "b: the clock offset is known to 40 ms only; the arm moved too little or too slowly",
        "c: IMU and visible forearm never came together; it told nothing",
    ]


def test_errors_of_the_camera_are_no_fault_of_the_motion():
    arm = an_arm(sigma_m=0.012)
    said_then = not_determined(arm, forearm_frame(arm), GOOD, NOTHING, joint_bias_m=0.0119)
    assert said_then[0] == (
        "the camera places joints some 12 mm off (an axis), always in the same way: "
        "lever arms and lengths are known no better, whatever the motion"
    )
    text = "\n".join(said_then)
    assert "known only roughly" not in text
    assert "with the camera's constant errors roll is known to 20 degrees only" in text
    # where the motion leaves more open than the camera does, that is said too
    rough = an_arm(sigma_m=0.0134)
    text = "\n".join(not_determined(rough, forearm_frame(rough), GOOD, NOTHING, joint_bias_m=0.006))
    assert "x to 13 mm" in text and "roll is known to" in text and "with the camera's" not in text
    assert not_determined(an_arm(), forearm_frame(an_arm()), GOOD, NOTHING, float("nan")) == []
    assert beyond(np.array([0.005, 0.003]), 0.004) == pytest.approx([0.003, 0.0])


def test_a_tracked_sensor_is_no_arm():
    point = Evidence(20.0, {"strap": 500, "elbow": 0, "upper_arm": 0}, 2.0, float("nan"))
    assert said(NOTHING, point) == ""
    still = replace(point, turning_rad_s=0.01)
    assert said(NOTHING, still) == "the sensor hardly moved while it was visible (1 degrees/s on average)"


def test_what_was_given_by_name():
    assert names_given(None) == names_given(NOTHING) == ()
    known = replace(an_arm(), R_F_A=np.eye(3))
    assert names_given(known) == ("elbow", "wrist", "hand", "upper_arm", "R_F_A")
