"""TRC and C3D exports, read back by a plain parser, by ezc3d, and by the project's own readers."""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from results import HIDDEN, export, jittered, made, read_trc, without_answer
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from smoother.errors import UnoccludeError
from smoother.io.export import prepare_export
from smoother.io.export.markers import MOST_FRAMES, write_c3d
from smoother.recording import JOINTS, JointState

AFTER = ["shoulder", "elbow", "wrist", "hand", "imu"]
BEFORE = [f"camera_{joint}" for joint in JOINTS[:4]]
#: Half a unit of the last decimal of a TRC file, m; and of a float of 4 m in mm in a C3D file.
TRC_M, C3D_M = 0.51e-9, 1.3e-7


def read_c3d(path: Path) -> tuple[dict, list[str], np.ndarray, np.ndarray]:
    """Parameters, names, positions (N, M, 3) m and residuals (N, M)."""
    file = ezc3d.c3d(str(path))
    parameters = file["parameters"]
    assert parameters["POINT"]["UNITS"]["value"] == ["mm"]
    position = np.moveaxis(file["data"]["points"][:3], (0, 1, 2), (2, 1, 0)) / 1000
    channels = dict(zip(parameters["ANALOG"]["LABELS"]["value"], file["data"]["analogs"][0], strict=True))
    parameters = {group: dict(parameters[group]) for group in parameters} | {"channels": channels}
    residual = file["data"]["meta_points"]["residuals"][0].T
    return parameters, parameters["POINT"]["LABELS"]["value"], position, residual


def test_trc_holds_every_recovered_sample_and_is_blank_where_the_camera_had_nothing(tmp_path):
    recovery = made()
    header, names, t_s, position = read_trc(export(recovery, tmp_path / "a.trc", frame="camera"))
    assert header["Units"] == "mm"
    assert float(header["DataRate"]) == pytest.approx(80)
    assert (int(header["NumFrames"]), int(header["NumMarkers"])) == (len(recovery), len(names))
    assert names == AFTER + BEFORE
    np.testing.assert_allclose(t_s, recovery.t_s, atol=TRC_M)
    for number, name in enumerate(AFTER):
        true = recovery.position if name == "imu" else recovery.joints[name]
        np.testing.assert_allclose(position[:, number] / 1000, true, atol=TRC_M)
    wrist = position[:, names.index("camera_wrist")] / 1000
    frames = recovery.arm.t_s[recovery.arm.tracked("wrist")]
    for start, end in HIDDEN:
        last, first = frames[frames <= start].max(), frames[frames >= end].min()
        assert np.isnan(wrist[(t_s > last + 1e-6) & (t_s < first - 1e-6)]).all()
    gaps = np.concatenate([[True], np.isnan(wrist[:, 0]), [True]])
    assert (np.diff(gaps.astype(int)) == -1).sum() == 3  # one stretch before, between and after
    # Where a row and a frame meet, the row has the frame: no other value comes from anywhere else.
    there = recovery.arm.joint("wrist")[recovery.arm.tracked("wrist")]
    straight = np.stack([np.interp(t_s, frames, there[:, k]) for k in range(3)], axis=1)
    seen = np.isfinite(wrist[:, 0])
    np.testing.assert_allclose(wrist[seen], straight[seen], atol=TRC_M)
    shoulder = position[:, names.index("camera_shoulder")]
    inside = (t_s >= recovery.arm.t_s[0]) & (t_s <= recovery.arm.t_s[-1])
    assert np.isfinite(shoulder[inside]).all()


def test_a_frame_that_stands_alone_is_not_lost(tmp_path):
    recovery = made()
    arm = recovery.arm.hide(np.arange(len(recovery.arm)) % 2 == 1)
    _, names, _, position = read_trc(export(replace(recovery, arm=arm), tmp_path / "a.trc", frame="camera"))
    wrist = position[:, names.index("camera_wrist")] / 1000
    kept = arm.joint("wrist")[arm.tracked("wrist")]
    has = np.isfinite(wrist[:, 0])
    assert has.sum() == len(kept)
    np.testing.assert_allclose(wrist[has], kept, atol=TRC_M)


@pytest.mark.parametrize("down", [[0.1, -0.98, 0.15], [0.0, 0.97, -0.2], [0.05, 0.02, -1.0]])
def test_opensim_axes_have_y_up(tmp_path, down):
    down = np.array(down) / np.linalg.norm(down)
    recovery = replace(made(), gravity_direction=down)
    *_, before = read_trc(export(recovery, tmp_path / "a.trc", frame="camera"))
    *_, after = read_trc(export(recovery, tmp_path / "b.trc"))
    whole = np.isfinite(before).all(axis=2)
    turn, _ = Rotation.align_vectors(after[whole], before[whole])
    np.testing.assert_allclose(turn.apply(before[whole]), after[whole], atol=1e-5)  # a rotation and no more
    np.testing.assert_allclose(turn.apply(down), [0, -1, 0], atol=1e-9)
    camera_looks = turn.apply([0.0, 0.0, 1.0] if abs(down[2]) < 0.8 else [-1.0, 0.0, 0.0])
    assert camera_looks[0] < -0.9  # x points from the person to the camera
    assert abs(camera_looks[2]) < 1e-9


