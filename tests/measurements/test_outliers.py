"""Samples that call themselves tracked and are rejected: rule by rule, each border, all of them."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_segments import ELBOW, FOREARM_M, HAND, WRIST, forearm, still_imu, with_position
from made_segments import STRAP as STRAP_COLUMN

from smoother.array_types import FloatArray
from smoother.measurements.alignment import Alignment
from smoother.measurements.inertial import InertialSignal
from smoother.measurements.outliers import (
    JointNoise,
    _frozen,
    _jumps,
    reject_by_attitude,
    reject_by_camera,
    reject_by_residual,
)
from smoother.measurements.segment import Segment, spikes
from smoother.measurements.visibility import Rejection
from smoother.recording import JOINTS
from smoother.rotation import Rotation

TURNING = np.array([0.0, 0.0, 0.5])
X = np.array([1.0, 0.0, 0.0])
RESTING = Alignment(np.zeros(1), Rotation.from_quat([[0.0, 0.0, 0.0, 1.0]]), np.eye(3)[None])


def test_nothing_is_rejected_from_good_samples() -> None:
    for segment in (forearm(), forearm(rate=TURNING), forearm(along=(0.0, 0.0, -1.0))):
        assert reject_by_camera(segment) is segment


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    spread=st.sampled_from([0.001, 0.05, 1.0]),
    share=st.floats(0.0, 1.0),
    frames=st.integers(2, 40),
    turning=st.booleans(),
)
def test_rejecting_only_ever_takes_away(
    seed: int, spread: float, share: float, frames: int, turning: bool
) -> None:
    """Whatever the samples are: nothing comes back, every loss has a reason, the data stay as they were."""
    rng = np.random.default_rng(seed)
    segment = forearm(frames, rate=TURNING if turning else None)
    position = segment.position + spread * rng.normal(size=segment.position.shape)
    repeat = rng.uniform(size=frames) < 0.3
    for k in np.flatnonzero(repeat[1:]) + 1:
        position[k] = position[k - 1]
    accepted = segment.accepted & (rng.uniform(size=segment.accepted.shape) < share)
    segment = replace(segment, position=position, accepted=accepted)
    noise = {joint: JointNoise(0.01, 0.01, 0.0) for joint in JOINTS}
    residual = rng.normal(size=position.shape) * spread
    one = reject_by_camera(segment)
    two = reject_by_attitude(one, segment.frame_t_camera, RESTING, X)
    three = reject_by_residual(two, residual, noise)
    for before, after in ((segment, one), (one, two), (two, three)):
        assert not (after.accepted & ~before.accepted).any()
        lost = before.accepted & ~after.accepted
        assert (after.reason[lost] != 0).all()
        np.testing.assert_array_equal(after.reason[~lost], before.reason[~lost])
        assert after.position is segment.position


def why(before: Segment, after: Segment) -> dict[tuple[int, int], Rejection]:
    """Reason of every sample that was rejected; the input is as it was."""
    assert (before.reason == 0).all() and after.position is before.position
    lost = np.argwhere(before.accepted & ~after.accepted).tolist()
    assert (after.reason != 0).sum() == len(lost)
    return {(row, column): Rejection(after.reason[row, column]) for row, column in lost}


def only(column: int, rows: range, reason: Rejection) -> dict[tuple[int, int], Rejection]:
    return {(row, column): reason for row in rows}


def exact(frames: int = 90, **how: object) -> Segment:
    """Without noise, so that a border is one; a millimetre of wandering keeps values from repeating."""
    segment = forearm(frames, **how)  # type: ignore[arg-type]
    middle = segment.position[:, [ELBOW, WRIST]].mean(axis=(0, 1))
    along = np.array(how.get("along", X)) / np.linalg.norm(how.get("along", X))  # type: ignore[arg-type]
    rng = np.random.default_rng(1)
    position = segment.position.copy()
    wander = 1e-3 * rng.normal(size=(frames, 3))
    for column, share in ((ELBOW, -0.5), (WRIST, 0.5), (HAND, 0.8), (STRAP_COLUMN, 0.3)):
        position[:, column] = middle + share * FOREARM_M * along + wander
    return replace(segment, position=position)


@pytest.mark.parametrize(("distance_m", "is_far"), [(19.98, False), (20.02, True)])
def test_no_camera_sees_so_far(distance_m: float, is_far: bool) -> None:
    segment = exact()
    position = segment.position.copy()
    position[:] = np.nan
    for column in (ELBOW, WRIST, HAND, STRAP_COLUMN):
        place = segment.position[:, column] - segment.position[:, WRIST]
        position[:, column] = place + distance_m * np.array([0.6, 0.0, 0.8]) * [1, 1, 1]
    far = replace(segment, position=position, accepted=segment.accepted & (np.arange(len(JOINTS)) == WRIST))
    found = why(far, reject_by_camera(far))
    assert set(found.values()) == ({Rejection.FAR} if is_far else set())
    assert len(found) == (len(far.accepted) if is_far else 0)


def test_numbers_that_run_over_are_far_without_a_warning() -> None:
    segment = with_position(exact(), [7], HAND, np.array([1e200, 0.0, 0.0]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checked = reject_by_camera(replace(segment, accepted=segment.accepted))
    assert why(segment, checked)[(7, HAND)] == Rejection.FAR


def test_a_filling_is_rejected_in_its_joint_alone() -> None:
    segment = exact()
    position = segment.position.copy()
    line = np.linspace(0.0, 1.0, 12)[:, None]
    position[40:52, HAND] = (1 - line) * position[40, HAND] + line * position[51, HAND]
    filled = replace(segment, position=position)
    found = why(filled, reject_by_camera(filled))
    assert found == only(HAND, range(41, 51), Rejection.INTERPOLATED)


def turning_from(start_s: float, end_s: float, rate: float) -> Segment:
    """A sensor at rest but for a time."""
    segment = exact()
    imu = still_imu(segment.end_s)
    inside = (imu.t_s >= start_s) & (imu.t_s < end_s)
    imu.gyro[inside, 2] = rate
    return replace(segment, signal=InertialSignal(imu))


@pytest.mark.parametrize(
    ("start_s", "end_s", "rate", "is_frozen"),
    [
        (0.0, 9.0, 0.16, True),
        (0.0, 9.0, 0.14, False),
        (1.0667, 1.11, 3.0, True),  # just behind the frame that is repeated, at 1.0667 s
        (1.375, 1.40, 3.0, True),  # just before the last repeat, at 1.4 s
        (0.0, 1.055, 3.0, False),  # before it
        (1.42, 9.0, 3.0, False),  # and behind the run
    ],
)
def test_the_sensor_moves_while_a_value_repeats(
    start_s: float, end_s: float, rate: float, is_frozen: bool
) -> None:
    segment = turning_from(start_s, end_s, rate)
    frozen = with_position(segment, slice(30, 40), HAND, segment.position[29, HAND])
    np.testing.assert_allclose(frozen.frame_t_camera[[29, 39]], [1.0667, 1.4], atol=1e-4)
    assert np.flatnonzero(_frozen(frozen, HAND)).tolist() == (list(range(30, 40)) if is_frozen else [])


@pytest.mark.parametrize(("force", "is_frozen"), [(0.40, False), (0.60, True)])
def test_the_sensor_is_shaken_while_a_value_repeats(force: float, is_frozen: bool) -> None:
    """Half a metre a second squared from the least to the largest, of the length: not of one axis."""
    segment = exact()
    imu = still_imu(segment.end_s)
    imu.acc[imu.t_s > 1.2, 2] += force
    frozen = with_position(
        replace(segment, signal=InertialSignal(imu)), slice(30, 40), WRIST, segment.position[29, WRIST]
    )
    assert _frozen(frozen, WRIST).sum() == (10 if is_frozen else 0)


@pytest.mark.parametrize(("off_m", "is_jump"), [(0.148, False), (0.152, True)])
def test_a_jump_is_fifteen_centimetres(off_m: float, is_jump: bool) -> None:
    segment = exact()
    position = segment.position.copy()
    position[:, HAND] = segment.position[0, HAND]
    position[40, HAND] += off_m * np.array([0.0, 0.6, 0.8])
    assert np.flatnonzero(_jumps(replace(segment, position=position), HAND)).tolist() == (
        [40] if is_jump else []
    )


@pytest.mark.parametrize(("part", "wrong"), [(1.295, False), (1.305, True), (0.705, False), (0.695, True)])
def test_a_bone_is_a_third_too_long_or_short(part: float, wrong: bool) -> None:
    segment = exact()
    position = segment.position.copy()
    position[40:60, WRIST] = position[40:60, ELBOW] + part * FOREARM_M * X
    off = replace(segment, position=position, accepted=segment.accepted & (np.arange(5) != STRAP_COLUMN))
    found = why(off, reject_by_camera(off))
    expected = only(WRIST, range(40, 60), Rejection.BONE) | only(ELBOW, range(40, 60), Rejection.BONE)
    assert found == (expected if wrong else {})


@pytest.mark.parametrize(
    ("part", "across_m", "wrong"),
    [(0.8, 0.049, False), (0.8, 0.051, True), (0.505, 0.0, False), (0.495, 0.0, True)],
)
def test_where_a_strap_can_be(part: float, across_m: float, wrong: bool) -> None:
    segment = exact()
    position = segment.position.copy()
    position[:, STRAP_COLUMN] = position[:, ELBOW] + part * FOREARM_M * X + across_m * np.array([0, 0.6, 0.8])
    off = replace(segment, position=position)
    found = why(off, reject_by_camera(off))
    assert found == (only(STRAP_COLUMN, range(90), Rejection.STRAP) if wrong else {})
    accepted = off.accepted.copy()
    accepted[:, ELBOW] = False  # nothing to compare with
    alone = replace(off, accepted=accepted)
    assert why(alone, reject_by_camera(alone)) == {}


def tilted(degrees: float) -> FloatArray:
    return np.asarray(Rotation.from_rotvec([0.0, np.radians(degrees), 0.0]).apply(X))


@pytest.mark.parametrize(("degrees", "wrong"), [(29.8, False), (30.2, True), (180.0, True)])
def test_a_direction_is_thirty_degrees_off(degrees: float, wrong: bool) -> None:
    segment = exact(middle=(0.0, 0.0, 2.0))
    found = why(segment, reject_by_attitude(segment, segment.frame_t_camera, RESTING, tilted(degrees)))
    expected = {}
    for column in (ELBOW, WRIST, HAND):
        expected |= only(column, range(90), Rejection.DIRECTION)
    assert found == (expected if wrong else {})


@pytest.mark.parametrize(
    ("from_ray_deg", "turned_deg", "part", "wrong"),
    [
        (0.0, 15.2, 1.0, True),
        (0.0, 14.8, 1.0, False),
        (14.8, 14.8, 0.8, True),
        (15.2, 15.2, 0.8, False),  # not towards the camera
        (0.0, 0.0, 0.855, False),
        (0.0, 0.0, 0.845, True),
        (0.0, 0.0, 1.155, True),
        (0.0, 0.0, 1.145, False),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_forearm_along_the_viewing_ray(
    from_ray_deg: float, turned_deg: float, part: float, wrong: bool, sign: float
) -> None:
    """By the IMU within 15 degrees of the ray, and in the image turned by 15 or 15 % too long or short."""
    z = sign * np.array([0.0, 0.0, 1.0])

    def off_ray(degrees: float) -> FloatArray:
        return np.asarray(Rotation.from_rotvec([np.radians(degrees), 0.0, 0.0]).apply(z))

    segment = exact()
    position, middle = segment.position.copy(), np.array([0.0, 0.0, 2.0])
    by_camera = off_ray(from_ray_deg - turned_deg)
    for rows, length in ((slice(0, 90), 1.0), (slice(40, 60), part)):
        half = 0.5 * length * FOREARM_M * by_camera
        position[rows, ELBOW], position[rows, WRIST] = middle - half, middle + half
    seen = replace(segment, position=position)
    found = why(seen, reject_by_attitude(seen, seen.frame_t_camera, RESTING, off_ray(from_ray_deg)))
    rows = range(90) if turned_deg > 15.0 and from_ray_deg < 15.0 else range(40, 60)
    expected = {}
    for column in (ELBOW, WRIST, HAND):
        expected |= only(column, rows, Rejection.RAY)
    assert found == (expected if wrong else {})


def test_frames_without_elbow_or_wrist_are_not_judged() -> None:
    segment = exact()
    accepted = segment.accepted.copy()
    accepted[:50, ELBOW], accepted[50:, WRIST] = False, False
    none = replace(segment, accepted=accepted)
    assert reject_by_attitude(none, none.frame_t_camera, RESTING, -X) is none
    accepted[20, ELBOW] = True
    one = replace(segment, accepted=accepted)
    found = why(one, reject_by_attitude(one, one.frame_t_camera, RESTING, -X))
    assert set(found) == {(20, ELBOW), (20, WRIST), (20, HAND)}


@pytest.mark.parametrize(
    ("sample_m", "off_m", "wrong"),
    [(0.001, 0.0499, False), (0.001, 0.0501, True), (0.02, 0.0999, False), (0.02, 0.1001, True)],
)
def test_a_residual_at_its_limit(sample_m: float, off_m: float, wrong: bool) -> None:
    """5 cm, and five times a sample's deviation; the whole length counts."""
    segment = exact()
    residual = np.full((*segment.accepted.shape, 3), np.nan)
    residual[20, WRIST] = off_m * np.array([0.6, 0.0, 0.8])
    residual[20, HAND] = 1.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checked = reject_by_residual(segment, residual, {"wrist": JointNoise(sample_m, 9.0, 9.0)})
    assert why(segment, checked) == (only(WRIST, range(20, 21), Rejection.RESIDUAL) if wrong else {})


@pytest.mark.parametrize("batch", [10, 1000])
def test_spikes_are_found_wherever_the_batches_meet(monkeypatch, batch) -> None:
    gyro = 0.1 * np.random.default_rng(0).normal(size=(60, 3))
    lone = [2, 10, 20, 31, 57]
    gyro[lone, 1] += 40.0
    gyro[[0, 45, 46, 59], 2] += 40.0  # the ends, and two in a row, are none
    monkeypatch.setattr("smoother.measurements.segment.SPIKE_BATCH", batch)
    np.testing.assert_array_equal(np.flatnonzero(spikes(gyro)), lone)
    assert not spikes(gyro[:2]).any()
