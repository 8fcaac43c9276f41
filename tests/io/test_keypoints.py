"""Keypoints of cameras without depth in files: written, read back, turned into rays by the lens."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.intrinsics import Intrinsics
from smoother.errors import RecordingError
from smoother.io import open_recording, read_recording, write_recording
from smoother.io.recording.keypoints import lens_from_plain, lens_plain
from smoother.io.recording.streams import KnownLens
from smoother.recording import CameraFrame, JointState, Recording
from smoother.simulation import ArmSimulation, simulate_arm


def made(rgb: str, **changes: object) -> Recording:
    settings = {"protocol": "random", "duration_s": 3.0, "rgb": rgb, **changes}
    return simulate_arm(ArmSimulation.preset("realistic", **settings), 911).recording


def test_rays_come_back_from_a_file(tmp_path: Path) -> None:
    recording = made("all", cameras=(75.0,))
    write_recording(recording, tmp_path / "a.mcap")
    read = read_recording(tmp_path / "a.mcap")
    assert read.camera_frame is CameraFrame.OPTICAL
    assert read.arm.name == "/camera/keypoints_2d"
    (camera,), (written,) = read.cameras, recording.cameras
    assert camera.pose is not None
    assert written.pose is not None
    np.testing.assert_allclose(camera.pose.R_K_C, written.pose.R_K_C)
    np.testing.assert_allclose(camera.pose.p_K_C_m, written.pose.p_K_C_m)
    for back, sent in ((read.arm, recording.arm), (camera.arm, written.arm)):
        assert back.pixel_rad == pytest.approx(sent.pixel_rad)
        np.testing.assert_allclose(back.position, sent.position, atol=1e-12)
        np.testing.assert_array_equal(back.state, sent.state)


def test_a_distorted_lens_is_undone(tmp_path: Path) -> None:
    """Pixels through OpenCV's distortion give the rays that they came from."""
    recording = made("first")
    write_recording(recording, tmp_path / "a.mcap")
    file = open_recording(tmp_path / "a.mcap")
    lens = Intrinsics(1280, 720, 900.0, 905.0, 640.0, 350.0, (-0.1, 0.02, 1e-3, -1e-3, 0.0))
    rays = np.asarray(recording.arm.position).reshape(-1, 3)
    pixels = lens.pixels(rays).reshape(-1, 5, 2)
    (arm,) = file.arms
    arm.position[..., :2] = np.where(arm.state[..., None] > 0, pixels, np.nan)
    file.lenses = {arm.topic: KnownLens(lens)}
    write_recording(file, tmp_path / "b.mcap")
    read = read_recording(tmp_path / "b.mcap")
    np.testing.assert_allclose(read.arm.position, recording.arm.position, atol=1e-8)
    assert read.arm.pixel_rad == pytest.approx(1.0 / 902.5)


def test_keypoints_without_a_lens_are_left_out_and_said(tmp_path: Path) -> None:
    write_recording(made("first"), tmp_path / "a.mcap")
    file = open_recording(tmp_path / "a.mcap")
    file.lenses = {}
    write_recording(file, tmp_path / "b.mcap")
    again = open_recording(tmp_path / "b.mcap")
    assert not again.arms
    assert any("lens is not known" in note for note in again.notes)
    with pytest.raises(RecordingError, match="skeleton"):
        read_recording(tmp_path / "b.mcap")


def test_keypoints_beside_their_own_skeleton_are_no_second_camera(tmp_path: Path) -> None:
    """As an import of a video writes them: the skeleton that was made of the keypoints is taken."""
    recording = made("none")
    write_recording(recording, tmp_path / "a.mcap")
    write_recording(made("first"), tmp_path / "b.mcap")
    file, flat = open_recording(tmp_path / "a.mcap"), open_recording(tmp_path / "b.mcap")
    file.arms += flat.arms
    file.lenses = flat.lenses
    write_recording(file, tmp_path / "c.mcap")
    read = read_recording(tmp_path / "c.mcap")
    assert (read.arm.name, read.cameras) == ("/skeleton", ())
    flat_one = read_recording(tmp_path / "c.mcap", skeleton="/camera/keypoints_2d")
    assert flat_one.arm.pixel_rad is not None


def test_scores_say_what_is_tracked(tmp_path: Path) -> None:
    write_recording(made("first"), tmp_path / "a.mcap")
    file = open_recording(tmp_path / "a.mcap")
    (arm,) = file.arms
    arm.state[:] = JointState.TRACKED
    arm.position[...] = [640.0, 360.0, 0.9]
    arm.position[0, 0, 2], arm.position[1, 0, 2], arm.position[2, 0, 2] = 0.05, 0.3, 0.5
    write_recording(file, tmp_path / "b.mcap")
    states = open_recording(tmp_path / "b.mcap").arms[0].state[:3, 0]
    assert states.tolist() == [JointState.NOT_TRACKED, JointState.INFERRED, JointState.TRACKED]


def test_a_lens_as_plain_values() -> None:
    lens = Intrinsics(1280, 720, 900.0, 905.0, 640.0, 350.0, (-0.1, 0.02, 0.0, 0.0, 0.0))
    assert lens_from_plain(lens_plain(lens)) == lens
    with pytest.raises(ValueError, match="no key"):
        lens_from_plain({**lens_plain(lens), "focus": 1.0})
    with pytest.raises(ValueError, match="above zero"):
        lens_from_plain({**lens_plain(replace(lens, fx=-1.0))})
