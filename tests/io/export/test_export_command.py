"""`unocclude export` over formats, sides and axes, of Parquet; `simulate arm --mocap`."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from itertools import product
from pathlib import Path

import ezc3d
import numpy as np
import pyarrow.parquet as pq
import pytest
from arms import make_recording
from commands import done, refused
from results import made, read_trc, without_answer
from scipy.spatial.transform import Rotation

from smoother.io import read_recording, write_recording, write_recovery
from smoother.io.export import prepare_export
from smoother.recording import CameraFrame
from smoother.result import Estimates

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


def test_a_strap_alone_and_no_answer_at_all_have_no_joint_angles(results, tmp_path, capsys):
    """One arm that cannot leaves none."""
    write_recovery([made("left"), made(strap=True)], tmp_path / "mixed.mcap")
    for name, sentence in (
        (results / "strap.mcap", "it has no shoulder, no elbow, no wrist; export to csv, trc"),
        (results / "nothing.mcap", "joint angles need shoulder, elbow and wrist"),
        (tmp_path / "mixed.mcap", "joint angles need"),
    ):
        assert sentence in refused(capsys, "export", name, "--format", "mot", "-o", tmp_path / "a.mot")
    assert [path.name for path in tmp_path.iterdir()] == ["mixed.mcap"]
    for other, name in product(FORMATS, ("strap", "nothing")):
        if other != "mot":
            done("export", results / f"{name}.mcap", "--format", other, "-o", tmp_path / f"{name}.{other}")


def test_no_gravity_and_a_camera_that_says_its_axes(results, tmp_path, capsys):
    command = ("export", results / "hold.mcap", "-o", tmp_path / "a.trc", "--format", "trc")
    said = refused(capsys, *command)
    assert "'hold' found no gravity" in said and "--frame camera" in said
    command = ("export", results / "hold.mcap", "--rate", "20", "--json", tmp_path / "j.json", "--force")
    for words in (["trc", "--frame", "camera"], ["c3d"]):
        done(*command, "-o", tmp_path / f"a.{words[0]}", "--format", *words)
        (row,) = json.loads((tmp_path / "j.json").read_text())["files"]
        assert (row["rate_hz"], row["rows"]) == (20, 400)
    assert ezc3d.c3d(str(tmp_path / "a.c3d"))["parameters"]["POINT"]["RATE"]["value"] == [20]
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


@pytest.mark.parametrize("side", ["left", "right"])
def test_simulated_mocap_beside_its_recording(tmp_path, side, capsys):
    settings = [f"side={side}", "protocol=random", "duration_s=6", "marker_noise_m=0", "mocap_rate_hz=100"]
    settings += ["mocap_offset_s=-1.5", "mocap_skew_ppm=0"]
    command = ["simulate", "arm", "-o", tmp_path / "sim.mcap", "--mocap", "--seed", 3]
    command += [word for setting in settings for word in ("--set", setting)]
    done(*command, "--json", tmp_path / "j.json")
    assert "--force" in refused(capsys, *command)
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


def test_examples_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    prepare_export(made(), "parquet").write(Path("out.parquet"), False)
    document = (Path(__file__).parents[3] / "docs" / "exports.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"^```python\n(.*?)^```", document, re.DOTALL | re.MULTILINE)
    exec(compile(table, "exports.md", "exec"), {})
    assert capsys.readouterr().out.split() == ["b'm'", "graph"]


def test_columns_of_parquet_have_units_and_the_rest_of_the_result_goes_along(tmp_path):
    recovery = replace(
        made("left"),
        config={"camera": {"noise_m": 0.008}},
        estimates=Estimates(further={"rms_m": float("nan"), "biases": np.array([1.0, 2.0])}),
        notes=("A note with “quotes”.",),
    )
    prepare_export(recovery, "parquet", version="9.9").write(tmp_path / "a.parquet", False)
    schema = pq.read_table(tmp_path / "a.parquet").schema
    units = {field.name: field.metadata[b"unit"].decode() for field in schema}
    assert all(field.metadata[b"description"] for field in schema)
    for pattern, unit in (
        (r"(imu|elbow|wrist|shoulder|hand)_[xyz]", "m"),
        (r"(\w+_)?sigma_[xyz]", "m"),
        (r"sigma_deg", "deg"),
        (r"v[xyz]", "m/s"),
        (r"imu_q[wxyz]", ""),
        (r"t_s", "s"),
        (r"stamp_ns", "ns"),
    ):
        assert {units[name] for name in units if re.fullmatch(pattern, name)} == {unit}, pattern
    # A strict reading: NaN is not JSON.
    kept = json.loads(schema.metadata[b"unocclude"], parse_constant=lambda text: pytest.fail(text))
    assert kept["config"] == {"camera": {"noise_m": 0.008}}
    assert kept["figures"] == {"rms_m": None, "biases": [1.0, 2.0]}
    assert kept["notes"] == ["A note with “quotes”."]
    assert (kept["method"], kept["side"], kept["version"]) == ("graph", "left", "9.9")
    assert len(kept["gaps"]) == len(recovery.gaps)
    assert kept["clock_offset_sigma_s"] == 0.002
