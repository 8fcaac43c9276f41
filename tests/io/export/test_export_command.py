"""`unocclude export` over formats, sides and axes, `simulate arm --mocap`, and what docs/exports.md says."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done, refused
from results import made, read_mot, read_trc, without_answer

from smoother.io import write_recovery
from smoother.io.export.prepare import prepare_export

FORMATS = ("csv", "trc", "mot", "c3d", "parquet")


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    """Results of a left arm, a right arm, both, a strap alone, a method without gravity, and no answer."""
    folder = tmp_path_factory.mktemp("results")
    left, right = made("left"), without_answer(made("right"), 9.5, 10.5)
    write_recovery(left, folder / "left.mcap")
    write_recovery(right, folder / "right.mcap")
    write_recovery([left, right], folder / "both.mcap")
    write_recovery(made(strap=True), folder / "strap.mcap")
    hold = replace(made("right"), method="hold", gravity_direction=np.full(3, np.nan))
    write_recovery(hold, folder / "hold.mcap")
    write_recovery(without_answer(made("right"), -1, 100), folder / "nothing.mcap")
    return folder


@pytest.mark.parametrize("format_name", FORMATS)
@pytest.mark.parametrize("arm", ["left", "right", "both"])
def test_every_format_of_every_arm(results, tmp_path, format_name, arm):
    output = tmp_path / f"a.{format_name}"
    done(
        *("export", results / f"{arm}.mcap", "--format", format_name),
        *("-o", output, "--json", tmp_path / "j.json"),
    )
    names = [f"a_left.{format_name}", f"a_right.{format_name}"] if arm == "both" else [output.name]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*names, "j.json"])
    figures = json.loads((tmp_path / "j.json").read_text())["files"]
    assert [Path(row["file"]).name for row in figures] == names
    assert all(row["rows"] == 1600 for row in figures)
    assert {row["frame"] for row in figures} == {{"trc": "opensim", "mot": None}.get(format_name, "camera")}


@pytest.mark.parametrize("format_name", FORMATS)
@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("strap", "it has no shoulder, no elbow, no wrist; export to csv, trc"),
        ("nothing", "joint angles need shoulder, elbow and wrist"),
    ],
)
def test_a_strap_alone_and_no_answer_at_all(results, tmp_path, capsys, format_name, name, sentence):
    output = tmp_path / f"a.{format_name}"
    command = ("export", results / f"{name}.mcap", "--format", format_name, "-o", output)
    if format_name == "mot":
        assert sentence in refused(capsys, *command)
        assert list(tmp_path.iterdir()) == []
    else:
        done(*command)


def test_one_arm_that_cannot_leaves_none(tmp_path, capsys):
    write_recovery([made("left"), made(strap=True)], tmp_path / "mixed.mcap")
    said = refused(capsys, "export", tmp_path / "mixed.mcap", "--format", "mot", "-o", tmp_path / "a.mot")
    assert "joint angles need" in said
    assert [path.name for path in tmp_path.iterdir()] == ["mixed.mcap"]


def test_no_gravity(results, tmp_path, capsys):
    command = ("export", results / "hold.mcap", "-o", tmp_path / "a.trc", "--format", "trc")
    said = refused(capsys, *command)
    assert "'hold' found no gravity" in said and "--frame camera" in said
    done(*command, "--frame", "camera")
    done("export", results / "hold.mcap", "-o", tmp_path / "a.c3d", "--format", "c3d")


def test_no_gravity_but_a_camera_that_says_its_axes(tmp_path, capsys):
    from arms import make_recording

    from smoother.io import write_recording
    from smoother.recording import CameraFrame

    source = replace(make_recording(), camera_frame=CameraFrame.OPTICAL)
    write_recording(source, tmp_path / "rec.mcap")
    hold = replace(made("right"), method="hold", gravity_direction=np.full(3, np.nan))
    write_recovery(hold, tmp_path / "hold.mcap", source=tmp_path / "rec.mcap")
    for frame in ("camera", "opensim"):
        name = tmp_path / f"{frame}.trc"
        done("export", tmp_path / "hold.mcap", "--format", "trc", "--frame", frame, "-o", name)
    assert "the camera is assumed level" in capsys.readouterr().out
    *_, camera = read_trc(tmp_path / "camera.trc")
    *_, level = read_trc(tmp_path / "opensim.trc")
    # Optical: x right, y down, z forward. OpenSim: x to the camera, y up, z right of who faces it.
    expected = np.stack([-camera[..., 2], -camera[..., 1], -camera[..., 0]], axis=-1)
    np.testing.assert_allclose(level, expected, atol=1e-6)


@pytest.mark.parametrize("format_name", ["trc", "mot", "c3d"])
def test_rate(results, tmp_path, format_name):
    output = tmp_path / f"a.{format_name}"
    done(
        *("export", results / "left.mcap", "--format", format_name, "-o", output, "--rate", "20"),
        *("--json", tmp_path / "j.json"),
    )
    (row,) = json.loads((tmp_path / "j.json").read_text())["files"]
    assert (row["rate_hz"], row["rows"]) == (20, 400)
    if format_name == "mot":
        _, _, table = read_mot(output)
        np.testing.assert_allclose(np.diff(table[:, 0]), 0.05, atol=2e-9)


@pytest.mark.parametrize("side", ["left", "right"])
def test_simulated_mocap_beside_its_recording(tmp_path, side):
    import ezc3d
    from scipy.spatial.transform import Rotation

    done(
        *("simulate", "arm", "-o", tmp_path / "sim.mcap", "--mocap", "--set", f"side={side}", "--seed", 3),
        *(
            "--set",
            "protocol=random",
            "--set",
            "duration_s=6",
            "--set",
            "marker_noise_m=0",
            "--set",
            "mocap_rate_hz=100",
        ),
        *("--set", "mocap_offset_s=-1.5", "--set", "mocap_skew_ppm=0", "--json", tmp_path / "j.json"),
    )
    names = {"sim.mcap", "sim.c3d", "sim.trc", "sim_markers.toml", "sim_calibration.toml", "j.json"}
    assert {path.name for path in tmp_path.iterdir()} == names
    marks = tomllib.loads((tmp_path / "sim_markers.toml").read_text())["markers"]
    assert sum(map(len, marks.values())) == 15
    assert len(marks["imu_plate"]) == 8
    table = tomllib.loads((tmp_path / "sim_calibration.toml").read_text())["camera_from_mocap"]
    header, labels, t_s, trc = read_trc(tmp_path / "sim.trc")
    assert (header["Units"], header["DataRate"]) == ("mm", "100")
    points = ezc3d.c3d(str(tmp_path / "sim.c3d"))["data"]["points"][:3]
    np.testing.assert_allclose(np.moveaxis(points, (0, 1, 2), (2, 1, 0)), trc, atol=2e-4, equal_nan=True)
    lost = np.isnan(trc).any(axis=2).mean(axis=0)
    assert (lost > 0).all()
    # Through the files alone: markers to the camera's axes and the IMU's clock, against the truth inside.
    from smoother.io import read_recording

    truth = read_recording(tmp_path / "sim.mcap").truth
    turn = Rotation.from_quat(table["rotation"], scalar_first=True)
    kinect = np.diag([-1.0, -1.0, 1.0])  # of optical axes
    assert json.loads((tmp_path / "j.json").read_text())["mocap"]["offset_s"] == -1.5
    for joint in ("elbow", "wrist", "imu_plate"):
        mean = trc[:, [labels.index(name) for name in marks[joint]]].mean(axis=1) / 1000
        place = (turn.apply(mean) + table["translation"]) @ kinect.T
        seen = np.isfinite(mean[:, 0]) & (t_s - 1.5 > 0.1) & (t_s - 1.5 < 5.9)
        true = truth.position if joint == "imu_plate" else truth.joints[joint]
        there = np.stack([np.interp(t_s[seen] - 1.5, truth.t_s, true[:, k]) for k in range(3)], axis=1)
        # Straight lines between truth samples at 80 Hz cost up to 0.5 mm where the arm turns round.
        np.testing.assert_allclose(place[seen], there, atol=1e-3)


def test_mocap_goes_into_the_calibration_that_is_named(tmp_path, capsys):
    done(
        *(
            "simulate",
            "arm",
            "--mocap",
            "--calibration-out",
            tmp_path / "cal.toml",
            "--set",
            "protocol=random",
        ),
        *("--set", "duration_s=4", "-o", tmp_path / "a.mcap"),
    )
    assert "camera_from_mocap" in tomllib.loads((tmp_path / "cal.toml").read_text())
    assert not (tmp_path / "a_calibration.toml").exists()
    said = refused(capsys, "simulate", "arm", "--mocap", "-o", tmp_path / "a.mcap")
    assert "--force" in said


DOCUMENT = Path(__file__).parents[3] / "docs" / "exports.md"


def document() -> str:
    return DOCUMENT.read_text(encoding="utf-8")


def test_examples_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    recovery = made()
    prepare_export(recovery, "parquet").write(Path("out.parquet"), False)
    (table,) = re.findall(r"^```python\n(.*?)^```", document(), re.DOTALL | re.MULTILINE)
    exec(compile(table, "exports.md", "exec"), {})
    assert capsys.readouterr().out.split() == ["b'm'", "graph"]
