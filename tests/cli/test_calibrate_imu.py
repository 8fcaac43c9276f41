"""`calibrate imu`, `calibrate magnetometer`, and their corrections as a recording is loaded."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.file import read_calibration
from calib.imu.sensor import sensor_of
from smoother.cli.load import load_arm
from smoother.cli.run import run
from smoother.config import Config
from smoother.io import open_csv, read_imu, write_recording
from smoother.io.mcap.messages import nanoseconds
from smoother.io.recording.streams import ImuSamples, RecordingFile
from smoother.recording import ImuStream
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.rig import SensorModel, magnetometer_turns, rest_poses
from smoother.window.priors import with_measured_noise

TOPIC = "/imu/forearm_right"


def record(path: Path, *streams: ImuStream) -> Path:
    file = RecordingFile(path)
    for each in streams:
        stamp = nanoseconds(each.t_s, 0)
        file.imus.append(
            ImuSamples(each.name, each.name.split("/")[-1], stamp, each.acc, each.gyro, each.mag)
        )
    write_recording(file, path)
    return path


def sensor(seed: int = 0) -> SensorModel:
    return SensorModel.draw(np.random.default_rng(seed), offset=0.5, scale=0.03, cross=0.01)


def test_imu_alone_to_file_figures_and_page(tmp_path, capsys):
    model = sensor()
    stream, bias = rest_poses(model, 12)
    poses = record(tmp_path / "poses.mcap", stream)
    out, figures, page = tmp_path / "cal.toml", tmp_path / "imu.json", tmp_path / "imu.html"
    arguments = ["calibrate", "imu", poses, "-o", out, "--json", figures, "--report", page]
    assert run([str(each) for each in arguments]) == 0
    said = capsys.readouterr().out
    assert "12 rest poses" in said and "degrees/s" in said
    found = json.loads(figures.read_text())
    offset, matrix = np.array(found["accelerometer"]["offset"]), np.array(found["accelerometer"]["matrix"])
    up = 9.81 * np.eye(3)
    assert ((model.distort(up) - offset) @ matrix.T) == pytest.approx(up, abs=0.02)
    assert found["gyroscope"]["offset"] == pytest.approx(bias, abs=2e-4)
    held = sensor_of(read_calibration(out), TOPIC)
    assert np.allclose(held.accelerometer[1], matrix) and np.allclose(
        held.gyroscope, found["gyroscope"]["offset"]
    )
    html = page.read_text(encoding="utf-8")
    assert "Which directions were covered" in html and "For the next recording" in html


def test_magnetometer_is_added_and_the_rest_is_kept(tmp_path, capsys):
    stream, _ = rest_poses(sensor(), 12)
    out = tmp_path / "cal.toml"
    assert run(["calibrate", "imu", str(record(tmp_path / "poses.mcap", stream)), "-o", str(out)]) == 0
    before = sensor_of(read_calibration(out), TOPIC)
    iron = SensorModel.draw(np.random.default_rng(1), offset=0.5, scale=0.2, cross=0.2)
    turning = replace(stream, mag=48.0 * magnetometer_turns(iron, len(stream)))
    path, page = record(tmp_path / "turning.mcap", turning), tmp_path / "mag.html"
    assert run(["calibrate", "magnetometer", str(path), "-o", str(out), "--report", str(page)]) == 0
    after = sensor_of(read_calibration(out), TOPIC)
    assert np.array_equal(after.accelerometer[0], before.accelerometer[0])
    length = np.linalg.norm(after.apply(turning).mag, axis=1)
    assert np.sqrt(np.mean((length - 1.0) ** 2)) < 0.02  # 1 % of noise
    assert "Coverage of the sphere" in page.read_text(encoding="utf-8")
    capsys.readouterr()


def failed(capsys, arguments: list[object], sentence: str) -> None:
    assert run([str(each) for each in arguments]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "Traceback" not in error and sentence in error, error


def test_refusals_name_file_and_sensor_and_write_nothing(tmp_path, capsys):
    out = tmp_path / "cal.toml"
    eight, _ = rest_poses(sensor(), 8)
    path = record(tmp_path / "eight.mcap", eight)
    failed(capsys, ["calibrate", "imu", path, "-o", out], f"eight.mcap, {TOPIC}: the recording contains 8")
    failed(capsys, ["calibrate", "magnetometer", path, "-o", out], "has no magnetometer")
    plane = np.random.default_rng(0).normal(0.0, 0.3, (len(eight), 3))
    angle = np.linspace(0.0, 30.0, len(eight))
    plane += 48.0 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    flat = record(tmp_path / "flat.mcap", replace(eight, mag=plane))
    failed(capsys, ["calibrate", "magnetometer", flat, "-o", out], "one axis only (its z axis)")
    two = record(tmp_path / "two.mcap", eight, replace(eight, name="/imu/base"))
    failed(capsys, ["calibrate", "imu", two, "-o", out], "has several IMUs")
    assert not out.exists()
    out.write_text('format = "unocclude calibration"\nversion = 1\nimu = [1]\n')
    failed(capsys, ["calibrate", "imu", path, "-o", out], "[imu.NAME]")


def test_corrections_are_applied_as_a_recording_is_loaded(tmp_path, capsys):
    made = simulate_arm(ArmSimulation(repetitions=1), 1).recording
    path, cal = tmp_path / "arm.mcap", tmp_path / "cal.toml"
    write_recording(replace(made, imu=replace(made.imu, name=TOPIC)), path)
    cal.write_text(
        'format = "unocclude calibration"\nversion = 1\n'
        "[imu.forearm_right.accelerometer]\noffset = [0.1, 0.2, 0.3]\nmatrix = [[1.1,0,0],[0,1,0],[0,0,1]]\n"
        "noise_density = 0.02\n[imu.forearm_right.gyroscope]\noffset = [0.0, 0.1, 0.0]\n"
    )
    raw, _ = load_arm(path)
    recording, arm = load_arm(path, cal)
    assert arm is None  # a file of sensors alone leaves the arm to be found
    assert recording.imu.acc[:, 0] == pytest.approx(1.1 * (raw.imu.acc[:, 0] - 0.1))
    assert recording.imu.gyro[:, 1] == pytest.approx(raw.imu.gyro[:, 1] - 0.1)
    assert any("accelerometer, gyroscope corrected; its measured noise is used" in n for n in recording.notes)
    assert with_measured_noise(Config(), recording.imu).imu.accelerometer_density == 0.02
    stated = Config.model_validate({"imu": {"accelerometer_density": 0.05}})
    assert with_measured_noise(stated, recording.imu).imu.accelerometer_density == 0.05
    other = cal.read_text().replace("forearm_right", "base")
    cal.write_text(other)
    assert any("left uncorrected" in note for note in load_arm(path, cal)[0].notes)
    cal.write_text(other.replace("imu.base", "imu.forearm_right").replace("[0.1, 0.2, 0.3]", '["a", 0, 0]'))
    assert run(["smooth", str(path), "-o", str(tmp_path / "o.mcap"), "--calibration", str(cal)]) == 1
    assert "imu.forearm_right.accelerometer.offset must contain 3 numbers" in capsys.readouterr().err


def test_plain_files_of_a_sensor_alone(tmp_path, capsys):
    stream, _ = rest_poses(sensor(), 10)
    folder = tmp_path / "poses"
    folder.mkdir()
    (folder / "recording.toml").write_text('[imu.forearm_right]\nfile = "imu.csv"\n')
    rows = np.hstack([stream.t_s[:, None], stream.acc, stream.gyro])
    np.savetxt(folder / "imu.csv", rows, "%.6f", ",", header="t_s,ax,ay,az,gx,gy,gz", comments="")
    path = tmp_path / "poses.mcap"
    assert run(["import", "csv", str(folder), "-o", str(path)]) == 0
    assert read_imu(path)[0].acc == pytest.approx(stream.acc, abs=1e-6)
    assert not open_csv(folder).arms
    assert run(["calibrate", "imu", str(path), "-o", str(tmp_path / "cal.toml")]) == 0
    capsys.readouterr()
    failed(capsys, ["smooth", path, "-o", tmp_path / "o.mcap"], "has no skeleton")
