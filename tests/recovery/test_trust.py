"""The verdict and the hidden test stretches that it rests on."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from made_results import recovery as made
from scenes import ALONE, there

from smoother import Recording
from smoother.calibration import SigmaFactor, SigmaFactors
from smoother.config import Config
from smoother.errors import UnoccludeError
from smoother.io import import_utd_mhad
from smoother.recording import CameraFrame
from smoother.recovery.self_check import RAMP_S, HiddenStretch, summary, with_sigma_factors
from smoother.recovery.trust import _gravity, with_verdict
from smoother.result import Draws, Estimates, Recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth


@cache
def sound(seed: int, duration_s: float = 20.0) -> Recording:
    """An arm with realistic errors."""
    settings = ArmSimulation.preset("realistic", protocol="random", duration_s=duration_s)
    return replace(simulate_arm(settings, seed).recording, truth=None)


@cache
def recovered(seed: int) -> Recovery:
    """What `smooth` makes of it with nothing calibrated."""
    return smooth(sound(seed), None, ALONE)


def mirrored(recording: Recording) -> Recording:
    return replace(
        recording, arm=replace(recording.arm, position=recording.arm.position * np.array([-1.0, 1.0, 1.0]))
    )


def another_skeleton(recording: Recording) -> Recording:
    other = sound(77).arm
    count = min(len(other), len(recording.arm))
    arm = recording.arm.select(slice(0, count))
    return replace(recording, arm=replace(arm, position=other.position[:count], state=other.state[:count]))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3, 5])
def test_a_sound_recording_is_usable(seed: int) -> None:
    estimates = recovered(seed).estimates
    assert estimates.trusted is True and estimates.reasons == ()
    assert estimates.verdict == "Usable."


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "word", "seed"),
    # tests/cli/test_setup_table.py smooths every mistake by the real command, which names its cause
    [(mirrored, "gravity", 3), (another_skeleton, "deviates by", 0)],
)
def test_a_wrong_set_up_is_not_to_be_trusted(
    wrong: Callable[[Recording], Recording], word: str, seed: int
) -> None:
    try:
        estimates = smooth(wrong(sound(seed)), None, ALONE).estimates
    except UnoccludeError as refused:  # clocks that nothing brings together
        assert wrong is another_skeleton and "apart" in str(refused)
        return
    assert estimates.trusted is False
    assert any(word in reason for reason in estimates.reasons), estimates.reasons
    assert estimates.verdict.startswith("Not to be trusted: ")


@pytest.mark.slow
def test_whose_arm_it_is_decides_what_is_possible() -> None:
    small = sound(0, 30.0)  # what is possible is judged where the lengths are known well
    small = replace(small, arm=replace(small.arm, position=small.arm.position * 0.45))
    recovery = smooth(small, None, ALONE)
    for anatomy, trusted in (("adult", False), ("child", True), ("any", True)):
        config = Config.model_validate({"arm": {"anatomy": anatomy}})
        again = with_verdict(recovery, small, config.arm.anatomy).estimates
        lengths = [each for each in again.reasons if "possible" in each and "axis" not in each]
        assert (anatomy, bool(lengths)) == (anatomy, not trusted)


def test_a_slow_sensor_and_a_clipped_one() -> None:
    recording, recovery = sound(0), recovered(0)
    anatomy = ALONE.arm.anatomy
    slow = replace(recording, imu=recording.imu.select(np.arange(len(recording.imu)) % 8 == 0))
    assert with_verdict(recovery, slow, anatomy).estimates.reasons == (
        "the IMU has 10 samples per second, where 40 are needed and 80 are better",
    )
    half = replace(recording, imu=recording.imu.select(np.arange(len(recording.imu)) % 3 == 0))
    assert "Usable with care: the IMU has 27" in with_verdict(recovery, half, anatomy).estimates.verdict

    def clipped(limit: float) -> Estimates:
        acc = np.clip(recording.imu.acc, -limit, limit)
        return with_verdict(
            recovery, replace(recording, imu=replace(recording.imu, acc=acc)), anatomy
        ).estimates

    much = clipped(10.0)
    assert much.trusted is False
    assert any("clipped at about 10 m/s^2 in 14 % of its samples" in reason for reason in much.reasons)
    touched = clipped(float(np.sort(np.abs(recording.imu.acc).ravel())[-20]))  # the ends of a few samples
    assert touched.trusted is True
    assert any("the accelerometer was clipped" in caution for caution in touched.cautions)


def test_one_wild_sample_of_the_gyroscope_is_replaced_and_said() -> None:
    recording = sound(0)
    gyro = recording.imu.gyro.copy()
    gyro[len(gyro) // 2] = [34.0, -34.0, 34.0]
    wild = smooth(replace(recording, imu=replace(recording.imu, gyro=gyro)), None, ALONE)
    away = np.linalg.norm(wild.position - recovered(0).position, axis=1)
    assert np.nanmax(away) < 0.003  # one sample of 100 a second is missing
    assert wild.estimates.cautions == ("1 sample of the gyroscope jumped away and back and was replaced",)


def test_a_sensor_that_sends_zeros_is_said() -> None:
    recording = sound(0)
    acc = recording.imu.acc.copy()
    acc[800:880] = 0.0
    silent = replace(recording, imu=replace(recording.imu, acc=acc))
    estimates = with_verdict(recovered(0), silent, ALONE.arm.anatomy).estimates
    assert estimates.trusted is False
    assert "the IMU sends zeros (80 samples" in estimates.reasons[0]


def test_nobody_judged() -> None:
    assert Estimates().verdict == "" and Estimates().trusted is None


@pytest.mark.slow
@pytest.mark.real
def test_real_recordings_are_usable() -> None:
    """Kinect v1 with synthetic stamps: noisier than any simulation."""
    for action, subject in ((2, 1), (3, 3), (7, 1), (8, 3), (10, 1)):
        name = f"a{action}_s{subject}_t1"
        inertial = there("utd_mhad", "Inertial", f"{name}_inertial.mat")
        recording = import_utd_mhad(inertial, there("utd_mhad", "Skeleton", f"{name}_skeleton.mat"))
        assert smooth(recording, None, ALONE).estimates.trusted, name


def sentences(gravity: np.ndarray, frame: CameraFrame | None, hint: np.ndarray | None = None) -> list[str]:
    recovery = SimpleNamespace(gravity_direction=gravity)
    recording = SimpleNamespace(camera_frame=frame, gravity_hint=hint)
    return list(_gravity(recovery, recording))  # type: ignore[arg-type]


@pytest.mark.parametrize("right", CameraFrame)
@pytest.mark.parametrize("stated", CameraFrame)
def test_every_frame_taken_for_every_other(right: CameraFrame, stated: CameraFrame):
    tilted = right.down + 0.3 * np.array([0.5, 0.4, 0.6])  # a camera that looks down a little
    said = sentences(tilted / np.linalg.norm(tilted), stated)
    if right is stated:
        assert said == []
    else:
        assert len(said) == 1 and said[0].endswith(f"gravity fits the frame {right} instead of {stated}")


def test_axes_of_no_frame_and_a_given_direction():
    assert sentences(np.array([1.0, 0.0, 0.0]), CameraFrame.KINECT)[0].endswith(
        "down is about x of the positions"
    )
    up = np.array([0.0, -1.0, 0.0])
    (said,) = sentences(up, None, np.array([0.0, 1.0, 0.0]))
    assert said.endswith("down is about -y of the positions")
    assert sentences(np.full(3, np.nan), CameraFrame.KINECT) == [] == sentences(up, None)


def stretch(nees: float, rms_m: float = 0.02, samples: int = 30) -> HiddenStretch:
    stated_m = rms_m / max(np.sqrt(nees), 1e-3)
    errors = (rms_m,) * samples
    return HiddenStretch(0.0, 1.0, samples, rms_m, stated_m, samples, nees, errors, 1.6 * stated_m)


def test_failed_stretches_are_counted_and_the_worst_is_kept() -> None:
    check = summary([stretch(1.0), stretch(0.8), HiddenStretch(3.0, 4.0), stretch(30.0, 0.2)])
    assert (check.stretches, check.unanswered, check.failed) == (4, 1, 2)
    assert check.worst_nees == 30.0
    assert check.sigma_factor == 1.0  # four say nothing of sigma


def test_an_over_confident_sigma_is_widened_by_what_is_no_chance() -> None:
    rng = np.random.default_rng(3)
    sound = [stretch(float(value)) for value in rng.chisquare(3, 12) / 3.0]
    assert summary(sound).sigma_factor == pytest.approx(1.0, abs=0.15)
    bold = [stretch(4.0 * float(value)) for value in rng.chisquare(3, 12) / 3.0]
    assert 1.3 < summary(bold).sigma_factor < 2.0


def test_the_95th_percentile_is_over_all_samples_and_so_is_what_was_stated_of_it() -> None:
    check = summary([stretch(1.0, 0.01, 60), stretch(1.0, 0.03, 30), HiddenStretch(3.0, 4.0)])
    assert check.error_95_m == pytest.approx(0.03)
    assert check.stated_95_m == pytest.approx(1.6 * np.sqrt((60 * 0.01**2 + 30 * 0.03**2) / 90))
    assert summary([stretch(1.0, 0.01, 97), stretch(1.0, 0.5, 3)]).error_95_m == pytest.approx(0.01)


def test_no_stretch_says_why() -> None:
    assert summary([]).note
    assert summary([]).stretches == 0


def test_a_large_error_within_its_sigma_is_no_contradiction() -> None:
    assert not stretch(1.0, 0.2).failed
    assert not stretch(20.0, 0.03).contradicted  # three centimetres: sigma is too small, nothing is wrong
    assert stretch(20.0, 0.2).contradicted


@pytest.fixture(scope="module")
def recovery() -> Recovery:
    made = simulate_arm(ArmSimulation.preset("realistic", protocol="random", duration_s=30.0), 5)
    return smooth(replace(made.recording, truth=None), config=ALONE)


def test_a_simulated_arm_proves_itself(recovery: Recovery) -> None:
    """Other seeds: 5 or 6 stretches, rms 1.6 to 2.4 cm with the camera's noise, NEES 0.4 to 1.4."""
    check = recovery.estimates.self_check
    assert check is not None
    assert 3 <= check.stretches <= 6
    assert check.failed == 0
    assert check.rms_m < 0.035
    assert 0.85 <= check.inside_95 <= 1.0
    assert 0.2 < check.worst_nees < 3.0
    assert 0.4 <= check.length_s <= 4.0
    json.dumps(recovery.estimates.plain())


