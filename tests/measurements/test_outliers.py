"""Samples that call themselves tracked and are rejected: rule by rule, and all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_segments import ELBOW, HAND, WRIST, forearm, still_imu, with_position
from made_segments import STRAP as STRAP_COLUMN

from smoother.array_types import BoolArray, FloatArray
from smoother.measurements.alignment import Alignment
from smoother.measurements.inertial import InertialSignal
from smoother.measurements.outliers import (
    JointNoise,
    reject_by_attitude,
    reject_by_camera,
    reject_by_residual,
)
from smoother.measurements.segment import Segment
from smoother.measurements.visibility import Rejection
from smoother.recording import JOINTS
from smoother.rotation import Rotation

TURNING = np.array([0.0, 0.0, 0.5])
X = np.array([1.0, 0.0, 0.0])
RESTING = Alignment(np.zeros(1), Rotation.from_quat([[0.0, 0.0, 0.0, 1.0]]), np.eye(3)[None])


def rejected_for(before: Segment, after: Segment, why: Rejection) -> BoolArray:
    """Which samples (F, 5) one reason rejected; every one that was rejected has a reason, no other has."""
    lost = before.accepted & ~after.accepted
    np.testing.assert_array_equal(after.reason != 0, lost)
    return np.asarray(after.reason == why)


def frames_of(mask: BoolArray, column: int) -> list[int]:
    return np.flatnonzero(mask[:, column]).tolist()


def test_nothing_is_rejected_from_good_samples() -> None:
    for segment in (forearm(), forearm(rate=TURNING), forearm(along=(0.0, 0.0, -1.0))):
        assert reject_by_camera(segment) is segment


@pytest.mark.parametrize("rate", [None, TURNING], ids=["still", "turning"])
def test_a_frozen_value_only_while_the_sensor_moves(rate: FloatArray | None) -> None:
    segment = forearm(rate=rate)
    frozen = with_position(segment, slice(30, 40), WRIST, segment.position[29, WRIST])
    checked = reject_by_camera(frozen)
    rows = frames_of(rejected_for(frozen, checked, Rejection.FROZEN), WRIST)
    assert rows == ([] if rate is None else list(range(30, 40)))  # the first of the run is a measurement
    assert (checked.accepted[:, ELBOW] == frozen.accepted[:, ELBOW]).all()


def test_a_value_that_repeats_once_is_not_frozen() -> None:
    segment = forearm(rate=TURNING)
    once = reject_by_camera(with_position(segment, [30], WRIST, segment.position[29, WRIST]))
    assert once.accepted.sum() == segment.accepted.sum()


def test_a_frozen_value_while_the_sensor_is_shaken() -> None:
    """No turning, but a specific force that varies by a metre a second squared."""
    segment = forearm()
    imu = still_imu(segment.end_s)
    imu.acc[:, 0] = 4.0 * np.sin(2 * np.pi * 2.0 * imu.t_s)
    shaken = replace(segment, signal=InertialSignal(imu))
    frozen = with_position(shaken, slice(30, 45), HAND, segment.position[29, HAND])
    assert frames_of(rejected_for(frozen, reject_by_camera(frozen), Rejection.FROZEN), HAND) == list(
        range(30, 45)
    )


@pytest.mark.parametrize(("off_m", "is_jump"), [(0.10, False), (0.25, True)])
def test_a_jump(off_m: float, is_jump: bool) -> None:
    segment = forearm()
    jumped = with_position(segment, [40, 41], HAND, segment.position[40, HAND] + [0.0, off_m, 0.0])
    checked = reject_by_camera(jumped)
    assert frames_of(rejected_for(jumped, checked, Rejection.JUMP), HAND) == ([40, 41] if is_jump else [])


def test_a_fast_arm_does_not_jump() -> None:
    """Four metres a second, 13 cm a frame, straight on: far from its neighbours and still right."""
    segment = forearm()
    position = segment.position + np.outer(4.0 * segment.frame_t_camera, X)[:, None]
    fast = replace(segment, position=position)
    checked = reject_by_camera(fast)
    assert checked.accepted.sum() == fast.accepted.sum()


def test_the_far_side_of_a_gap_does_not_jump() -> None:
    segment = forearm()
    position, accepted = segment.position.copy(), segment.accepted.copy()
    accepted[40:70] = False
    position[70:] += [0.0, 0.5, 0.0]
    gap = replace(segment, position=position, accepted=accepted)
    assert reject_by_camera(gap).accepted.sum() == accepted.sum()


@pytest.mark.parametrize(("part", "wrong"), [(0.8, False), (1.25, False), (0.6, True), (1.4, True)])
def test_the_bone_s_length(part: float, wrong: bool) -> None:
    segment = forearm()
    elbow, wrist = segment.position[50, ELBOW], segment.position[50, WRIST]
    # a long run, so that no median of neighbours calls it a jump
    off = with_position(segment, slice(40, 60), WRIST, elbow + part * (wrist - elbow))
    mask = rejected_for(off, reject_by_camera(off), Rejection.BONE)
    expected = list(range(40, 60)) if wrong else []
    assert frames_of(mask, WRIST) == expected
    assert frames_of(mask, ELBOW) == expected
    assert frames_of(mask, HAND) == []


@pytest.mark.parametrize(
    ("across_m", "part", "wrong"),
    [(0.04, 0.8, False), (0.06, 0.8, True), (0.0, 0.6, False), (0.0, 0.4, True)],
)
def test_the_strap_on_the_forearm_s_line(across_m: float, part: float, wrong: bool) -> None:
    segment = forearm()
    elbow, wrist = segment.position[50, ELBOW], segment.position[50, WRIST]
    place = elbow + part * (wrist - elbow) + [0.0, across_m, 0.0]
    off = with_position(segment, slice(40, 60), STRAP_COLUMN, place)
    assert frames_of(rejected_for(off, reject_by_camera(off), Rejection.STRAP), STRAP_COLUMN) == (
        list(range(40, 60)) if wrong else []
    )


@pytest.mark.parametrize(("degrees", "wrong"), [(25.0, False), (35.0, True), (180.0, True)])
def test_the_direction_against_the_inertial_one(degrees: float, wrong: bool) -> None:
    segment = forearm()
    along = Rotation.from_rotvec([0.0, np.radians(degrees), 0.0]).apply(X)
    checked = reject_by_attitude(segment, segment.frame_t_camera, RESTING, along)
    mask = rejected_for(segment, checked, Rejection.DIRECTION)
    for column in (ELBOW, WRIST, HAND):
        assert mask[:, column].all() == wrong
        assert mask[:, column].any() == wrong


@pytest.mark.parametrize(
    ("degrees", "part", "wrong"),
    [(0.0, 1.0, False), (10.0, 1.0, False), (20.0, 1.0, True), (0.0, 0.9, False), (0.0, 0.8, True)],
)
def test_the_viewing_ray_only_where_it_is_misjudged(degrees: float, part: float, wrong: bool) -> None:
    """A forearm that points at the camera, seen as it is, a little turned, or shortened in 20 frames."""
    segment = forearm(along=(0.0, 0.0, -1.0))
    inertial = np.array([0.0, 0.0, -1.0])
    elbow, wrist = segment.position[:, ELBOW], segment.position[:, WRIST]
    turned = Rotation.from_rotvec([np.radians(degrees), 0.0, 0.0]).apply(wrist - elbow)
    off = with_position(segment, slice(40, 60), WRIST, (elbow + part * turned)[40:60])
    mask = rejected_for(off, reject_by_attitude(off, off.frame_t_camera, RESTING, inertial), Rejection.RAY)
    assert frames_of(mask, WRIST) == (list(range(40, 60)) if wrong else [])


def test_off_the_ray_the_ray_s_rule_is_silent() -> None:
    segment = forearm()  # across the view
    elbow, wrist = segment.position[:, ELBOW], segment.position[:, WRIST]
    turned = Rotation.from_rotvec([0.0, np.radians(20.0), 0.0]).apply(wrist - elbow)
    off = with_position(segment, slice(40, 60), WRIST, (elbow + 0.8 * turned)[40:60])
    assert reject_by_attitude(off, off.frame_t_camera, RESTING, X).accepted[:, WRIST].all()


@pytest.mark.parametrize(
    ("sample_m", "off_m", "wrong"),
    [(0.001, 0.04, False), (0.001, 0.06, True), (0.02, 0.09, False), (0.02, 0.11, True)],
)
def test_a_residual_in_metres_and_in_deviations(sample_m: float, off_m: float, wrong: bool) -> None:
    segment = forearm()
    residual = np.zeros((*segment.accepted.shape, 3))
    residual[20, WRIST] = [off_m, 0.0, 0.0]
    residual[30, HAND] = [1.0, 0.0, 0.0]  # its noise is not known: no judgement
    residual[40] = np.nan
    checked = reject_by_residual(segment, residual, {"wrist": JointNoise(sample_m, sample_m, 0.0)})
    mask = rejected_for(segment, checked, Rejection.RESIDUAL)
    assert np.argwhere(mask).tolist() == ([[20, WRIST]] if wrong else [])


def test_the_first_reason_is_kept() -> None:
    segment = forearm()
    jumped = with_position(segment, [40], WRIST, segment.position[40, WRIST] + [0.0, 0.3, 0.0])
    checked = reject_by_camera(jumped)
    assert checked.reason[40, WRIST] == Rejection.JUMP
    residual = np.full((*segment.accepted.shape, 3), 1.0)
    again = reject_by_residual(checked, residual, {"wrist": JointNoise(0.01, 0.01, 0.0)})
    assert again.reason[40, WRIST] == Rejection.JUMP
    assert again.reason[41, WRIST] == Rejection.RESIDUAL


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


def test_a_joint_out_of_the_cameras_reach_is_rejected() -> None:
    segment = forearm()
    off = with_position(segment, slice(20, 24), WRIST, np.array([1e6, 0.0, 0.0]))
    checked = reject_by_camera(off)
    assert frames_of(rejected_for(off, checked, Rejection.FAR), WRIST) == [20, 21, 22, 23]
    assert checked.accepted[:, ELBOW].all()
