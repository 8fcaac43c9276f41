"""Recordings that others made: BROAD, UTD-MHAD, and four people of it who do the same at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from smoother.errors import RecordingError
from smoother.io import import_broad, import_utd_mhad, open_recording, read_recording, write_recording
from smoother.io.recording.choose import match_file
from smoother.recording import CameraFrame, JointState

pytestmark = pytest.mark.real


def test_broad(datasets: Path, tmp_path: Path) -> None:
    trial = sorted((datasets / "broad").glob("*.mat"))[0]
    made = import_broad(trial)
    assert made.arm.present == ("strap",) and made.camera_frame is CameraFrame.ZUP
    assert made.imu.rate_hz == pytest.approx(285.714, abs=0.01) and made.arm.rate_hz == pytest.approx(30)
    rest = np.linalg.norm(made.imu.acc, axis=1)
    assert 9.7 < np.median(rest) < 10
    assert made.truth is not None and made.truth.score.any() and not made.truth.score.all()
    seen = made.arm.tracked("strap")
    truth = np.stack(
        [np.interp(made.arm.t_s, made.truth.t_s, axis) for axis in made.truth.position.T], axis=1
    )
    error = (made.arm.joint("strap") - truth)[seen]
    assert np.nanstd(error) == pytest.approx(0.008, rel=0.05)
    assert made.arm.state[~seen].max(initial=0) == JointState.NOT_TRACKED
    write_recording(made, tmp_path / "a.mcap")
    found = read_recording(tmp_path / "a.mcap")
    np.testing.assert_array_equal(found.imu.acc, made.imu.acc)
    np.testing.assert_array_equal(found.arm.position, made.arm.position)
    assert found.truth is not None
    np.testing.assert_array_equal(found.truth.score, made.truth.score)
    again = import_broad(trial, seed=1)
    assert np.nanmax(np.abs(again.arm.position - made.arm.position)) > 0


def test_other_files_are_refused(datasets: Path, tmp_path: Path) -> None:
    skeleton = datasets / "utd_mhad" / "Skeleton" / "a1_s1_t1_skeleton.mat"
    with pytest.raises(RecordingError, match="not a trial of BROAD"):
        import_broad(skeleton)
    with pytest.raises(RecordingError, match=r"lacks d_iner"):
        import_utd_mhad(skeleton, skeleton)
    (tmp_path / "x.mat").write_text("nothing")
    with pytest.raises(RecordingError, match="cannot be read as a Matlab file"):
        import_broad(tmp_path / "x.mat")


@pytest.mark.slow
@pytest.mark.parametrize("action", [2, 8, 13, 20])
def test_four_at_once(datasets: Path, tmp_path: Path, action: int) -> None:
    folder = datasets / "utd_mhad"
    group = [
        import_utd_mhad(
            folder / "Inertial" / f"a{action}_s{subject}_t3_inertial.mat",
            folder / "Skeleton" / f"a{action}_s{subject}_t3_skeleton.mat",
        )
        for subject in range(1, 5)
    ]
    write_recording(group, tmp_path / "four.mcap")
    matches, _ = match_file(open_recording(tmp_path / "four.mcap"))
    assert [match.imu for match in matches] == [
        "/imu/forearm_right" + suffix for suffix in ("", "_2", "_3", "_4")
    ]
    # Found by motion alone, though the names say `forearm_right` of all four.
    assert [(m.limb and m.limb.body, m.joint) for m in matches] == [(b, "wrist_right") for b in range(4)]
