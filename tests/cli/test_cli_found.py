"""What `smooth` says of arm, sensor, clock and camera, and lever arms of a tracked strap."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.cli.run import run
from smoother.io import import_broad, read_recording, read_recovery, write_recording
from smoother.recording import Recording
from smoother.simulation import ArmSimulation, PointSimulation, simulate_arm, simulate_point


def smoothed(recording: Path, folder: Path, *more: object) -> dict:
    arguments = ["smooth", recording, "-o", folder / "out.mcap", "--json", folder / "out.json", "--force"]
    assert run([str(part) for part in (*arguments, "--processes", 1, "--draws", 0, "--verbose", *more)]) == 0
    return json.loads((folder / "out.json").read_text())


def written(recording: Recording, path: Path) -> Path:
    write_recording(recording, path)
    return path


@pytest.fixture(scope="module")
def frozen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording whose camera freezes in every occlusion and says `tracked`."""
    settings = ArmSimulation(repetitions=1, frozen_gaps=1.0, joint_bias_m=0.025)
    return written(simulate_arm(settings, 5).recording, tmp_path_factory.mktemp("frozen") / "rec.mcap")


def test_without_a_calibration(frozen, tmp_path, capsys):
    figures = smoothed(frozen, tmp_path)
    out = capsys.readouterr().out
    assert "Lever arms in the IMU's axes, mm" in out and "IMU to forearm axis" in out
    assert "the IMU's clock is " in out and "noise of the camera's joints, mm per axis: elbow " in out
    assert "constant errors of the joints against each other, mm: elbow " in out
    assert "not determined: the camera places joints some " in out
    assert "Tracked samples that were rejected" in out and "frozen: the value repeats" in out
    found = figures["found"]
    assert set(found["lever_arms"]) == {"elbow", "wrist", "hand"} and found["given"] == []
    assert found["lengths"]["forearm"]["sigma_m"] > 0 and found["clock_offsets"][0]["sigma_s"] < 0.01
    assert figures["not_determined"] == found["not_determined"] != []
    rows = [row for row in figures["rejected"] if row["reason"] == "frozen" and row["joint"] == "wrist"]
    assert rows[0]["count"] > 50 and 0.05 < rows[0]["share"] < 0.5
    assert any("repeated the one before" in sentence for sentence in figures["advice"])


def test_what_is_given_is_not_called_found(frozen, tmp_path, capsys):
    assert run(["calibrate", "motion", str(frozen), "-o", str(tmp_path / "c.toml"), "--processes", "1"]) == 0
    capsys.readouterr()
    figures = smoothed(frozen, tmp_path, "--calibration", tmp_path / "c.toml")
    out = capsys.readouterr().out
    assert "Lever arms" not in out and "the accuracy of lever arms and lengths" not in out
    assert {"elbow", "wrist", "hand", "upper_arm"} <= set(figures["found"]["given"])
    # the file remembers, so that a report made of it later says the same
    (kept,) = read_recovery(tmp_path / "out.mcap")
    assert set(kept.estimates.given) == set(figures["found"]["given"])


def test_a_strap_that_is_the_imu(tmp_path, capsys):
    recording = written(simulate_point(PointSimulation(duration_s=20), 1).recording, tmp_path / "rec.mcap")
    figures = smoothed(recording, tmp_path)
    assert figures["found"]["lever_arms"] == {} and figures["not_determined"] == []
    assert "Lever arms" not in capsys.readouterr().out
    figures = smoothed(recording, tmp_path, "--solve-lever-arms")
    assert "The tracked strap was found " in capsys.readouterr().out
    lever = figures["found"]["lever_arms"]["strap"]
    place, sigma = np.array(lever["position_m"]), np.array(lever["sigma_m"])
    assert (np.abs(place) < 4 * sigma).all() and (sigma < 0.02).all()


