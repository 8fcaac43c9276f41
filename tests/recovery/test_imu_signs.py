"""What an IMU's samples betray: a wrong scale, samples lost behind even stamps, one that lies still."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from scenes import answer, arm, moving, solved, there
from scipy.io import loadmat

from smoother.recording import ImuStream, Recording
from smoother.recovery import imu_signs as module
from smoother.recovery.change_signs import imu_lies_still
from smoother.recovery.imu_signs import clock_steps, doubtful_scale, force_scale, lost_samples, wrong_scale
from smoother.result import Recovery
from smoother.rotation import Rotation
from smoother.units import STANDARD_GRAVITY

NO_BIAS = np.zeros(3)


def worn(protocol: str, seed: int = 1) -> ImuStream:
    made = moving(seed) if protocol == "random" else arm(seed, "realistic", protocol=protocol)
    return made.recording.imu


def poses(turns: list[np.ndarray], still_s: float = 5.0, rate_hz: float = 50.0) -> ImuStream:
    """A sensor that rests, turns about an axis within a second, and rests again."""
    count, during = round(still_s * rate_hz), (np.arange(round(rate_hz)) + 0.5) / rate_hz
    rates = [np.zeros((count, 3))]
    for turn in turns:
        rates += [2.0 * np.sin(np.pi * during[:, None]) ** 2 * turn, np.zeros((count, 3))]
    rate = np.concatenate(rates)
    R = Rotation.from_rotvec(np.zeros(3))
    force = np.empty_like(rate)
    for row, each in enumerate(rate):  # the slow way: sample after sample, each at its interval's middle
        half = Rotation.from_rotvec(0.5 * each / rate_hz)
        force[row] = (R * half).inv().apply([0.0, 0.0, STANDARD_GRAVITY])
        R = R * half * half
    return ImuStream("poses", (np.arange(len(rate)) + 0.5) / rate_hz, force, rate)


QUARTERS = np.array([[1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1]]) * np.pi / 2
TURNED = poses(list(QUARTERS))


@pytest.mark.parametrize("protocol", ["random", "hang", "behind"])
@pytest.mark.parametrize("factor", [0.5, 0.75, 0.92, 1.0, 1.09, 1.3, 2.0])
def test_the_scale_of_the_accelerometer(protocol: str, factor: float) -> None:
    """A wrong one is not to be trusted, one that is somewhat off a caution."""
    imu = worn(protocol)
    scale = force_scale(replace(imu, acc=factor * imu.acc), NO_BIAS)
    assert abs(scale.ratio / factor - 1.0) < 0.04
    said, doubts = [*wrong_scale(scale)], [*doubtful_scale(scale)]
    assert bool(said) == (abs(factor - 1.0) > 0.2)
    if protocol == "behind" or factor == 1.0:
        assert bool(doubts) == (0.05 < abs(factor - 1.0) < 0.2)
    for each in doubts:
        assert f"% too {'little' if factor < 1.0 else 'much'} where gravity alone acts" in each
    for each in said:
        assert abs(float(each.split("reads ")[1].split()[0]) / STANDARD_GRAVITY / factor - 1.0) < 0.04
        assert (f"as if its range were {factor:g} times as wide" in each) == (factor in (0.5, 2.0))


@pytest.mark.slow
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_bias_is_no_scale(axis: int, sign: int) -> None:
    """A tenth of g along one axis, as real sensors have it: several poses show it, a single one does not."""
    bias = 0.1 * STANDARD_GRAVITY * sign * np.eye(3)[axis]
    scale = force_scale(replace(TURNED, acc=TURNED.acc + bias), NO_BIAS)
    assert scale is not None and abs(scale.ratio - 1.0) < 0.02 and not scale.is_doubtful
    for imu in (worn("random"), worn("hang"), poses([])):
        scale = force_scale(replace(imu, acc=imu.acc + bias), NO_BIAS)
        assert scale is not None and [*wrong_scale(scale)] == []


def test_what_is_no_fault_of_the_accelerometer() -> None:
    imu = worn("random")
    for gyro in (-imu.gyro, np.radians(imu.gyro), imu.gyro * [1, 1, -1], np.clip(imu.gyro, -0.5, 0.5)):
        assert [*wrong_scale(force_scale(replace(imu, gyro=gyro), NO_BIAS))] == []
    for rows in (slice(0, 40), slice(0, 160)):
        assert [*wrong_scale(force_scale(imu.select(rows), NO_BIAS))] == []
    assert force_scale(imu.select(slice(0, 3)), NO_BIAS) is None
    assert force_scale(replace(imu, acc=0.0 * imu.acc), NO_BIAS) is None
    at_rest = force_scale(TURNED, NO_BIAS)  # which gives the scale itself
    assert at_rest is not None and abs(at_rest.ratio - 1.0) < 1e-3 and at_rest.sigma < 0.01


@pytest.mark.real
def test_sensors_of_others_are_sound() -> None:
    """UTD-MHAD's has a bias of 0.095 g along one axis; its clips are of 2 to 6 s."""
    streams = []
    for path in sorted(there("utd_mhad", "Inertial").glob("*_t1_inertial.mat"))[::4]:
        acc, gyro = np.split(loadmat(path)["d_iner"], 2, axis=1)
        t, bias = np.arange(len(acc)) / 50, np.radians([-2.2, 1.0, -1.0])
        streams.append((ImuStream(path.name, t, acc * STANDARD_GRAVITY, np.radians(gyro)), bias))
    for path in sorted(there("broad").glob("*.mat")):
        trial = loadmat(path)
        t = np.arange(len(trial["imu_acc"])) / 285.714
        streams.append((ImuStream(path.name, t, trial["imu_acc"], trial["imu_gyr"]), NO_BIAS))
    for imu, bias in streams:
        scale = force_scale(imu, bias)
        assert [*wrong_scale(scale), *doubtful_scale(scale)] == [], imu.name


