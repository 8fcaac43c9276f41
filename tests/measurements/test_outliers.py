"""Samples that call themselves tracked and are rejected: rule by rule, both sides of each border."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from made_segments import ELBOW, FOREARM_M, HAND, WRIST, forearm, still_imu, with_position
from made_segments import STRAP as STRAP_COLUMN

from smoother.array_types import FloatArray
from smoother.measurements.alignment import Alignment
from smoother.measurements.inertial import InertialSignal
from smoother.measurements.outliers import (
    JointNoise,
    interpolated,
    reject_by_attitude,
    reject_by_camera,
    reject_by_residual,
)
from smoother.measurements.segment import Segment, spikes
from smoother.measurements.visibility import Rejection
from smoother.rotation import Rotation

X, ACROSS, Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.8]), np.array([0.0, 0.0, 1.0])
RESTING = Alignment(np.zeros(1), Rotation.from_quat([[0.0, 0.0, 0.0, 1.0]]), np.eye(3)[None])
EVERY, SHOULDER = range(90), 0


def exact() -> Segment:
    """Without noise, so that a border is one; a millimetre of wandering keeps values from repeating."""
    segment = forearm()
    middle = segment.position[:, [ELBOW, WRIST]].mean(axis=(0, 1))
    position, wander = segment.position.copy(), 1e-3 * np.random.default_rng(1).normal(size=(90, 3))
    for column, share in ((ELBOW, -0.5), (WRIST, 0.5), (HAND, 0.8), (STRAP_COLUMN, 0.3)):
        position[:, column] = middle + share * FOREARM_M * X + wander
    reason = segment.reason.copy()
    reason[7, SHOULDER] = Rejection.RAY  # of an earlier rule
    return replace(segment, position=position, reason=reason)


def rejected(before: Segment, after: Segment) -> dict[tuple[int, int], Rejection]:
    """Reason of every sample that was rejected; the input is as it was, and nothing comes back."""
    assert after.position is before.position and not (after.accepted & ~before.accepted).any()
    lost = before.accepted & ~after.accepted
    np.testing.assert_array_equal(after.reason[~lost], before.reason[~lost])
    return {(row, c): Rejection(after.reason[row, c]) for row, c in np.argwhere(lost).tolist()}


def far(distance_m: float) -> Segment:
    segment = exact()
    place = segment.position - segment.position[:, [WRIST]] + distance_m * np.array([0.6, 0.0, 0.8])
    return replace(segment, position=place, accepted=segment.accepted & (np.arange(5) == WRIST))


def repeated(imu: Callable[[FloatArray], tuple[FloatArray, FloatArray]]) -> Segment:
    """The hand's value repeats from 1.0667 to 1.4 s, while an IMU has more force along z and such a rate."""
    segment = exact()
    still = still_imu(segment.end_s)
    force, rate = imu(still.t_s)
    still.acc[:, 2] += force
    still.gyro[:, 2] = rate
    segment = replace(segment, signal=InertialSignal(still))
    return with_position(segment, slice(30, 40), HAND, segment.position[29, HAND])


def turning(rate: float, start_s: float = 0.0, end_s: float = 9.0) -> Segment:
    return repeated(lambda t: (0.0 * t, np.where((t >= start_s) & (t < end_s), rate, 0.0)))


def jump(off_m: float) -> Segment:
    segment = exact()
    position = segment.position.copy()
    position[:, HAND] += 1e-5 * np.arange(90)[:, None] - position[:, HAND] + position[0, HAND]
    position[40, HAND] += off_m * ACROSS
    return replace(segment, position=position)


def bone(part: float) -> Segment:
    segment = exact()
    wrist = segment.position[40:60, ELBOW] + part * FOREARM_M * X
    segment = with_position(segment, slice(40, 60), WRIST, wrist)
    return replace(segment, accepted=segment.accepted & (np.arange(5) != STRAP_COLUMN))


def strap(part: float, across_m: float) -> Segment:
    segment = exact()
    place = segment.position[:, ELBOW] + part * FOREARM_M * X + across_m * ACROSS
    return with_position(segment, slice(0, 90), STRAP_COLUMN, place)


