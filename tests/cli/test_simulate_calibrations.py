"""Every calibration without hardware: simulated files, the command that is printed, the truth."""

from __future__ import annotations

import json
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest

from calib import read_calibration
from calib.imu.accelerometer import sphere_points
from calib.imu.imu_summary import imu_answer
from calib.imu.sensor_calibration import calibrate_imu
from smoother.cli.run import run
from smoother.io import read_imu, read_recording
from smoother.simulation.rig import simulate_clock_session

#: A normalised error beyond this has a chance of one in fifteen thousand.
MOST_SIGMAS = 4.0


def simulated(capsys: pytest.CaptureFixture[str], *words: object) -> list[str]:
    """Run `unocclude simulate ..`; the command that it says to try, in words."""
    assert run(["simulate", *map(str, words)]) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    assert line.startswith("try: unocclude ")
    return shlex.split(line)[2:]


def truth_of(path: Path) -> dict:
    return tomllib.loads(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("seed", [1, 2])
def test_imu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys, seed: int) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(simulated(capsys, "imu", "-o", "poses.mcap", "--seed", seed)) == 0
    truth = truth_of(Path("poses_truth.toml"))["imu"]["forearm_right"]
    answer = imu_answer(calibrate_imu(read_imu("poses.mcap")[0]))
    for name, true in (
        ("accelerometer_offset", truth["accelerometer"]["offset"]),
        ("accelerometer_matrix", truth["accelerometer"]["matrix"]),
        ("gyroscope_offset", truth["gyroscope"]["offset"]),
    ):
        assert np.abs((answer.estimate[name] - np.array(true)) / answer.sigma[name]).max() < MOST_SIGMAS, name
    # the file of the printed command holds the same, and the truth reads as a calibration file
    held = read_calibration("arm.toml").tables["imu"]["forearm_right"]["accelerometer"]
    np.testing.assert_allclose(held["offset"], answer.estimate["accelerometer_offset"])
    assert read_calibration("poses_truth.toml").tables["imu"]["forearm_right"] == truth
    assert Path("imu.html").exists()


def test_a_long_rest_gives_the_noise(tmp_path: Path, capsys) -> None:
    path, figures = tmp_path / "rest.mcap", tmp_path / "rest.json"
    words = simulated(capsys, "imu", "-o", path, "--long-rest-s", 300)[:3]
    assert run([*words, "-o", str(tmp_path / "arm.toml"), "--json", str(figures)]) == 0
    found = json.loads(figures.read_text())
    # 300 s of a density: each axis to about 3 %
    assert found["accelerometer"]["allan"]["noise_density"] == pytest.approx([2e-3] * 3, rel=0.1)
    assert found["gyroscope"]["allan"]["noise_density"] == pytest.approx([2e-4] * 3, rel=0.1)
    truth = truth_of(tmp_path / "rest_truth.toml")["imu"]["forearm_right"]
    assert found["gyroscope"]["offset"] == pytest.approx(truth["gyroscope"]["offset"], abs=1e-4)


def test_magnetometer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(simulated(capsys, "magnetometer", "-o", "turning.mcap", "--field", 0.5, "--seed", 3)) == 0
    truth = truth_of(Path("turning_truth.toml"))["imu"]["forearm_right"]["magnetometer"]
    found = read_calibration("arm.toml").tables["imu"]["forearm_right"]["magnetometer"]
    # what the sensor reads of fields in all directions, corrected: of length 1 to 1 % / sqrt(3000 / 9)
    read = sphere_points(300) @ np.linalg.inv(truth["matrix"]).T + truth["offset"]
    length = np.linalg.norm((read - found["offset"]) @ np.transpose(found["matrix"]), axis=1)
    assert np.sqrt(np.mean((length - 1.0) ** 2)) < 3 * found["residual_rms"] / np.sqrt(found["samples"] / 9)
    # the turns of gyroscope and accelerometer are those of the magnetometer: the dip does not change
    stream, _ = read_imu("turning.mcap")
    field = (stream.mag - truth["offset"]) @ np.transpose(truth["matrix"])
    down = np.einsum("ni,ni->n", field, stream.acc) / 9.81
    assert down == pytest.approx(np.full(len(down), -np.sin(np.radians(60.0))), abs=0.06)


def test_clock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    words = simulated(capsys, "clock", "-o", "session", "--seed", 5)
    assert run([*words, "--processes", "1"]) == 0
    links = read_calibration("clock.toml").tables["clock"]["links"]
    session = simulate_clock_session(5)
    assert len(links) == 3
    for link in links:
        true = session.offset_s(link["from"], link["to"], link["at_s"])
        assert abs(link["offset_s"] - true) < MOST_SIGMAS * link["sigma_s"], link
        assert link["sigma_s"] < 1e-3
    of_file = {
        (link["from"], link["to"]): link for link in truth_of(Path("session/truth.toml"))["clock"]["links"]
    }
    at_zero = of_file["base", "forearm_right"]
    assert at_zero["offset_s"] == session.offset_s("base", "forearm_right", 0.0)
    assert at_zero["skew_ppm"] == pytest.approx(390.0, abs=0.01)


def test_strap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    words = simulated(capsys, "strap", "-o", "session.mcap", "--duration-s", 10, "--seed", 6)
    assert run([*words, "--processes", "1", "--json", "strap.json"]) == 0
    found, truth = json.loads(Path("strap.json").read_text()), truth_of(Path("session_truth.toml"))["strap"]
    # the ends of the skeleton's forearm are known to a centimetre of 25
    assert found["along"] == pytest.approx(truth["along"], abs=0.04)
    arm, motion = read_recording("with_strap.mcap").arm, read_recording("session.mcap").truth
    assert motion is not None
    rows = arm.tracked("strap")
    true = np.stack([np.interp(arm.t_s[rows], motion.t_s, column) for column in motion.position.T], axis=1)
    error = np.linalg.norm(arm.joint("strap")[rows] - true, axis=1)
    assert rows.sum() > 20 and np.sqrt(np.mean(error**2)) < 3 * np.linalg.norm(found["sigma_m"])


def test_nothing_is_overwritten_unasked(tmp_path: Path, capsys) -> None:
    for words, other in (
        (["imu", "-o", "a.mcap"], "a_truth.toml"),
        (["magnetometer", "-o", "b.mcap"], "b_truth.toml"),
        (["strap", "-o", "c.mcap"], "c_truth.toml"),
        (["clock", "-o", "d"], "d/notes.txt"),
    ):
        held = tmp_path / other
        held.parent.mkdir(exist_ok=True)
        held.write_text("mine")
        words = [*words[:2], str(tmp_path / words[2])]
        assert run(["simulate", *words]) == 1
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and "exists already" in error
        assert held.read_text() == "mine" and len(list(tmp_path.rglob("*"))) == (
            2 if words[0] == "clock" else 1
        )
        held.unlink()
    (tmp_path / "d" / "notes.txt").write_text("mine")
    assert run(["simulate", "clock", "-o", str(tmp_path / "d"), "--force"]) == 1
    assert "contains other things than a simulation" in capsys.readouterr().err


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path, capsys) -> None:
    for kind in ("imu", "magnetometer"):
        for name in ("a", "b"):
            simulated(capsys, kind, "-o", tmp_path / f"{name}.mcap", "--force")
        assert (tmp_path / "a_truth.toml").read_bytes() == (tmp_path / "b_truth.toml").read_bytes()
        np.testing.assert_array_equal(
            read_imu(tmp_path / "a.mcap")[0].acc, read_imu(tmp_path / "b.mcap")[0].acc
        )
