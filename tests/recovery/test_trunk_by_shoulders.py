"""The thorax by both shoulders: a person who turns about the vertical, seen by a noisy camera."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_results import recovery
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.io import read_recovery, write_recovery
from smoother.measures.measuring import measure
from smoother.recording import JOINTS, ImuStream, JointTracks, Recording
from smoother.recovery.trunk import with_trunk
from smoother.recovery.trunk_by_shoulders import LEAN_RAD, trunk_by_shoulders
from smoother.result import Recovery
from smoother.runtime.store import Store

UP = np.array([0.1, 0.97, -0.2]) / np.linalg.norm([0.1, 0.97, -0.2])
NOISE_M, WIDTH_M = 0.01, 0.36


def turning(side: str, seed: int = 0, turn_deg: float = 30.0) -> tuple[Recovery, Recording, FloatArray]:
    """20 s of a trunk that turns to and fro; the true `R_K_T` at the samples."""
    rng = np.random.default_rng(seed)
    made = recovery(2000, seed, side=side)
    frames = np.arange(0.0, 20.0, 1 / 30)
    upright = np.linalg.qr(np.column_stack([UP, np.eye(3)[:, :2]]))[0]
    right = upright[:, 1]

    def axes(t: FloatArray) -> FloatArray:
        heading = np.radians(turn_deg) * np.sin(2 * np.pi * t / 8.0)
        z = Rotation.from_rotvec(heading[:, None] * UP).apply(right)
        return np.stack([np.cross(UP, z), np.tile(UP, (len(t), 1)), z], axis=2)

    def shoulder(where: float) -> JointTracks:
        position = np.full((len(frames), len(JOINTS), 3), np.nan)
        position[:, 0] = where * WIDTH_M * axes(frames)[:, :, 2] + rng.normal(0.0, NOISE_M, (len(frames), 3))
        state = np.where(np.isfinite(position[:, :, 0]), 2, 0).astype(np.int8)
        return JointTracks("camera", frames - 0.3, position, state)

    own, other = (shoulder(0.5), shoulder(-0.5)) if side == "right" else (shoulder(-0.5), shoulder(0.5))
    stream = ImuStream("imu", made.t_s, np.zeros((2000, 3)), np.zeros((2000, 3)))
    recording = Recording(stream, own, side, opposite=other)
    made = replace(made, gravity_direction=-UP, arm=replace(own, t_s=frames), trunk=None)
    return made, recording, axes(made.t_s)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_heading_follows_both_shoulders(side: str) -> None:
    made, recording, true = turning(side)
    trunk = trunk_by_shoulders(made, recording, Store())
    assert trunk is not None and not trunk.by_imu
    R = Rotation.from_quat(trunk.quaternion, scalar_first=True).as_matrix()
    off = Rotation.from_matrix(R @ true.transpose(0, 2, 1)).as_rotvec()
    about_up = off @ UP
    # a quarter of a second of 30 frames, each off by 10 mm at both ends of 36 cm: less than a degree
    assert np.degrees(np.sqrt(np.mean(about_up**2))) < 1.5
    np.testing.assert_allclose(off - about_up[:, None] * UP, 0.0, atol=1e-9)
    stated = np.sqrt(np.einsum("i,nij,j->n", UP, trunk.covariance, UP))
    assert (np.degrees(stated) > 1.5).all() and (np.degrees(stated) < 6.0).all()
    side_lean = np.einsum("ni,nij,nj->n", true[:, :, 0], trunk.covariance, true[:, :, 0])
    np.testing.assert_allclose(np.median(side_lean), LEAN_RAD[0] ** 2, rtol=0.05)


def test_hidden_shoulders_leave_nothing_a_second_later() -> None:
    made, recording, _ = turning("right")
    assert recording.opposite is not None
    frames = recording.opposite.t_s
    hidden = (frames > 6.0) & (frames < 12.0)
    recording = replace(recording, opposite=recording.opposite.hide(hidden, ("shoulder",)))
    trunk = trunk_by_shoulders(made, recording, Store())
    assert trunk is not None
    empty = np.isnan(trunk.quaternion[:, 0])
    # the recording's clock is 0.3 s behind the IMU's
    inside = (made.t_s > 7.35) & (made.t_s < 11.25)
    assert empty[inside].all() and not empty[(made.t_s < 6.2) | (made.t_s > 12.4)].any()
    sigma = trunk.sigma_deg
    assert sigma[np.flatnonzero(~empty & (made.t_s > 7.0))[0]] > np.median(sigma[made.t_s < 6.0])


def test_what_does_not_show_it() -> None:
    made, recording, _ = turning("right")
    assert trunk_by_shoulders(made, replace(recording, opposite=None), Store()) is None
    assert trunk_by_shoulders(made, replace(recording, side=""), Store()) is None
    blind = replace(made, gravity_direction=np.full(3, np.nan))
    assert trunk_by_shoulders(blind, recording, Store()) is None
    assert recording.opposite is not None
    never = recording.opposite.hide(np.ones(len(recording.opposite), bool), ("shoulder",))
    assert trunk_by_shoulders(made, replace(recording, opposite=never), Store()) is None


def test_a_file_keeps_where_it_comes_from(tmp_path: Path) -> None:
    made, recording, _ = turning("right")
    made = with_trunk(made, recording, Store())
    write_recovery(made, tmp_path / "a.mcap")
    (back,) = read_recovery(tmp_path / "a.mcap")
    assert back.trunk is not None and made.trunk is not None and not back.trunk.by_imu
    np.testing.assert_allclose(back.trunk.quaternion, made.trunk.quaternion, atol=1e-12)
    table = back.angles()
    assert (
        "shoulder_plane_trunk" in table.values and "shoulder_plane_trunk_deg" in back.to_table().schema.names
    )


def test_measures_still_count_the_trunk_as_upright() -> None:
    made, recording, _ = turning("right")
    with_one = with_trunk(made, recording, Store())
    assert with_one.trunk is not None
    before, after = (measure(each).by_key for each in (made, with_one))
    assert before.keys() == after.keys()
    for key, row in before.items():
        np.testing.assert_equal(row.value, after[key].value, err_msg=key)