def filled(frames: int) -> Segment:
    segment = exact()
    line, ends = np.linspace(0.0, 1.0, frames)[:, None], segment.position[[40, 39 + frames], HAND]
    return with_position(segment, slice(40, 40 + frames), HAND, (1 - line) * ends[0] + line * ends[1])


@pytest.mark.parametrize(
    ("make", "sound", "wrong", "columns", "rows", "reason"),
    [
        (far, 19.98, 20.02, [WRIST], EVERY, Rejection.FAR),
        (filled, 2, 12, [HAND], range(41, 51), Rejection.INTERPOLATED),
        (turning, 0.14, 0.16, [HAND], range(30, 40), Rejection.FROZEN),
        # of the length, from the least to the largest; not of one axis
        (lambda a: repeated(lambda t: (np.where(t > 1.2, a, 0.0), 0.0 * t)), 0.40, 0.60, [HAND],
         range(30, 40), Rejection.FROZEN),
        # behind the frame that is repeated, and before the last repeat
        (lambda end_s: turning(3.0, 0.0, end_s), 1.055, 1.11, [HAND], range(30, 40), Rejection.FROZEN),
        (lambda start_s: turning(3.0, start_s), 1.42, 1.375, [HAND], range(30, 40), Rejection.FROZEN),
        (jump, 0.148, 0.152, [HAND], range(40, 41), Rejection.JUMP),
        (bone, 1.295, 1.305, [ELBOW, WRIST], range(40, 60), Rejection.BONE),
        (bone, 0.705, 0.695, [ELBOW, WRIST], range(40, 60), Rejection.BONE),
        (lambda across_m: strap(0.8, across_m), 0.049, 0.051, [STRAP_COLUMN], EVERY, Rejection.STRAP),
        (lambda part: strap(part, 0.0), 0.505, 0.495, [STRAP_COLUMN], EVERY, Rejection.STRAP),
    ],
)  # fmt: skip
def test_a_camera_is_wrong_by_itself(
    make: Callable[[float], Segment],
    sound: float,
    wrong: float,
    columns: list[int],
    rows: range,
    reason: Rejection,
) -> None:
    for value, expected in ((sound, {}), (wrong, {(row, c): reason for c in columns for row in rows})):
        segment = make(value)
        assert rejected(segment, reject_by_camera(segment)) == expected
    accepted = segment.accepted & (np.arange(5) != ELBOW)  # nothing to compare with
    alone = replace(segment, accepted=accepted)
    compared = reason in (Rejection.BONE, Rejection.STRAP)
    assert bool(rejected(alone, reject_by_camera(alone))) == (not compared)


