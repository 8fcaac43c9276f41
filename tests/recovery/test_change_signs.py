"""What changes while a recording runs: strap, camera, skeleton."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scenes import ALONE
from scipy.spatial.transform import Rotation

from smoother import Recording
from smoother.config import Anatomy
from smoother.evaluation.validate import sample_errors
from smoother.measurements.outliers import interpolated
from smoother.recording import JOINTS, JointState
from smoother.recovery.trust import with_verdict
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth


@cache
def made(seed: int = 1, preset: str = "realistic") -> SimulatedArm:
    return simulate_arm(ArmSimulation.preset(preset, protocol="random", duration_s=40.0), seed)


def slipped(arm: SimulatedArm, degrees: float) -> Recording:
    """The strap turns about the forearm half-way, between two samples."""
    imu, R_F_A = arm.recording.imu, arm.calibration.R_F_A
    turn = Rotation.from_rotvec(degrees * R_F_A[1], degrees=True).inv()
    late = (imu.t_s > np.mean(imu.t_s[[0, -1]]))[:, None]
    acc, gyro = (np.where(late, turn.apply(values), values) for values in (imu.acc, imu.gyro))
    return replace(arm.recording, imu=replace(imu, acc=acc, gyro=gyro), truth=None)


def pushed(arm: SimulatedArm, degrees: float) -> Recording:
    """The camera tilts half-way."""
    tracks = arm.recording.arm
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    late = (tracks.t_s > np.mean(tracks.t_s[[0, -1]]))[:, None, None]
    position = np.where(late, tracks.position @ turn.T, tracks.position)
    return replace(arm.recording, arm=replace(tracks, position=position), truth=None)


def filled(arm: SimulatedArm) -> Recording:
    """Straight lines through all gaps, called tracked."""
    tracks = arm.recording.arm
    position, state = tracks.position.copy(), tracks.state.copy()
    for joint in tracks.present:
        seen, column = tracks.tracked(joint), JOINTS.index(joint)
        for axis in range(3):
            position[:, column, axis] = np.interp(tracks.t_s, tracks.t_s[seen], position[seen, column, axis])
        state[:, column] = JointState.TRACKED
    return replace(arm.recording, arm=replace(tracks, position=position, state=state), truth=None)


def in_one_frame(recovery: Recovery) -> bool:
    """No reason says that positions before and after a moment are not."""
    return not any("not in one frame" in reason for reason in recovery.estimates.reasons)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "preset", "duration_s"),
    [
        (2, "realistic", 40.0),
        (4, "azure", 40.0),
        (8, "white", 40.0),
        # 47, 56 and 10 cm off in short recordings
        (14, "white", 12.0),
        (14, "azure", 12.0),
        (15, "white", 16.0),
        # an upright forearm, on which down hardly jumps
        (1489077380, "realistic", 25.1),
    ],
)
def test_a_strap_that_slips_is_not_trusted(seed: int, preset: str, duration_s: float):
    arm = simulate_arm(ArmSimulation.preset(preset, protocol="random", duration_s=duration_s), seed)
    sound = smooth(replace(arm.recording, truth=None), config=ALONE)
    assert sound.estimates.trusted and in_one_frame(sound)
    assert smooth(slipped(arm, 15.0), config=ALONE).estimates.trusted is False


@pytest.mark.slow
def test_a_slip_that_is_left_out_distrusts_its_gap():
    """Both sides of it were left out as blocks; what is trusted is right."""
    recovery, truth = smooth(slipped(made(), 15.0), config=ALONE), made().recording.truth
    assert recovery.estimates.trusted is False or not all(each.trusted for each in recovery.gap_verdicts)
    assert np.nanmax(sample_errors(recovery, truth).distance_m[recovery.trusted]) < 0.04


@pytest.mark.slow
def test_a_camera_that_is_pushed_is_not_trusted():
    assert solved().estimates.trusted and not solved().estimates.untrusted
    recovery = smooth(pushed(made(), 6.0), config=ALONE)
    assert recovery.estimates.trusted is False and not in_one_frame(recovery)


@pytest.mark.slow
def test_a_filled_skeleton_counts_as_not_seen():
    recovery = smooth(filled(made()), config=ALONE)
    assert any("a program filled gaps" in caution for caution in recovery.estimates.cautions)
    longest = max(gap.length_s for gap in recovery.gaps)
    assert longest == pytest.approx(max(gap.length_s for gap in solved().gaps), abs=0.2)


@pytest.mark.parametrize("kind", ["line", "cubic", "by frame"])
def test_fillings_are_found_and_what_is_seen_is_kept(kind: str):
    rng = np.random.default_rng(5)
    t = np.sort(np.arange(0.0, 20.0, 1 / 30) + rng.uniform(0, 0.004, 600))
    x = np.column_stack([0.3 * np.sin((1 + k) * t) for k in range(3)]) + 0.004 * rng.normal(size=(600, 3))
    clean, at = x.copy(), t if kind != "by frame" else np.arange(600.0)
    gap = slice(200, 230)
    ends = [198, 199, 230, 231] if kind == "cubic" else [199, 230]
    for axis in range(3):
        line = np.polyfit(at[ends] - at[215], clean[ends, axis], len(ends) - 1)
        x[gap, axis] = np.polyval(line, at[gap] - at[215])
    found = interpolated(t, x, np.ones(600, bool))
    assert found[gap].mean() > 0.9
    found[197:233] = False  # the samples that the cubic was drawn through lie on it too
    assert not found.any()
    assert not interpolated(t, clean, np.ones(600, bool)).any()


def test_no_sign_without_noise():
    """A curve without noise is a simulation or a reference, not a filled camera's."""
    t = np.arange(0.0, 10.0, 1 / 30)
    assert not interpolated(t, np.column_stack([t, t**2, 0 * t]), np.ones(len(t), bool)).any()


