"""The verdict, the hidden test stretches that it rests on, and sigmas of gaps that were measured."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_results import recovery as made
from scenes import ALONE, answer, moving, solved, there

from smoother import Recording
from smoother.array_types import FloatArray
from smoother.calibration import SigmaFactor, SigmaFactors
from smoother.config import Anatomy
from smoother.io import import_utd_mhad
from smoother.recording import CameraFrame, ImuStream
from smoother.recovery.self_check import RAMP_S, summary, with_sigma_factors
from smoother.recovery.trust import _gravity, with_verdict
from smoother.result import Draws
from smoother.smoothing import smooth
from smoother.window.solution import HiddenStretch


@pytest.fixture
def sound() -> Recording:
    """An arm with realistic errors; `solved(0, duration_s=20.0)` is its answer."""
    return replace(moving(0, duration_s=20.0).recording, truth=None)


@pytest.mark.slow
def test_whose_arm_it_is_decides_what_is_possible() -> None:
    small = moving(0).recording
    small = replace(small, arm=replace(small.arm, position=small.arm.position * 0.45), truth=None)
    recovery = answer(small)
    for anatomy, trusted in ((Anatomy.ADULT, False), (Anatomy.CHILD, True), (Anatomy.ANY, True)):
        reasons = with_verdict(recovery, small, anatomy).estimates.reasons
        lengths = [each for each in reasons if "possible" in each and "axis" not in each]
        assert (anatomy, bool(lengths)) == (anatomy, not trusted)


def clipped(imu: ImuStream, limit: float) -> ImuStream:
    return replace(imu, acc=np.clip(imu.acc, -limit, limit))


def zeros(imu: ImuStream) -> ImuStream:
    acc = imu.acc.copy()
    acc[800:880] = 0.0
    return replace(imu, acc=acc)


@pytest.mark.parametrize(
    ("change", "trusted", "words"),
    [
        (lambda imu: imu.select(slice(None, None, 8)), False, "has 10 samples per second, where 40 are"),
        (lambda imu: imu.select(slice(None, None, 3)), True, "the IMU has 27"),
        (lambda imu: clipped(imu, 10.0), False, "clipped at about 10 m/s^2 in 14 % of its samples"),
        # the ends of a few samples
        (lambda imu: clipped(imu, np.sort(np.abs(imu.acc).ravel())[-20]), True, "was clipped"),
        (zeros, False, "the IMU sends zeros (80 samples"),
    ],
    ids=["slow", "half as fast", "clipped", "hardly clipped", "zeros"],
)
def test_faults_of_the_sensor(
    change: Callable[[ImuStream], ImuStream], trusted: bool, words: str, sound: Recording
) -> None:
    changed = replace(sound, imu=change(sound.imu))
    found = with_verdict(solved(0, duration_s=20.0), changed, ALONE.arm.anatomy).estimates
    assert found.trusted is trusted
    assert any(words in each for each in (found.cautions if trusted else found.reasons))
    assert words in found.verdict or "clip" in words


@pytest.mark.parametrize(("sigma_m", "open_gaps"), [(0.1, []), (0.4, [1])])
def test_a_gap_with_an_answer_that_is_none_is_not_trusted(
    sigma_m: float, open_gaps: list[int], sound: Recording
) -> None:
    recovery = solved(0, duration_s=20.0)
    pose = recovery.pose_covariance.copy()
    gap = recovery.gaps[1]
    pose[(recovery.t_s > gap.start_s) & (recovery.t_s < gap.end_s), :3, :3] = sigma_m**2 * np.eye(3)
    found = with_verdict(replace(recovery, pose_covariance=pose), sound, ALONE.arm.anatomy)
    assert [number for number, each in enumerate(found.gap_verdicts) if not each.trusted] == open_gaps
    assert any("nothing shows where the arm was" in each.sentence for each in found.estimates.findings) is (
        sigma_m > 0.2
    )


def test_a_hand_called_the_wrist_is_asked_for(sound: Recording) -> None:
    recovery = solved(0, duration_s=20.0)
    levers = {joint: lever for joint, lever in recovery.calibration.lever_arms.items() if joint != "hand"}
    for wrist, is_asked in (("wrist", False), ("hand", True)):
        levers["wrist"] = recovery.calibration.lever_arms[wrist]
        judged = replace(recovery, calibration=replace(recovery.calibration, lever_arms=dict(levers)))
        verdict = with_verdict(judged, sound, ALONE.arm.anatomy).estimates.verdict
        assert ("hand labelled as the wrist" in verdict) is is_asked


def test_one_wild_sample_of_the_gyroscope_is_replaced_and_said(sound: Recording) -> None:
    gyro = sound.imu.gyro.copy()
    gyro[len(gyro) // 2] = [34.0, -34.0, 34.0]
    wild = answer(replace(sound, imu=replace(sound.imu, gyro=gyro)))
    away = np.linalg.norm(wild.position - solved(0, duration_s=20.0).position, axis=1)
    assert np.nanmax(away) < 0.003  # one sample of 100 a second is missing
    assert wild.estimates.cautions == ("1 sample of the gyroscope jumped away and back and was replaced",)


@pytest.mark.slow
@pytest.mark.real
def test_real_recordings_are_usable() -> None:
    """Kinect v1 with synthetic stamps: noisier than any simulation."""
    for action, subject in ((2, 1), (3, 3), (7, 1), (8, 3), (10, 1)):
        name = f"a{action}_s{subject}_t1"
        inertial = there("utd_mhad", "Inertial", f"{name}_inertial.mat")
        recording = import_utd_mhad(inertial, there("utd_mhad", "Skeleton", f"{name}_skeleton.mat"))
        assert answer(recording).estimates.trusted, name


def sentences(gravity: FloatArray, frame: CameraFrame | None, hint: FloatArray | None = None) -> list[str]:
    recovery = SimpleNamespace(gravity_direction=gravity)
    recording = SimpleNamespace(camera_frame=frame, gravity_hint=hint)
    return list(_gravity(recovery, recording))  # type: ignore[arg-type]


def test_every_frame_taken_for_every_other_and_axes_of_none() -> None:
    for right in CameraFrame:
        tilted = right.down + 0.3 * np.array([0.5, 0.4, 0.6])  # a camera that looks down a little
        for stated in CameraFrame:
            said = sentences(tilted / np.linalg.norm(tilted), stated)
            assert len(said) == (right is not stated)
            assert all(each.endswith(f"gravity fits the frame {right} instead of {stated}") for each in said)
    up = np.array([0.0, -1.0, 0.0])
    (said,) = sentences(np.eye(3)[0], CameraFrame.KINECT)
    assert said.endswith("down is about x of the positions")
    (said,) = sentences(up, None, -up)
    assert said.endswith("down is about -y of the positions")
    assert sentences(np.full(3, np.nan), CameraFrame.KINECT) == [] == sentences(up, None)


def stretch(nees: float, rms_m: float = 0.02, samples: int = 30) -> HiddenStretch:
    stated_m = rms_m / np.sqrt(nees)
    errors = (rms_m,) * samples
    return HiddenStretch(0.0, 1.0, samples, rms_m, stated_m, samples, nees, errors, 1.6 * stated_m)


def test_what_hidden_stretches_show_together() -> None:
    check = summary([stretch(1.0), stretch(0.8), HiddenStretch(3.0, 4.0), stretch(30.0, 0.2)])
    assert (check.stretches, check.unanswered, check.failed) == (4, 1, 2)
    assert check.worst_nees == 30.0 and check.sigma_factor == 1.0  # four say nothing of sigma
    assert summary([]).stretches == 0 and summary([]).note
    # a large error within its sigma is no contradiction; three centimetres show that sigma is too small
    assert not stretch(1.0, 0.2).failed
    assert not stretch(20.0, 0.03).contradicted and stretch(20.0, 0.2).contradicted
    # sigma is widened by what is no chance
    values = np.random.default_rng(3).chisquare(3, 24) / 3.0
    assert summary([stretch(value) for value in values[:12]]).sigma_factor == pytest.approx(1.0, abs=0.15)
    assert 1.3 < summary([stretch(4.0 * value) for value in values[12:]]).sigma_factor < 2.0
    # the 95th percentile is over all samples, and so is what was stated of it
    check = summary([stretch(1.0, 0.01, 60), stretch(1.0, 0.03, 30), HiddenStretch(3.0, 4.0)])
    assert check.error_95_m == pytest.approx(0.03)
    assert check.stated_95_m == pytest.approx(1.6 * np.sqrt((60 * 0.01**2 + 30 * 0.03**2) / 90))
    assert summary([stretch(1.0, 0.01, 97), stretch(1.0, 0.5, 3)]).error_95_m == pytest.approx(0.01)


def test_a_simulated_arm_proves_itself() -> None:
    """Other seeds: 5 or 6 stretches, rms 1.6 to 2.4 cm with the camera's noise, NEES 0.4 to 1.4."""
    check = solved(5).estimates.self_check
    assert check is not None
    assert 3 <= check.stretches <= 6 and check.failed == 0
    assert check.rms_m < 0.035
    assert 0.85 <= check.inside_95 <= 1.0 and 0.2 < check.worst_nees < 3.0
    assert 0.4 <= check.length_s <= 4.0
    assert smooth(replace(moving(5).recording, truth=None), processes=2).estimates.self_check == check
    # the stretches are in visible time: no gap of the result is one of them
    hidden_s, gaps = float((~moving(5).recording.arm.forearm_tracked).sum()) / 30.0, solved(5).gaps
    assert sum(gap.length_s for gap in gaps) < hidden_s + 0.15 * len(gaps) + 0.5


