"""A verdict: sound recordings are usable, wrong set-ups are not to be trusted and say why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import ALONE, there

from smoother import Recording, smooth
from smoother.config import Config
from smoother.errors import UnoccludeError
from smoother.io import import_utd_mhad
from smoother.recording import CameraFrame
from smoother.recovery.trust import _gravity, with_verdict
from smoother.result import Estimates, Recovery
from smoother.simulation import ArmSimulation, simulate_arm


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


@pytest.mark.parametrize("seed", [0, 3, 5])
def test_a_sound_recording_is_usable(seed: int) -> None:
    estimates = recovered(seed).estimates
    assert estimates.trusted is True and estimates.reasons == ()
    assert estimates.verdict == "Usable."


@pytest.mark.parametrize(
    ("wrong", "word", "seed"),
    # tests/cli/test_setup_table.py smooths every mistake by the real command, which names its cause
    [(mirrored, "gravity", 3), (another_skeleton, "beside the", 0)],
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


def test_whose_arm_it_is_decides_what_is_possible() -> None:
    small = sound(0, 30.0)  # what is possible is judged where the lengths are known well
    small = replace(small, arm=replace(small.arm, position=small.arm.position * 0.5))
    recovery = smooth(small, None, ALONE)
    for anatomy, trusted in (("adult", False), ("child", True), ("any", True)):
        config = Config.model_validate({"arm": {"anatomy": anatomy}})
        again = with_verdict(recovery, small, config.arm.anatomy).estimates
        assert (anatomy, any("possible" in each for each in again.reasons)) == (anatomy, not trusted)


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