def kept(count: int, first: int, lost: int) -> np.ndarray:
    return np.r_[0:first, first + lost : count]


def without(recording: Recording, at_s: float, lost_s: float) -> Recording:
    """Samples taken out, and the rest stamped as if nothing were missing."""
    imu = recording.imu
    rows = kept(len(imu), int(np.searchsorted(imu.t_s, at_s)), round(lost_s * imu.rate_hz))
    imu = replace(imu, t_s=imu.t_s[: len(rows)], acc=imu.acc[rows], gyro=imu.gyro[rows])
    return replace(recording, imu=imu)


def stamped(at_s: float, lost_s: float) -> tuple[Recovery, Recording]:
    """What was recovered, stamped as the recording: only the comparison is looked at."""
    recovery, recording = solved(3, duration_s=40.0), moving(3, duration_s=40.0).recording
    first, lost = int(np.searchsorted(recovery.t_s, at_s)), round(lost_s * recording.imu.rate_hz)
    rows, short = kept(len(recovery), first, lost), without(recording, at_s, lost_s)
    return replace(recovery.rows(rows), t_s=short.imu.t_s, residuals=recovery.residuals), short


def frames_lost(at_s: float, lost_s: float) -> tuple[Recovery, Recording]:
    recovery, recording = stamped(0.0, 0.0)
    t = recovery.residuals.t_s
    moved = t - np.where(t > at_s, lost_s, 0.0)
    order = np.argsort(moved, kind="stable")
    return replace(recovery, residuals=replace(recovery.residuals, t_s=moved[order])), recording


@pytest.mark.parametrize(
    ("make", "at_s", "lost_s"),
    [
        *((stamped, at_s, lost_s) for at_s in (12.0, 22.5, 33.0) for lost_s in (0.0, 0.075, 0.15, 0.3)),
        (frames_lost, 20.0, 0.2),
    ],
)
def test_lost_samples_and_frames_have_a_time_and_a_size(
    make: Callable[[float, float], tuple[Recovery, Recording]], at_s: float, lost_s: float
) -> None:
    """Also where a long recording is looked at in parts; a sound one has none."""
    given = make(at_s, lost_s)
    steps, signs = clock_steps(*given), list(lost_samples(*given))
    if not lost_s:
        assert all(step.gain < 1.5 for step in steps) and not signs
        return
    (step,), (sign,) = steps, signs
    assert step.gain > module.STEP_GAIN and abs(step.at_s - at_s) < 2.5
    # each side to half a step, and noise
    assert abs(abs(step.step_s) - lost_s) < 2.0 * module.GRID_S
    assert (step.step_s > 0.0) == (make is frames_lost)
    lost = "frames of the camera were lost" if make is frames_lost else "samples of the IMU were lost there"
    assert lost in sign.sentence
    assert (sign.severity == "recording") == (abs(step.step_s) >= module.LARGE_STEP_S)
    with patch.multiple(module, PART_S=20.0, SHARED_S=12.0):
        parts = clock_steps(*given)
    assert len(parts) > 2
    worst = max(parts, key=lambda each: each.gain)
    assert abs(worst.step_s) == pytest.approx(lost_s, abs=2.0 * module.GRID_S)


@pytest.mark.slow
def test_smooth_does_not_trust_the_gap_of_the_loss() -> None:
    """0.1 s lost in a gap: 23 cm at a sigma of 2, with other gaps as good as ever."""
    recovery = answer(without(moving(3, duration_s=40.0).recording, 20.4, 0.1))
    found = recovery.estimates
    said = [*found.reasons, *(why for each in found.untrusted for why in each.reasons)]
    assert any("the stamps hide it" in why for why in said)
    hidden = next(gap for gap in recovery.gap_verdicts if gap.start_s < 20.4 < gap.end_s)
    assert not hidden.trusted


def taken_off(recording: Recording, at_s: float) -> Recording:
    """From then on the IMU lies on a table."""
    imu, rng = recording.imu, np.random.default_rng(0)
    late, acc, gyro = imu.t_s > at_s, imu.acc.copy(), imu.gyro.copy()
    acc[late] = np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.02, (late.sum(), 3))
    gyro[late] = rng.normal(0.0, 0.002, (late.sum(), 3))
    return replace(recording, imu=replace(imu, acc=acc, gyro=gyro))


def test_an_imu_that_was_taken_off_is_named_from_when_on() -> None:
    """Neither one that is worn, nor an arm at rest: camera noise turns the forearm by some degrees."""
    recovery, recording = solved(6, duration_s=25.0), moving(6, duration_s=25.0).recording
    still = np.where(np.isfinite(recording.arm.position), recording.arm.position[:1], np.nan)
    noise = np.random.default_rng(1).normal(0.0, 0.03, still.shape)
    resting = replace(taken_off(recording, 0.0), arm=replace(recording.arm, position=still + noise))
    for sound in (recording, resting):
        assert list(imu_lies_still(recovery, sound, NO_BIAS)) == []
    (found,) = imu_lies_still(recovery, taken_off(recording, 14.0), NO_BIAS)
    assert found.severity == "times" and "is still" in found.sentence
    assert found.start_s == pytest.approx(14.0, abs=0.3) and found.end_s > 24.0