def test_the_self_check_is_the_same_on_two_processes(recovery: Recovery) -> None:
    made = simulate_arm(ArmSimulation.preset("realistic", protocol="random", duration_s=30.0), 5)
    again = smooth(replace(made.recording, truth=None), processes=2)
    assert again.estimates.self_check == recovery.estimates.self_check


def test_no_answer_depends_on_what_is_hidden_as_a_test(recovery: Recovery) -> None:
    """The stretches are in visible time: no gap of the result is one of them."""
    made = simulate_arm(ArmSimulation.preset("realistic", protocol="random", duration_s=30.0), 5)
    tracked = made.recording.arm.forearm_tracked
    hidden_s = float((~tracked).sum()) / 30.0
    assert sum(gap.length_s for gap in recovery.gaps) < hidden_s + 0.15 * len(recovery.gaps) + 0.5


FACTORS = SigmaFactors((SigmaFactor(0.1, 1.5, 24), SigmaFactor(4.0, 2.5, 31)))


def test_positions_in_gaps_grow_and_the_rest_stays():
    before, after = made(), with_sigma_factors(made(), FACTORS)
    assert before.gaps and before.occluded.any()
    grown = np.sqrt(
        np.einsum("nii->ni", after.pose_covariance) / np.einsum("nii->ni", before.pose_covariance)
    )
    known, inside = np.isfinite(before.pose_covariance).all(axis=(1, 2)), np.zeros(len(before), bool)
    for gap in before.gaps:
        rows = (before.t_s >= gap.start_s) & (before.t_s <= gap.end_s) & before.occluded & known
        np.testing.assert_allclose(grown[rows, :3], FACTORS.at(gap.length_s), rtol=1e-4)
        inside |= rows
    np.testing.assert_allclose(grown[~inside & known], 1.0)
    np.testing.assert_allclose(grown[known, 3:], 1.0)
    for joint, covariance in after.joint_covariance.items():
        ratio = np.sqrt(covariance[inside, 0, 0] / before.joint_covariance[joint][inside, 0, 0])
        finite = ratio[np.isfinite(ratio)]
        assert (finite == 1.0).all() if joint == "shoulder" else (finite > 1.4).all()
    answered = np.isfinite(after.pose_covariance).all(axis=(1, 2))
    assert (np.linalg.eigvalsh(after.pose_covariance[answered]) > 0).all()