def test_nothing_is_rejected_from_good_samples_and_numbers_that_run_over_without_a_warning() -> None:
    for segment in (forearm(), forearm(rate=0.5 * Z), forearm(along=(0.0, 0.0, -1.0))):
        assert reject_by_camera(segment) is segment
    segment = with_position(exact(), [7], HAND, np.array([1e200, 0.0, 0.0]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert rejected(segment, reject_by_camera(segment)) == {(7, HAND): Rejection.FAR}


def pointing(from_ray_deg: float, turned_deg: float, part: float = 1.0) -> tuple[Segment, FloatArray]:
    """By the IMU so far from the viewing ray, in the image turned, and for a time of another length."""
    by_imu, by_camera = (
        np.asarray(Rotation.from_rotvec(np.radians(degrees) * X).apply(Z))
        for degrees in (from_ray_deg, from_ray_deg - turned_deg)
    )
    segment = exact()
    position, middle = segment.position.copy(), 2.0 * Z
    for rows, length in ((slice(0, 90), 1.0), (slice(40, 60), part)):
        half = 0.5 * length * FOREARM_M * by_camera
        position[rows, ELBOW], position[rows, WRIST] = middle - half, middle + half
    return replace(segment, position=position), by_imu


@pytest.mark.parametrize(
    ("sound", "wrong", "rows", "reason"),
    [
        ((90.0, 29.8), (90.0, 30.2), EVERY, Rejection.DIRECTION),
        ((90.0, 29.8), (90.0, 180.0), EVERY, Rejection.DIRECTION),
        ((0.0, 14.8), (0.0, 15.2), EVERY, Rejection.RAY),
        ((15.2, 15.2, 0.8), (14.8, 14.8, 0.8), range(40, 60), Rejection.RAY),  # not towards the camera
        ((0.0, 0.0, 0.855), (0.0, 0.0, 0.845), range(40, 60), Rejection.RAY),
        ((0.0, 0.0, 1.145), (0.0, 0.0, 1.155), range(40, 60), Rejection.RAY),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_forearm_that_does_not_point_as_the_imu_says(
    sound: tuple[float, ...], wrong: tuple[float, ...], rows: range, reason: Rejection, sign: float
) -> None:
    """By thirty degrees; within 15 of the viewing ray by 15, or 15 % too long or short."""
    columns = (ELBOW, WRIST, HAND)
    for values, expected in ((sound, {}), (wrong, {(row, c): reason for c in columns for row in rows})):
        segment, by_imu = pointing(*values)
        position = segment.position.copy()
        if sign < 0.0:
            position[:, [ELBOW, WRIST]] = position[:, [WRIST, ELBOW]]
        seen = replace(segment, position=position)
        found = rejected(seen, reject_by_attitude(seen, seen.frame_t_camera, RESTING, sign * by_imu))
        assert found == expected
    # frames without elbow or wrist are not judged
    none = replace(seen, accepted=seen.accepted & (np.arange(5) != ELBOW))
    assert reject_by_attitude(none, none.frame_t_camera, RESTING, -X) is none


@pytest.mark.parametrize(("sample_m", "limit_m"), [(0.001, 0.05), (0.02, 0.1)])
def test_a_residual_at_its_limit(sample_m: float, limit_m: float) -> None:
    """5 cm, and five times a sample's deviation; the whole length counts."""
    segment, residual = exact(), np.full((90, 5, 3), np.nan)
    residual[20, HAND] = 1.0
    for share, expected in ((0.999, {}), (1.001, {(20, WRIST): Rejection.RESIDUAL})):
        residual[20, WRIST] = share * limit_m * ACROSS
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            checked = reject_by_residual(segment, residual, {"wrist": JointNoise(sample_m, 9.0, 9.0)})
        assert rejected(segment, checked) == expected


@pytest.mark.parametrize("kind", ["line", "cubic", "by frame"])
def test_fillings_are_found_and_what_is_seen_is_kept(kind: str) -> None:
    rng = np.random.default_rng(5)
    t = np.sort(np.arange(0.0, 20.0, 1 / 30) + rng.uniform(0, 0.004, 600))
    x = np.column_stack([0.3 * np.sin((1 + k) * t) for k in range(3)]) + 0.004 * rng.normal(size=(600, 3))
    clean, at = x.copy(), t if kind != "by frame" else np.arange(600.0)
    gap = slice(200, 230)
    ends = [198, 199, 230, 231] if kind == "cubic" else [199, 230]
    for axis in range(3):
        line = np.polyfit(at[ends] - at[215], clean[ends, axis], len(ends) - 1)
        x[gap, axis] = np.polyval(line, at[gap] - at[215])
    everywhere = np.ones(600, bool)
    found = interpolated(t, x, everywhere)
    assert found[gap].mean() > 0.9
    found[197:233] = False  # the samples that the cubic was drawn through lie on it too
    assert not found.any()
    # neither noise nor a curve without any, of a simulation or a reference
    for sound in (clean, np.column_stack([t, t**2, 0 * t])):
        assert not interpolated(t, sound, everywhere).any()


@pytest.mark.parametrize("batch", [10, 1000])
def test_spikes_are_found_wherever_the_batches_meet(monkeypatch: pytest.MonkeyPatch, batch: int) -> None:
    gyro = 0.1 * np.random.default_rng(0).normal(size=(60, 3))
    lone = [2, 10, 20, 31, 57]
    gyro[lone, 1] += 40.0
    gyro[[0, 45, 46, 59], 2] += 40.0  # the ends, and two in a row, are none
    monkeypatch.setattr("smoother.measurements.segment.SPIKE_BATCH", batch)
    np.testing.assert_array_equal(np.flatnonzero(spikes(gyro)), lone)
    assert not spikes(gyro[:2]).any()