def test_a_strap_beside_the_imu(tmp_path):
    """The camera sees a point 3 cm beside the IMU."""
    from scipy.spatial.transform import Rotation

    simulated = simulate_point(PointSimulation(duration_s=30), 2)
    recording, true = simulated.recording, np.array([0.02, -0.02, 0.01])
    truth, arm = recording.truth, recording.arm
    nearest = np.clip(np.searchsorted(truth.t_s, arm.t_s), 0, len(truth) - 1)
    moved = arm.position.copy()
    moved[:, 4] += Rotation.from_quat(truth.quaternion[nearest], scalar_first=True).apply(true)
    path = written(replace(recording, arm=replace(arm, position=moved)), tmp_path / "rec.mcap")
    without, figures = smoothed(path, tmp_path), smoothed(path, tmp_path, "--solve-lever-arms")
    lever = figures["found"]["lever_arms"]["strap"]
    error = np.array(lever["position_m"]) - true
    assert np.linalg.norm(error) < 0.006 and (np.abs(error) < 4 * np.array(lever["sigma_m"])).all()
    noise = [each["found"]["camera_sigma_m"]["strap"] for each in (without, figures)]
    assert noise[1] <= noise[0]
    (kept,) = read_recovery(tmp_path / "out.mcap")
    error = kept.position - np.stack([np.interp(kept.t_s, truth.t_s, axis) for axis in truth.position.T], 1)
    assert np.sqrt(np.nanmean(np.sum(error[~kept.occluded] ** 2, axis=1))) < 0.01


def test_lever_arms_of_a_strap_need_one(frozen, tmp_path, capsys):
    arguments = ["smooth", str(frozen), "-o", str(tmp_path / "o.mcap"), "--solve-lever-arms"]
    assert run(arguments) == 2
    assert "a tracked strap" in capsys.readouterr().err


@pytest.mark.real
def test_an_optical_point_beside_a_real_imu(tmp_path):
    folder = os.environ.get("UNOCCLUDE_DATASETS")
    if not folder:
        pytest.skip("UNOCCLUDE_DATASETS names no folder with BROAD (broad/*.mat)")
    whole = import_broad(Path(folder) / "broad" / "07_undisturbed_fast_rotation_B.mat")
    imu, frames = whole.imu.t_s, whole.arm.t_s
    part = replace(
        whole,
        imu=whole.imu.select((imu >= 30) & (imu < 70)),
        arm=whole.arm.select((frames >= 30) & (frames < 70)),
    )
    path = written(part, tmp_path / "rec.mcap")
    assert read_recording(path).arm.present == ("strap",)
    residuals = []
    for more in ([], ["--solve-lever-arms"]):
        figures = smoothed(path, tmp_path, *more)
        (kept,) = read_recovery(tmp_path / "out.mcap")
        used = kept.residuals.used[:, 4]
        residuals.append(np.sqrt(np.mean(kept.residuals.residual[used, 4] ** 2)))
    assert residuals[1] <= residuals[0]
    assert 0.004 < np.linalg.norm(figures["found"]["lever_arms"]["strap"]["position_m"]) < 0.015


def test_marks_of_uncertain_answers():
    from arms import make_recording, make_recovery

    from smoother.cli.methods import limit_sigma
    from smoother.result.untrusted import usable

    recovery = make_recovery(make_recording(4.0), sigma_m=0.01)
    position, covariance = recovery.position.copy(), recovery.pose_covariance.copy()
    position[:10] = np.nan  # no answer
    covariance[10:30] *= 9.0
    covariance[30:35] = np.nan  # an answer that states no sigma
    recovery = replace(recovery, position=position, pose_covariance=covariance)
    assert usable(recovery).sum() == len(recovery) - 10
    assert limit_sigma(recovery, None) is recovery
    marked = limit_sigma(recovery, 0.02)
    assert np.array_equal(np.flatnonzero(~usable(marked)), np.arange(35))
    assert marked.position is recovery.position
    assert marked.notes[-1].startswith(f"25 of {len(recovery) - 10} samples are less certain than 0.02 m")
