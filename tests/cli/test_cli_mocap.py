"""The protocol through files alone: recording, C3D or TRC, calibration; against the built-in truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smoother.cli.run import run


def done(arguments: list[object]) -> None:
    assert run([str(each) for each in arguments]) == 0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated protocol with its motion capture, recovered."""
    where = tmp_path_factory.mktemp("mocap")
    simulate = ["simulate", "arm", "-o", where / "a.mcap", "--mocap", "--calibration-out", where / "cal.toml"]
    done([*simulate, "--repetitions", 1, "--seed", 4, "--json", where / "sim.json"])
    done(
        [
            "smooth",
            where / "a.mcap",
            "-o",
            where / "out.mcap",
            "--calibration",
            where / "cal.toml",
            "--draws",
            0,
        ]
    )
    return where


def validated(folder: Path, truth: str, *more: object) -> dict:
    json_file = folder / "v.json"
    arguments = ["validate", folder / "out.mcap", "--truth", folder / truth, "--json", json_file, "--force"]
    done([*arguments, *more])
    return json.loads(json_file.read_text())


@pytest.fixture(scope="module")
def built_in(folder: Path) -> dict:
    return validated(folder, "a.mcap")


@pytest.mark.parametrize("kind", ["c3d", "trc"])
def test_files_give_the_errors_of_the_built_in_truth(folder, built_in, capsys, kind):
    with_files = validated(
        folder, f"a.{kind}", "--markers", folder / "a_markers.toml", "--calibration", folder / "cal.toml"
    )
    assert built_in["alignment"] == "none"
    assert with_files["alignment"] == "calibration"
    for part in ("all", "occluded", "visible"):
        one, other = built_in[part], with_files[part]
        assert other["position_rms_m"] == pytest.approx(one["position_rms_m"], abs=1e-4)
        assert other["orientation_rms_deg"] == pytest.approx(one["orientation_rms_deg"], abs=0.02)
        # single samples carry the markers' own noise (0.2 mm)
        assert other["position_max_m"] == pytest.approx(one["position_max_m"], abs=4e-4)
        assert other["orientation_max_deg"] == pytest.approx(one["orientation_max_deg"], abs=0.2)
    for joint in ("elbow", "wrist"):
        one, other = built_in["points"][joint]["all"], with_files["points"][joint]["all"]
        assert other["position_rms_m"] == pytest.approx(one["position_rms_m"], abs=1e-4)
    assert set(with_files["angles_deg"]["all"]) >= {"elbow_flexion", "pronation", "shoulder_elevation"}
    assert "frame from the calibration" in " ".join(capsys.readouterr().out.split())


def test_without_a_calibration_it_is_aligned_and_said(folder, capsys):
    found = validated(folder, "a.c3d", "--markers", folder / "a_markers.toml")
    made = json.loads((folder / "sim.json").read_text())["mocap"]
    assert found["alignment"] == "solved"
    assert found["clock"]["offset_s"] == pytest.approx(made["offset_s"], abs=2e-3)
    assert 0 < found["clock"]["sigma_s"] < 1e-3
    to_kinect = Rotation.from_matrix(np.diag([-1.0, -1.0, 1.0]))
    stated = to_kinect * Rotation.from_quat(made["rotation"], scalar_first=True)
    solved = Rotation.from_quat(found["camera_from_mocap"]["rotation"], scalar_first=True)
    assert np.degrees((solved * stated.inv()).magnitude()) < 0.5
    # 5 mm where the arm is: some 2 m before the camera
    arm = np.array([0.0, 0.0, 2.0])
    in_mocap = stated.inv().apply(arm - to_kinect.apply(made["translation"]))
    there = solved.apply(in_mocap) + found["camera_from_mocap"]["translation"]
    assert np.linalg.norm(there - arm) < 0.005
    printed = " ".join(capsys.readouterr().out.split())
    # every table says it
    aligned = "aligned: frame and clock of the truth solved from this recording"
    assert printed.count(aligned) >= printed.count("┏") > 1


def test_refused_in_a_sentence(folder, tmp_path, capsys):
    wrong = tmp_path / "map.toml"
    wrong.write_text('[markers]\nwrist = ["WR_RAD", "STYLOID"]\n')
    out, truth = folder / "out.mcap", folder / "a.c3d"
    assert run(["validate", str(out), "--truth", str(truth), "--markers", str(wrong)]) == 1
    said = capsys.readouterr().err
    assert "no marker 'STYLOID'" in said
    assert "WR_ULN" in said
    assert run(["validate", str(out), "--truth", str(truth)]) == 1
    assert "--markers MAP.toml" in capsys.readouterr().err
    bare = tmp_path / "cal.toml"
    bare.write_text('format = "unocclude calibration"\nversion = 1\n')
    chosen = ["--markers", str(folder / "a_markers.toml"), "--calibration", str(bare)]
    assert run(["validate", str(out), "--truth", str(truth), *chosen]) == 1
    assert "camera_from_mocap" in capsys.readouterr().err
