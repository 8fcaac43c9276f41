"""The likeliest cause: of each mistake its own, of a sound recording none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import answer, moving

from smoother.calibration import ArmCalibration, LeverArm
from smoother.errors import CalibrationError, SolveError
from smoother.measurements.clock import constant_clock
from smoother.measurements.remedy import Remedy
from smoother.recording import Recording
from smoother.recovery.cause import diagnose_failures, likeliest_cause, on_upper_arm
from smoother.recovery.trust import sensor_at_elbow, swapped_joints
from smoother.selfcal.pairing import pair
from smoother.simulation import ArmSimulation, simulate_both_arms
from tools.reliability import setup_errors
from tools.reliability.setup_errors import Job, Setup


@pytest.mark.slow
def test_a_recording_without_any_answer_is_refused_with_its_cause() -> None:
    setup = Job(setup_errors.metres_called_millimetres, 1262876031, "white", 29.4).setup()
    with pytest.raises(SolveError, match=r"in no part of the recording.*1000 times too small"):
        answer(setup.recording, setup.calibration)


@pytest.fixture(scope="module")
def sound() -> Recording:
    return replace(moving(3, duration_s=24.0).recording, truth=None)


def test_names_of_joints_are_doubted_by_shoulder_and_hand(sound: Recording) -> None:
    """Swapped ones show where a shoulder or a hand is seen, and nothing is said where neither is."""
    swap = Remedy(swap=("elbow", "wrist"))
    every = np.ones(len(sound.arm), bool)
    for hidden, is_said in (((), True), (("shoulder",), True), (("shoulder", "hand"), False)):
        seen = replace(sound, arm=sound.arm.hide(every, hidden)) if hidden else sound
        assert not list(swapped_joints(seen.arm))
        said = list(swapped_joints(swap.applied(seen).arm))
        assert bool(said) == is_said
        if hidden == ("shoulder",):
            assert "the hand is nearer to the elbow than to the wrist" in said[0].sentence


@pytest.mark.parametrize(
    "needless",
    [Remedy(mirror="x"), Remedy(negate=("accelerometer",)), Remedy(swap=("elbow", "wrist"))],
    ids=lambda remedy: remedy.options,
)
def test_an_option_that_is_not_needed_is_to_be_left_out(sound: Recording, needless: Remedy) -> None:
    synchronised, *_ = pair(sound)
    cause = likeliest_cause(needless.applied(synchronised))
    assert cause is not None and cause.remedies == ()
    assert cause.sentence.startswith(f"with {needless.options} ")
    assert cause.sentence.endswith(f"run again without {needless.options}")
    # undone twice it is as it was
    corrected = needless.applied(needless.applied(synchronised))
    assert likeliest_cause(corrected) is None


@pytest.mark.slow
def test_two_options_that_cancel_each_other_are_not_trusted(sound: Recording) -> None:
    """They make a sound motion its mirror image, half a metre off, and camera and IMU agree on it."""
    both = Remedy(mirror="x", negate=("accelerometer",))
    (reason,) = (found := answer(both.applied(sound)).estimates).reasons
    assert found.trusted is False and "--mirror x and --negate accelerometer" in reason
    truly = both.applied(both.applied(sound))  # it was sound, and is again; but that only we know
    assert answer(replace(truly, applied_fixes=())).estimates.trusted


def test_a_hand_between_elbow_and_wrist_tells_swapped_names(sound: Recording) -> None:
    needless = Remedy(swap=("wrist", "hand"))
    synchronised, *_ = pair(sound)
    cause = likeliest_cause(replace(needless.applied(synchronised), applied_fixes=()))
    assert cause is not None and [remedy.options for remedy in cause.remedies] == ["--swap wrist,hand"]
    assert cause.sentence.startswith("wrist and hand seem swapped")
    found = answer(needless.applied(sound)).estimates
    assert found.trusted is False and found.reasons[0].endswith("run again without --swap wrist,hand")


def test_a_refusal_names_its_cause(sound: Recording, exchanged: Recording) -> None:
    negated = replace(sound, imu=replace(sound.imu, gyro=-sound.imu.gyro))
    for recording, error, named in (
        (negated, SolveError, r"^nothing is left; the gyroscope's sign .* --negate gyroscope"),
        (exchanged, CalibrationError, r"^nothing is left; left and right .* --swap left,right$"),
        (sound, SolveError, r"^nothing is left\.?$"),
    ):
        with pytest.raises(error, match=named), diagnose_failures(recording, ArmCalibration()):
            raise error("nothing is left.")


@pytest.mark.slow
def test_a_clock_of_another_session(sound: Recording) -> None:
    offset_s = moving(3, duration_s=24.0).parameters["clock_offset_s"]
    right = answer(sound, clock=constant_clock(offset_s, 0.002)).estimates
    assert right.trusted and right.cause is None
    for wrong_s, word in ((0.1, "moves the clock that was given"), (3.0, "the clock that was given")):
        wrong = answer(sound, clock=constant_clock(offset_s + wrong_s, 0.002)).estimates
        assert wrong.trusted is False
        assert any(word in reason for reason in wrong.reasons), wrong.reasons


@pytest.fixture(scope="module")
def exchanged() -> Recording:
    """The left arm's joints under the right one's names, and the other way round; the IMU is on the right."""
    config = ArmSimulation.preset("realistic", protocol="random", duration_s=24.0)
    right, left = (arm.recording for arm in simulate_both_arms(config, 3))
    return replace(right, arm=left.arm, opposite=right.arm, truth=None)


def test_exchanged_sides_are_named_and_mended(exchanged: Recording) -> None:
    cause = likeliest_cause(exchanged)
    assert cause is not None and [remedy.options for remedy in cause.remedies] == ["--swap left,right"]
    assert cause.sentence.startswith("left and right of the skeleton seem exchanged")
    corrected = Remedy(sides=True).applied(exchanged)
    assert exchanged.opposite is not None and corrected.arm is exchanged.opposite
    assert corrected.applied_fixes == ("--swap left,right",)
    assert likeliest_cause(pair(corrected)[0]) is None
    # an arm alone: the files are doubted
    alone = likeliest_cause(replace(exchanged, opposite=None))
    assert alone is not None and alone.remedies == () and "--side" in alone.sentence


def test_a_sensor_at_the_joint_called_elbow_tells_swapped_joints(sound: Recording) -> None:
    every = np.ones(len(sound.arm), bool)
    far, near = (LeverArm(np.array([0.0, y, 0.03]), np.full(3, 0.01)) for y in (-0.2, 0.05))
    right = ArmCalibration("right", {"elbow": far, "wrist": near})
    wrong = ArmCalibration("right", {"elbow": near, "wrist": far})
    bare = sound.arm.hide(every, ("shoulder", "hand"))
    assert not list(sensor_at_elbow(bare, right)) and not list(sensor_at_elbow(bare, None))
    (swapped,) = sensor_at_elbow(bare, wrong)
    assert swapped.joints == ("elbow", "wrist")
    # a band below the elbow: the bones, or the hand, show that the names are right
    assert not list(sensor_at_elbow(sound.arm.hide(every, ("hand",)), wrong))
    assert not list(sensor_at_elbow(sound.arm.hide(every, ("shoulder",)), wrong))
    # hardly known
    unsure = {joint: replace(lever, sigma_m=np.full(3, 0.05)) for joint, lever in wrong.lever_arms.items()}
    assert not list(sensor_at_elbow(bare, replace(wrong, lever_arms=unsure)))


@pytest.mark.slow
def test_elbow_and_wrist_exchanged_without_a_shoulder(sound: Recording) -> None:
    bare = replace(sound, arm=sound.arm.hide(np.ones(len(sound.arm), bool), ("shoulder", "hand")))
    swap = Remedy(swap=("elbow", "wrist"))
    swapped = answer(replace(swap.applied(bare), applied_fixes=())).estimates
    assert swapped.trusted is False and swapped.remedies == ("--swap elbow,wrist",)
    assert answer(bare).estimates.trusted


@pytest.mark.slow
@pytest.mark.parametrize("flexion_rad", [(0.5, 2.0), (0.5, 0.9)], ids=["lively elbow", "stiff elbow"])
def test_an_imu_on_the_upper_arm_is_found_though_it_fits_the_forearm(
    flexion_rad: tuple[float, float],
) -> None:
    made = moving(7, flexion_rad=flexion_rad)
    config = ArmSimulation.preset("realistic", protocol="random", duration_s=30.0, flexion_rad=flexion_rad)
    recording = replace(made.recording, truth=None)
    assert on_upper_arm(recording) is None
    wrong = setup_errors.sensor_on_the_upper_arm(Setup(made, config, np.random.default_rng(7), recording))
    estimates = answer(wrong.recording).estimates
    assert estimates.trusted is False
    assert estimates.cause is not None and "on the upper arm" in estimates.cause
