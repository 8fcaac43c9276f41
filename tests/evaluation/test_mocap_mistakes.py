"""Motion captures that are not what they are given for: other units, other trials, cut files, odd plates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arms import make_recording, make_recovery, path
from scipy.spatial.transform import Rotation
from test_mocap import MAP, NAMES, captured

from smoother.errors import RecordingError
from smoother.evaluation.reference import read_reference
from smoother.evaluation.truth import read_truth
from smoother.evaluation.validate import validate
from smoother.io.export.markers import C3dContent, write_c3d, write_trc
from smoother.io.markers import read_markers
from smoother.recording import CameraFrame


@pytest.fixture(scope="module")
def recovery():
    return make_recovery(make_recording(), error_m=0.002)


def written(folder: Path, t: np.ndarray, markers: np.ndarray, text: str = MAP) -> dict[str, Path]:
    write_trc(folder / "m.trc", NAMES, t, markers, 120.0, True)
    (folder / "map.toml").write_text(text)
    return {"path": folder / "m.trc", "markers": folder / "map.toml"}


@pytest.mark.parametrize("factor", [1000.0, 0.001, 10.0, 1 / 25.4])
def test_a_wrong_unit_shows_by_the_bones(tmp_path, recovery, factor):
    t, markers = captured(np.random.default_rng(1))
    with pytest.raises(RecordingError, match=r"elbow and wrist are .* m apart; check .* unit, mm"):
        read_reference(recovery=recovery, **written(tmp_path, t, factor * markers))


def test_a_marker_of_another_body_on_the_plate_is_refused(tmp_path, recovery):
    t, markers = captured(np.random.default_rng(1))
    text = MAP.replace('["P1", "P2", "P3", "P4", "P5"]', '["P1", "P2", "SHO"]')
    with pytest.raises(RecordingError, match=r"\(P1, P2, SHO\) do not move as one body"):
        read_reference(recovery=recovery, **written(tmp_path, t, markers, text))


def test_another_trial_of_the_same_rhythm_is_refused(tmp_path, recovery):
    t, markers = captured(np.random.default_rng(1))
    # the same movements, each begun up to 0.6 s earlier or later
    rows = np.clip(np.searchsorted(t, t + 0.6 * np.sin(1.7 * t)), 0, len(t) - 1)
    with pytest.raises(RecordingError, match=r"agree nowhere .best correlation 0\.\d\d, 0.8 is needed"):
        read_reference(recovery=recovery, **written(tmp_path, t, markers[rows]))


def test_a_second_of_mocap_is_too_little_for_a_clock(tmp_path, recovery):
    t, markers = captured(np.random.default_rng(1))
    few = slice(600, 700)
    with pytest.raises(RecordingError, match=r"is known for less than 1\.0 s together"):
        read_reference(recovery=recovery, **written(tmp_path, t[few], markers[few]))


def test_a_calibration_of_another_place_is_said(tmp_path, recovery):
    t, markers = captured(np.random.default_rng(1))
    files = written(tmp_path, t, markers)
    (tmp_path / "cal.toml").write_text(
        "[camera_from_mocap]\nrotation = [1, 0, 0, 0]\ntranslation = [0, 0, 0]\n"
    )
    frame = {"calibration": tmp_path / "cal.toml", "camera_frame": CameraFrame.KINECT}
    truth, alignment = read_reference(recovery=recovery, **files, **frame)
    assert any("m (median) from where the camera saw it" in note for note in alignment.notes)
    # the error is not taken for the sensor's place on the plate
    assert any("farther than a plate reaches" in note for note in alignment.notes)
    assert validate(recovery, truth, alignment).all.position_rms_m > 0.5


@pytest.mark.parametrize(("place", "said"), [((0, 0, 0), "is taken as"), ((0.02, 0, 0.01), "was solved")])
def test_the_plates_mean_is_the_sensor_where_nothing_tells_otherwise(tmp_path, recovery, place, said):
    t, markers = captured(np.random.default_rng(1), mount=Rotation.from_rotvec([0, 0, 1.0]), place=place)
    truth, alignment = read_reference(recovery=recovery, **written(tmp_path, t, markers))
    assert any(said in note and "[imu_plate]" in note for note in alignment.notes)
    # against the motion itself: the frame is solved, 2 mm of noise on thousands of samples
    inside = (truth.t_s > 1) & (truth.t_s < 19) & np.isfinite(truth.position).all(axis=1)
    off = np.linalg.norm(truth.position[inside] - path(truth.t_s[inside]), axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.003


@pytest.mark.parametrize("share", [0.98, 0.5, 0.1])
def test_a_c3d_file_that_is_cut_off_is_refused(tmp_path, share):
    t, markers = captured(np.random.default_rng(1))
    whole = tmp_path / "whole.c3d"
    write_c3d(whole, C3dContent(NAMES, markers, 120.0))
    assert len(read_markers(whole)) == len(t)
    cut = tmp_path / "cut.c3d"
    data = whole.read_bytes()
    cut.write_bytes(data[: int(share * len(data))])
    with pytest.raises(
        RecordingError, match=r"cut.c3d: the C3D file is cut off: it contains \d+ % of the frames"
    ):
        read_markers(cut)


def test_a_trc_file_that_is_cut_off_is_said_and_its_torn_line_left_out(tmp_path):
    t, markers = captured(np.random.default_rng(1), lost=0)
    files = written(tmp_path, t, markers)
    text = files["path"].read_text()
    files["path"].write_text(text[: len(text) // 2 - 30])
    found = read_markers(files["path"])
    assert 0.4 * len(t) < len(found) < 0.5 * len(t)
    assert any("it may be cut off" in note for note in found.notes)
    # what is left is what was written, to the format's five decimals of a millimetre
    assert np.abs(found.position - markers[: len(found)]).max() < 1e-7


def test_a_truth_of_another_kind_names_all_kinds(recovery, tmp_path):
    with pytest.raises(RecordingError, match=r"\.c3d or \.trc .*\.mcap or \.csv"):
        read_truth(tmp_path / "truth.xlsx", recovery)
