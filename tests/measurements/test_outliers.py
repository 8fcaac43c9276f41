"""Samples that call themselves tracked and are set aside: rule by rule, and all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pieces import ELBOW, HAND, WRIST, forearm, still_imu, with_position
from pieces import STRAP as STRAP_COLUMN
from scipy.spatial.transform import Rotation

from smoother.measurements.alignment import Alignment
from smoother.measurements.inertial import InertialSignal
from smoother.measurements.outliers import (
    BONE,
    DIRECTION,
    FROZEN,
    JUMP,
    RAY,
    REASONS,
    RESIDUAL,
    STRAP,
    by_attitude,
    by_camera,
    by_residual,
)
from smoother.measurements.segment import Piece
from smoother.recording import JOINTS, BoolArray, FloatArray
from smoother.selfcal.camera_noise import JointNoise

TURNING = np.array([0.0, 0.0, 0.5])
X = np.array([1.0, 0.0, 0.0])
RESTING = Alignment(np.zeros(1), Rotation.from_quat([[0.0, 0.0, 0.0, 1.0]]), np.eye(3)[None])


def dropped(before: Piece, after: Piece, why: str) -> BoolArray:
    """Which samples (F, 5) one reason set aside; every one that was set aside has a reason, no other has."""
    lost = before.accepted & ~after.accepted
    np.testing.assert_array_equal(after.reason != 0, lost)
    return np.asarray(after.reason == REASONS.index(why))


def frames_of(mask: BoolArray, column: int) -> list[int]:
    return np.flatnonzero(mask[:, column]).tolist()


def test_nothing_is_set_aside_from_good_samples() -> None:
    for piece in (forearm(), forearm(rate=TURNING), forearm(along=(0.0, 0.0, -1.0))):
        assert by_camera(piece) is piece


@pytest.mark.parametrize("rate", [None, TURNING], ids=["still", "turning"])
def test_a_frozen_value_only_while_the_sensor_moves(rate: FloatArray | None) -> None:
    piece = forearm(rate=rate)
    frozen = with_position(piece, slice(30, 40), WRIST, piece.position[29, WRIST])
    found = by_camera(frozen)
    rows = frames_of(dropped(frozen, found, FROZEN), WRIST)
    assert rows == ([] if rate is None else list(range(30, 40)))  # the first of the run is a measurement
    assert (found.accepted[:, ELBOW] == frozen.accepted[:, ELBOW]).all()


def test_a_value_that_repeats_once_is_not_frozen() -> None:
    piece = forearm(rate=TURNING)
    once = by_camera(with_position(piece, [30], WRIST, piece.position[29, WRIST]))
    assert once.accepted.sum() == piece.accepted.sum()


def test_a_frozen_value_while_the_sensor_is_shaken() -> None:
    """No turning, but a specific force that varies by a metre a second squared."""
    piece = forearm()
    imu = still_imu(piece.end_s)
    imu.acc[:, 0] = 4.0 * np.sin(2 * np.pi * 2.0 * imu.t_s)
    shaken = replace(piece, signal=InertialSignal(imu))
    frozen = with_position(shaken, slice(30, 45), HAND, piece.position[29, HAND])
    assert frames_of(dropped(frozen, by_camera(frozen), FROZEN), HAND) == list(range(30, 45))


@pytest.mark.parametrize(("off_m", "is_jump"), [(0.10, False), (0.25, True)])
def test_a_jump(off_m: float, is_jump: bool) -> None:
    piece = forearm()
    jumped = with_position(piece, [40, 41], HAND, piece.position[40, HAND] + [0.0, off_m, 0.0])
    found = by_camera(jumped)
    assert frames_of(dropped(jumped, found, JUMP), HAND) == ([40, 41] if is_jump else [])


def test_a_fast_arm_does_not_jump() -> None:
    """Four metres a second, 13 cm a frame, straight on: far from its neighbours and still right."""
    piece = forearm()
    position = piece.position + np.outer(4.0 * piece.frame_t, X)[:, None]
    fast = replace(piece, position=position)
    found = by_camera(fast)
    assert found.accepted.sum() == fast.accepted.sum()


def test_the_far_side_of_a_gap_does_not_jump() -> None:
    piece = forearm()
    position, accepted = piece.position.copy(), piece.accepted.copy()
    accepted[40:70] = False
    position[70:] += [0.0, 0.5, 0.0]
    gap = replace(piece, position=position, accepted=accepted)
    assert by_camera(gap).accepted.sum() == accepted.sum()


@pytest.mark.parametrize(("part", "wrong"), [(0.8, False), (1.25, False), (0.6, True), (1.4, True)])
def test_the_bone_s_length(part: float, wrong: bool) -> None:
    piece = forearm()
    elbow, wrist = piece.position[50, ELBOW], piece.position[50, WRIST]
    # a long run, so that no median of neighbours calls it a jump
    off = with_position(piece, slice(40, 60), WRIST, elbow + part * (wrist - elbow))
    mask = dropped(off, by_camera(off), BONE)
    expected = list(range(40, 60)) if wrong else []
    assert frames_of(mask, WRIST) == expected
    assert frames_of(mask, ELBOW) == expected
    assert frames_of(mask, HAND) == []


@pytest.mark.parametrize(
    ("across_m", "part", "wrong"),
    [(0.04, 0.8, False), (0.06, 0.8, True), (0.0, 0.6, False), (0.0, 0.4, True)],
)
def test_the_strap_on_the_forearm_s_line(across_m: float, part: float, wrong: bool) -> None:
    piece = forearm()
    elbow, wrist = piece.position[50, ELBOW], piece.position[50, WRIST]
    place = elbow + part * (wrist - elbow) + [0.0, across_m, 0.0]
    off = with_position(piece, slice(40, 60), STRAP_COLUMN, place)
    assert frames_of(dropped(off, by_camera(off), STRAP), STRAP_COLUMN) == (
        list(range(40, 60)) if wrong else []
    )


@pytest.mark.parametrize(("degrees", "wrong"), [(25.0, False), (35.0, True), (180.0, True)])
def test_the_direction_against_the_inertial_one(degrees: float, wrong: bool) -> None:
    piece = forearm()
    along = Rotation.from_rotvec([0.0, np.radians(degrees), 0.0]).apply(X)
    found = by_attitude(piece, piece.frame_t, RESTING, along)
    mask = dropped(piece, found, DIRECTION)
    for column in (ELBOW, WRIST, HAND):
        assert mask[:, column].all() == wrong
        assert mask[:, column].any() == wrong


@pytest.mark.parametrize(
    ("degrees", "part", "wrong"),
    [(0.0, 1.0, False), (10.0, 1.0, False), (20.0, 1.0, True), (0.0, 0.9, False), (0.0, 0.8, True)],
)
def test_the_viewing_ray_only_where_it_is_misjudged(degrees: float, part: float, wrong: bool) -> None:
    """A forearm that points at the camera, seen as it is, a little turned, or shortened in 20 frames."""
    piece = forearm(along=(0.0, 0.0, -1.0))
    inertial = np.array([0.0, 0.0, -1.0])
    elbow, wrist = piece.position[:, ELBOW], piece.position[:, WRIST]
    turned = Rotation.from_rotvec([np.radians(degrees), 0.0, 0.0]).apply(wrist - elbow)
    off = with_position(piece, slice(40, 60), WRIST, (elbow + part * turned)[40:60])
    mask = dropped(off, by_attitude(off, off.frame_t, RESTING, inertial), RAY)
    assert frames_of(mask, WRIST) == (list(range(40, 60)) if wrong else [])


def test_off_the_ray_the_ray_s_rule_is_silent() -> None:
    piece = forearm()  # across the view
    elbow, wrist = piece.position[:, ELBOW], piece.position[:, WRIST]
    turned = Rotation.from_rotvec([0.0, np.radians(20.0), 0.0]).apply(wrist - elbow)
    off = with_position(piece, slice(40, 60), WRIST, (elbow + 0.8 * turned)[40:60])
    assert by_attitude(off, off.frame_t, RESTING, X).accepted[:, WRIST].all()


@pytest.mark.parametrize(
    ("sample_m", "off_m", "wrong"),
    [(0.001, 0.04, False), (0.001, 0.06, True), (0.02, 0.09, False), (0.02, 0.11, True)],
)
def test_a_residual_in_metres_and_in_deviations(sample_m: float, off_m: float, wrong: bool) -> None:
    piece = forearm()
    residual = np.zeros((*piece.accepted.shape, 3))
    residual[20, WRIST] = [off_m, 0.0, 0.0]
    residual[30, HAND] = [1.0, 0.0, 0.0]  # its noise is not known: no judgement
    residual[40] = np.nan
    found = by_residual(piece, residual, {"wrist": JointNoise(sample_m, sample_m, 0.0)})
    mask = dropped(piece, found, RESIDUAL)
    assert np.argwhere(mask).tolist() == ([[20, WRIST]] if wrong else [])


def test_the_first_reason_is_kept() -> None:
    piece = forearm()
    jumped = with_position(piece, [40], WRIST, piece.position[40, WRIST] + [0.0, 0.3, 0.0])
    found = by_camera(jumped)
    assert found.reason[40, WRIST] == REASONS.index(JUMP)
    residual = np.full((*piece.accepted.shape, 3), 1.0)
    again = by_residual(found, residual, {"wrist": JointNoise(0.01, 0.01, 0.0)})
    assert again.reason[40, WRIST] == REASONS.index(JUMP)
    assert again.reason[41, WRIST] == REASONS.index(RESIDUAL)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    spread=st.sampled_from([0.001, 0.05, 1.0]),
    kept=st.floats(0.0, 1.0),
    frames=st.integers(2, 40),
    turning=st.booleans(),
)
def test_screening_only_ever_takes_away(
    seed: int, spread: float, kept: float, frames: int, turning: bool
) -> None:
    """Whatever the samples are: nothing comes back, every loss has a reason, the data stay as they were."""
    rng = np.random.default_rng(seed)
    piece = forearm(frames, rate=TURNING if turning else None)
    position = piece.position + spread * rng.normal(size=piece.position.shape)
    repeat = rng.uniform(size=frames) < 0.3
    for k in np.flatnonzero(repeat[1:]) + 1:
        position[k] = position[k - 1]
    accepted = piece.accepted & (rng.uniform(size=piece.accepted.shape) < kept)
    piece = replace(piece, position=position, accepted=accepted)
    noise = {joint: JointNoise(0.01, 0.01, 0.0) for joint in JOINTS}
    residual = rng.normal(size=position.shape) * spread
    one = by_camera(piece)
    two = by_attitude(one, piece.frame_t, RESTING, X)
    three = by_residual(two, residual, noise)
    for before, after in ((piece, one), (one, two), (two, three)):
        assert not (after.accepted & ~before.accepted).any()
        lost = before.accepted & ~after.accepted
        assert (after.reason[lost] != 0).all()
        np.testing.assert_array_equal(after.reason[~lost], before.reason[~lost])
        assert after.position is piece.position