def test_drawn_motions_grow_as_much_and_do_not_jump():
    recovery = made()
    t = recovery.t_s[::4].copy()
    ones = np.ones((2, len(t), 3), np.float32)
    joints = {"elbow": ones.copy(), "shoulder": ones.copy()}
    drawn = replace(recovery, draws=Draws(t, 0, ones.copy(), ones.copy(), joints))
    draws = with_sigma_factors(drawn, FACTORS).draws
    assert draws is not None
    for gap in recovery.gaps:
        inside = (t >= gap.start_s) & (t <= gap.end_s)
        np.testing.assert_allclose(draws.position[:, inside], FACTORS.at(gap.length_s), rtol=1e-4)
    away = np.min([np.maximum(gap.start_s - t, t - gap.end_s) for gap in recovery.gaps], axis=0)
    np.testing.assert_array_equal(draws.position[:, away > RAMP_S], 1.0)
    assert np.abs(np.diff(draws.position, axis=1)).max() < 0.3  # of a factor of 2, over 0.3 s
    np.testing.assert_array_equal(draws.joints["elbow"], draws.position)
    assert (draws.joints["shoulder"] == 1.0).all() and (draws.rotation == 1.0).all()


def test_it_is_said():
    after = with_sigma_factors(made(), FACTORS)
    assert len(after.estimates.sigma_factors) == len(after.gaps)
    assert "sigma of positions in gaps was multiplied by" in after.notes[-1]
    assert "24 or more" in after.notes[-1]
    short = SigmaFactors((SigmaFactor(0.01, 1.2, 24),))
    assert "was hidden" in with_sigma_factors(made(), short).notes[-1]


def test_nothing_is_done_without_factors():
    recovery = made()
    assert with_sigma_factors(recovery, None) is recovery


@pytest.mark.parametrize(("length_s", "factor"), [(0.05, 1.5), (2.05, 2.0), (9.0, 2.5)])
def test_between_the_lengths_and_beyond(length_s: float, factor: float):
    assert FACTORS.at(length_s) == pytest.approx(factor)
