"""Recordings that others made: an IMU under optical truth, and a Kinect with an IMU on the wrist."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import ALONE, answer, there

from calib.imu import calibrate_magnetometer
from calib.motion import calibrate_motion
from smoother.evaluation.gaps import GapTable, evaluate_gaps
from smoother.evaluation.validate import validate
from smoother.io import import_broad, import_utd_mhad
from smoother.linalg import interpolate
from smoother.recording import Recording

pytestmark = pytest.mark.real

#: Limits, m rms by gap length, s. Over the trials at hand 0.5, 0.76, 1.3 and 2.2 cm were measured; one
#: trial with six gaps a length scatters by half as much, and fast ones lie above the mean.
LIMITS = {0.5: 0.011, 1.0: 0.016, 2.0: 0.026, 3.0: 0.045}
#: The part of a trial that is looked at, s: movement starts after about half a minute of rest.
PART_S = (30.0, 110.0)
TRIALS = ("11_undisturbed_slow_translation_B.mat", "16_undisturbed_fast_translation_B.mat")


@pytest.fixture(scope="module", params=TRIALS)
def table(request: pytest.FixtureRequest) -> GapTable:
    trial = import_broad(there("broad", request.param)).crop(*PART_S)
    return evaluate_gaps(trial, list(LIMITS), {"graph": answer}, seed=1)


@pytest.mark.slow
def test_errors_and_covariance_in_hidden_gaps(table: GapTable) -> None:
    """Honest is 1; the optical point lies a centimetre off the IMU, which fast turns show (measured 4.3)."""
    assert list(table.lengths) == list(LIMITS)
    for length, limit in LIMITS.items():
        found = table.lengths[length]["graph"]
        assert found.counts["failed"] == 0
        assert len(found.rows) >= 4
        assert found.figures.position_rms_m < limit, f"gaps of {length} s"
        assert 0.02 < found.figures.nees < 8.0


SUBJECT, GAP_S = 2, 0.5
#: Quick ones: waving, drawing a circle, throwing.
ACTIONS = (3, 9, 5)


def kinect_trial(action: int, number: int) -> Recording:
    """A trial of UTD-MHAD: a Kinect v1 and an IMU on the right wrist."""
    name = f"a{action}_s{SUBJECT}_t{number}"
    inertial = there("utd_mhad", "Inertial", f"{name}_inertial.mat")
    return import_utd_mhad(inertial, there("utd_mhad", "Skeleton", f"{name}_skeleton.mat"))


@pytest.mark.slow
def test_a_real_kinect_beats_interpolation() -> None:
    """Half a second hidden in the middle of three trials that calibration never saw.

    One person's arm is found from the first trial of every other action.
    """
    first = [kinect_trial(action, 1) for action in range(1, 22, 2)]
    calibration = calibrate_motion(first, None, ALONE).calibration
    elbow, wrist = (calibration.lever_arms[joint].position_m for joint in ("elbow", "wrist"))
    # a watch's place: elbow and wrist a forearm apart along the sensor's x axis, the wrist nearer
    assert 0.18 < np.linalg.norm(wrist - elbow) < 0.33 and np.linalg.norm(wrist) < np.linalg.norm(elbow)
    assert np.degrees(np.arccos(calibration.forearm_direction[0])) < 25.0
    ours, line = [], []
    for action in ACTIONS:
        whole = kinect_trial(action, 2)
        t, tracked, wrist = whole.arm.t_s, whole.arm.tracked("wrist"), whole.arm.joint("wrist")
        hidden = np.abs(t - 0.5 * (t[0] + t[-1])) <= 0.5 * GAP_S
        recovery = answer(replace(whole, arm=whole.arm.hide(hidden)), calibration)
        seen, kept = tracked & hidden, tracked & ~hidden
        found = interpolate(recovery.t_s, recovery.joints["wrist"], recovery.arm.t_s[seen])
        straight = interpolate(t[kept], wrist[kept], t[seen])
        for errors, path in ((ours, found), (line, straight)):
            errors.append(np.sum((path - wrist[seen]) ** 2, axis=1))
    assert np.mean(np.concatenate(ours)) < np.mean(np.concatenate(line))


#: A trial whose rotations reach all directions, and one with a magnet on the sensor from about 40 to 95 s.
ROTATION, MAGNET = "05_undisturbed_slow_rotation_with_breaks_B.mat", "33_disturbed_attached_magnet_2cm.mat"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("trial", "part_s", "words", "share"),
    # 2.4 against 3.0 degrees measured on 80 s; the whole trial gains more, as it knows the field better
    [(ROTATION, (25.0, 85.0), "magnetometer is used", 0.95), (MAGNET, (80.0, 140.0), "left out", 1.02)],
    ids=["undisturbed the orientation gains", "disturbed nothing is lost"],
)
def test_a_real_magnetometer(trial: str, part_s: tuple[float, float], words: str, share: float) -> None:
    field = calibrate_magnetometer(import_broad(there("broad", ROTATION)).imu.mag)
    # a factory-calibrated sensor of 44 uT: hard iron below 2 uT, 1.7 % off the sphere measured
    assert np.abs(field.offset).max() < 2.0 and field.residual < 0.025
    recording = import_broad(there("broad", trial), seed=5).crop(*part_s)
    mag = (recording.imu.mag - field.offset) @ field.matrix.T
    imu = replace(recording.imu, mag=mag, mag_calibrated=True)
    answers = answer(recording), answer(replace(recording, imu=imu))
    plain, helped = (validate(each, recording.truth).all for each in answers)
    assert any(words in note for note in answers[1].notes if "magnetometer" in note)
    assert helped.orientation_rms_deg < share * plain.orientation_rms_deg
    assert helped.position_rms_m < 1.02 * plain.position_rms_m