def test_c3d_flags_what_is_recovered(tmp_path):
    recovery = without_answer(made("left"), 9.5, 10.5)
    state = recovery.arm.state.copy()
    guessed = (recovery.arm.t_s > 14) & (recovery.arm.t_s < 15)
    state[guessed, JOINTS.index("wrist")] = JointState.INFERRED
    recovery = replace(recovery, arm=replace(recovery.arm, state=state))
    parameters, labels, _, residual = read_c3d(export(recovery, tmp_path / "a.c3d"))
    wrist, before = labels.index("wrist"), labels.index("camera_wrist")
    gone = np.isnan(recovery.joints["wrist"][:, 0])
    assert gone.sum() == 79
    np.testing.assert_array_equal(residual[:, wrist], np.where(gone, -1, np.where(recovery.occluded, 0, 1)))
    channels = parameters["channels"]
    np.testing.assert_array_equal(channels["occluded"], recovery.occluded)
    np.testing.assert_array_equal(channels["usable"], ~gone)
    np.testing.assert_allclose(channels["sigma_wrist"], np.where(gone, -1, 10), rtol=1e-6)  # mm
    t_s = recovery.t_s
    assert (residual[(t_s > 14.05) & (t_s < 14.95), before] == 0).all()  # a guess of the camera's
    assert (residual[(t_s > 15.1) & (t_s < 19), before] == 1).all()
    assert (residual[(t_s > 4.05) & (t_s < 4.95), before] == -1).all()
    descriptions = parameters["POINT"]["DESCRIPTIONS"]["value"]
    assert descriptions[wrist] == "recovered"
    assert "camera" in descriptions[before]
    events = parameters["EVENT"]
    times = 60 * events["TIMES"]["value"][0] + events["TIMES"]["value"][1]
    expected = [time for gap in recovery.gaps for time in (gap.start_s, gap.end_s)]
    assert len(expected) == 2 * len(HIDDEN) + 2 * sum(gap.open_start or gap.open_end for gap in recovery.gaps)
    np.testing.assert_allclose(times, expected, atol=1e-5)  # single precision
    assert events["LABELS"]["value"] == ["gap start", "gap end"] * len(recovery.gaps)
    assert set(events["CONTEXTS"]["value"]) == {"Left"}
    assert events["USED"]["value"].tolist() == [len(times)]


def test_uneven_stamps_come_to_a_constant_step(tmp_path):
    recovery = made()
    uneven = jittered(recovery)
    assert np.ptp(np.diff(uneven.t_s)) > 0.001
    for rate in (None, 100.0, 30.0):
        header, names, t_s, position = read_trc(
            export(uneven, tmp_path / f"{rate}.trc", frame="camera", rate_hz=rate)
        )
        step = 1 / float(header["DataRate"])
        assert 1 / step == pytest.approx(rate or 80, rel=0.01)
        np.testing.assert_allclose(np.diff(t_s), step, atol=2e-9)
        # The hand-made path is white noise of 2 mm between samples; the spline follows its samples.
        true = CubicSpline(uneven.t_s, uneven.joints["wrist"])(t_s)
        far = np.abs(uneven.t_s[:, None] - t_s[None]).min(axis=0) < 0.0126  # no hole of two samples
        np.testing.assert_allclose(position[far, names.index("wrist")] / 1000, true[far], atol=2e-3)


def test_too_many_frames_for_a_c3d_and_too_few_samples(tmp_path):
    recovery = made()
    with pytest.raises(UnoccludeError, match=r"at most 65535 frames.*give --rate 3278\.\d+ or less"):
        prepare_export(recovery, "c3d", rate_hz=4000.0)
    with pytest.raises(UnoccludeError, match="65535"):
        write_c3d(tmp_path / "a.c3d", ["a"], np.zeros((MOST_FRAMES + 1, 1, 3)), 100.0)
    with pytest.raises(UnoccludeError, match="1 samples are too few"):
        prepare_export(replace(recovery, t_s=recovery.t_s[:1]), "c3d")
    write_c3d(tmp_path / "b.c3d", ["a"], np.ones((MOST_FRAMES, 1, 3)), 100.0)
    assert ezc3d.c3d(str(tmp_path / "b.c3d"))["data"]["points"].shape == (4, 1, MOST_FRAMES)
    assert os.listdir(tmp_path) == ["b.c3d"]


@pytest.mark.parametrize("suffix", ["trc", "c3d", "mot", "parquet"])
def test_a_full_disk_leaves_nothing(tmp_path, monkeypatch, suffix):
    ready = prepare_export(made(), suffix)

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(UnoccludeError, match="no space left on the disk"):
        ready.write(tmp_path / f"a.{suffix}", False)
    assert os.listdir(tmp_path) == []


def test_a_c3d_that_was_cut_short_is_noticed(tmp_path, monkeypatch):
    """ezc3d returns without a word when the disk is full."""
    whole = ezc3d.c3d.write

    def cut(self, path, **options):
        whole(self, path, **options)
        os.truncate(path, os.path.getsize(path) - 700)

    monkeypatch.setattr(ezc3d.c3d, "write", cut)
    with pytest.raises(UnoccludeError, match="no space left on the disk"):
        prepare_export(made(), "c3d").write(tmp_path / "a.c3d", False)
    assert os.listdir(tmp_path) == []