def judged_with(**changes: object) -> tuple[bool | None, str]:
    """The verdict on a sound recovery of an arm whose calibration or IMU is another."""
    recording = replace(made().recording, truth=None)
    recovery = solved()
    if "imu" in changes:
        recording = replace(recording, imu=changes["imu"])
    if "calibration" in changes:
        recovery = replace(recovery, calibration=changes["calibration"])
    estimates = with_verdict(recovery, recording, Anatomy.ADULT).estimates
    return estimates.trusted, estimates.verdict


@cache
def solved() -> Recovery:
    return smooth(replace(made().recording, truth=None), config=ALONE)


def test_a_hand_called_the_wrist_is_asked_for():
    arm = solved().calibration
    assert arm is not None and arm.upper_arm is not None
    hand = arm.lever_arms["hand"]
    without = {joint: lever for joint, lever in arm.lever_arms.items() if joint != "hand"}
    assert "hand labelled as the wrist" not in judged_with(calibration=replace(arm, lever_arms=without))[1]
    swapped = replace(arm, lever_arms=without | {"wrist": hand})
    assert "hand labelled as the wrist" in judged_with(calibration=swapped)[1]


@pytest.mark.parametrize(("limit", "trusted", "words"), [(13.0, True, "less certain"), (9.0, False, "wider")])
def test_a_range_that_is_too_small(limit: float, trusted: bool, words: str):
    imu = made().recording.imu
    acc = np.clip(imu.acc, -limit, limit)
    verdict = judged_with(imu=replace(imu, acc=acc))
    share = float((np.abs(acc) == limit).any(axis=1).mean())
    assert (share > 0.02) is not trusted and share > 0.001
    assert verdict[0] is trusted and words in verdict[1]


@pytest.mark.slow
def test_scale_errors_of_the_gyroscope_are_no_slip():
    config = ArmSimulation.preset("realistic", protocol="random", duration_s=30.0)
    arm = simulate_arm(config.model_copy(update={"imu_scale": 0.03}), 81)
    recovery = smooth(replace(arm.recording, truth=None), config=ALONE)
    assert in_one_frame(recovery)