def test_sigmas_of_gaps_that_were_measured() -> None:
    """Positions and drawn motions in gaps grow by as much, without a jump; all else stays."""
    factors = SigmaFactors((SigmaFactor(0.1, 1.5, 24), SigmaFactor(4.0, 2.5, 31)))
    for length_s, factor in ((0.05, 1.5), (2.05, 2.0), (9.0, 2.5)):
        assert factors.at(length_s) == pytest.approx(factor)
    before = made()
    t = before.t_s[::4].copy()
    ones = np.ones((2, len(t), 3), np.float32)
    joints = {"elbow": ones.copy(), "shoulder": ones.copy()}
    before = replace(before, draws=Draws(t, 0, ones.copy(), ones.copy(), joints))
    after = with_sigma_factors(deepcopy(before), factors)  # which changes arrays in their place
    ratio = np.einsum("nii->ni", after.pose_covariance) / np.einsum("nii->ni", before.pose_covariance)
    grown, draws, expected = np.sqrt(ratio), after.draws, np.ones(len(before))
    known = np.isfinite(before.pose_covariance).all(axis=(1, 2))
    for gap in before.gaps:
        expected[(before.t_s >= gap.start_s) & (before.t_s <= gap.end_s) & before.occluded] = factors.at(
            gap.length_s
        )
        inside = (t >= gap.start_s) & (t <= gap.end_s)
        np.testing.assert_allclose(draws.position[:, inside], factors.at(gap.length_s), rtol=1e-4)
    assert expected.max() > 1.4
    np.testing.assert_allclose(grown[known, :3], np.tile(expected[known, None], 3), rtol=1e-4)
    np.testing.assert_allclose(grown[known, 3:], 1.0)
    assert (np.linalg.eigvalsh(after.pose_covariance[known]) > 0).all()
    for joint, covariance in after.joint_covariance.items():
        ratio = np.sqrt(covariance[:, 0, 0] / before.joint_covariance[joint][:, 0, 0])[expected > 1.0]
        finite = ratio[np.isfinite(ratio)]
        assert (finite == 1.0).all() if joint == "shoulder" else (finite > 1.4).all()
    away = np.min([np.maximum(gap.start_s - t, t - gap.end_s) for gap in before.gaps], axis=0)
    np.testing.assert_array_equal(draws.position[:, away > RAMP_S], 1.0)
    assert np.abs(np.diff(draws.position, axis=1)).max() < 0.3  # of a factor of 2, over 0.3 s
    np.testing.assert_array_equal(draws.joints["elbow"], draws.position)
    assert (draws.joints["shoulder"] == 1.0).all() and (draws.rotation == 1.0).all()
    assert "was multiplied by" in after.notes[-1] and "24 or more" in after.notes[-1]
    assert len(after.estimates.sigma_factors) == len(after.gaps)
    short = SigmaFactors((SigmaFactor(0.01, 1.2, 24),))
    assert "was hidden" in with_sigma_factors(before, short).notes[-1]
    assert with_sigma_factors(before, None) is before
