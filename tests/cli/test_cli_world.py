"""`calibrate world` from rendered files and recordings, and what `smooth` makes of its answer."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.file import CalibrationFile, read_calibration, write_calibration
from calib.world.world_table import with_gravity
from smoother import smooth
from smoother.cli.run import run
from smoother.io import read_recording, write_recording
from smoother.io.media.images import ImageMessage, LensMessage, read_images
from smoother.recording import ImuStream, Recording
from smoother.simulation import ArmSimulation, simulate_arm

FROM_OPTICAL = np.diag([-1.0, -1.0, 1.0])


def matrix(table: dict) -> np.ndarray:
    return Rotation.from_quat(np.roll(table["rotation"], -1)).as_matrix()


def degrees(R: np.ndarray) -> float:
    return float(np.degrees(Rotation.from_matrix(R).magnitude()))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five poses, the camera turned between them."""
    folder = tmp_path_factory.mktemp("world")
    arguments = ["--poses", "5", "--seed", "21", "--camera-tilt-deg", "30", "--tilt-deg", "15,38"]
    done = run(["simulate", "panel", "-o", str(folder / "s"), "--mcap", str(folder / "s.mcap"), *arguments])
    assert done == 0
    return folder


def files(session: Path, numbers: range) -> list[str]:
    arguments = ["--intrinsics", str(session / "s/intrinsics.toml")]
    for number in numbers:
        pose = session / f"s/pose_{number:02d}"
        for option, ending in (
            ("--depth", "depth.png"),
            ("--infrared", "infrared.png"),
            ("--panel-imu", "imu_panel.csv"),
            ("--base-imu", "imu_base.csv"),
        ):
            arguments += [option, f"{pose}_{ending}"]
    return arguments


def test_recording_gives_camera_from_base_and_the_mounting(session: Path, tmp_path: Path, capsys):
    cal, figures = tmp_path / "cal.toml", tmp_path / "world.json"
    write_calibration(cal, CalibrationFile().with_table("kept", {"value": 1}))
    panel = ["--panel", str(session / "s/panel.toml")]
    command = ["calibrate", "world", str(session / "s.mcap"), *panel, "-o", str(cal), "--json", str(figures)]
    page = tmp_path / "world.html"
    assert run([*command, "--report", str(page)]) == 0
    said, text = capsys.readouterr().out, page.read_text(encoding="utf-8")
    assert "The base IMU on the camera" in text and text.count("s.mcap at ") >= 2 * 5
    assert run([*command, "--report", str(page)]) == 1  # the page is there already
    assert "--force" in capsys.readouterr().err
    truth = tomllib.loads((session / "s/truth.toml").read_text())
    tables = read_calibration(cal).tables
    assert degrees(matrix(tables["camera_from_base"]) @ matrix(truth["camera_from_base"]).T) < 0.4
    assert degrees(matrix(tables["panel_from_imu"]).T @ matrix(truth["panel_from_imu"])) < 0.4
    assert tables["kept"] == {"value": 1}
    assert tables["world"]["heading"] == "known" and tables["world"]["poses"] == 5
    assert tables["world"]["verdict"] in said and "verdict:" in said
    assert json.loads(figures.read_text())["words"]["grade"] == tables["world"]["grade"]


def test_files_do_without_the_gyroscopes(session: Path, tmp_path: Path):
    cal, panel = tmp_path / "cal.toml", ["--panel", str(session / "s/panel.toml")]
    assert run(["calibrate", "world", *files(session, range(1, 6)), *panel, "-o", str(cal)]) == 0
    truth = tomllib.loads((session / "s/truth.toml").read_text())
    tables = read_calibration(cal).tables
    error = degrees(matrix(tables["camera_from_base"]) @ matrix(truth["camera_from_base"]).T)
    assert error < max(0.5, 3 * max(tables["camera_from_base"]["rotation_sigma_deg"]))
    down = np.array(tables["world"]["residuals"][0]["down"])
    assert np.degrees(np.arccos(down @ truth["pose"]["01"]["down"])) < 0.5


def test_what_is_wrong_is_one_sentence_and_no_file(session: Path, tmp_path: Path, capsys):
    cal, panel = tmp_path / "cal.toml", ["--panel", str(session / "s/panel.toml")]
    short = tmp_path / "short.csv"
    short.write_text("t_s,ax,ay,az,gx,gy\n0,0,0,9.8,0,0\n")
    one = files(session, range(1, 2))
    wrong = [*one[:-1], str(short)]
    for arguments, code, words in (
        ([str(session / "s.mcap"), "--base-topic", "nothing"], 1, "no IMU fits"),
        ([str(session / "s.mcap"), "--base-topic", "panel"], 1, "cannot be on the panel and on the camera"),
        ([*one, "--depth", one[3]], 2, "alike often"),
        (one[2:], 2, "--intrinsics"),
        (wrong, 1, "gz"),
        ([], 2, "once per pose"),
    ):
        assert run(["calibrate", "world", *arguments, *panel, "-o", str(cal)]) == code
        error = capsys.readouterr().err
        assert words in error and "Traceback" not in error
    assert not cal.exists()


def test_images_of_a_recording_are_read(session: Path):
    found = list(read_images(session / "s.mcap"))
    (lens,) = (message.intrinsics for message in found if isinstance(message, LensMessage))
    assert (lens.width, lens.height, lens.fx, len(lens.distortion)) == (512, 424, 365.5, 5)
    images = [message for message in found if isinstance(message, ImageMessage)]
    assert len(images) == 10 and {image.pixels().dtype for image in images} == {np.dtype("uint16")}


@pytest.fixture(scope="module")
def still() -> tuple[Recording, np.ndarray, np.ndarray]:
    """An arm that hangs still before a camera with a base IMU; down in the camera; R_K_B (optical)."""
    arm = simulate_arm(ArmSimulation.preset("realistic", protocol="hang", duration_s=12, still_all=True), 1)
    down = np.asarray(arm.parameters["gravity"]) / 9.81
    R_K_B = Rotation.from_rotvec([0.3, -1.2, 2.0]).as_matrix()
    rng = np.random.default_rng(5)
    t_s = np.arange(0.5, 1100) / 100
    acc = -9.81 * (R_K_B.T @ FROM_OPTICAL @ down) + 0.03 * rng.normal(size=(len(t_s), 3))
    base = ImuStream("/imu/base", t_s, acc, 0.002 * rng.normal(size=(len(t_s), 3)))
    return replace(arm.recording, base_imu=base), down, R_K_B


def known_to(R_K_B: np.ndarray, sigma_deg: float, off_deg: float) -> CalibrationFile:
    off = Rotation.from_rotvec(np.radians([off_deg, 0, 0])).as_matrix()
    q = np.roll(Rotation.from_matrix(off @ R_K_B).as_quat(), 1)
    table = {"rotation": q.tolist(), "rotation_sigma_deg": [sigma_deg] * 3}
    return CalibrationFile().with_table("camera_from_base", table)


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))))


def test_a_base_imu_keeps_the_tilt_of_a_still_recording(still):
    recording, down, R_K_B = still
    without = smooth(recording)
    told = with_gravity(recording, known_to(R_K_B, 0.2, 0.2))
    assert angle(told.gravity_hint, down) < 0.3
    assert 0.2 < np.degrees(told.gravity_sigma_rad) < 0.5
    assert any("base IMU" in note for note in told.notes)
    tilt = angle(smooth(told).gravity_direction, down)
    assert tilt < 0.5 and tilt < 0.2 * angle(without.gravity_direction, down)


def test_smooth_takes_it_through_the_files(still, tmp_path: Path):
    recording, down, R_K_B = still
    rec, cal, out = tmp_path / "rec.mcap", tmp_path / "cal.toml", tmp_path / "out.mcap"
    write_recording(recording, rec)
    assert read_recording(rec).base_imu is not None
    write_calibration(cal, known_to(R_K_B, 0.2, 0.1))
    from smoother.io import read_recovery

    assert run(["smooth", str(rec), "-o", str(out), "--calibration", str(cal), "--draws", "0"]) == 0
    assert angle(read_recovery(out)[0].gravity_direction, down) < 0.5


def test_a_free_heading_costs_where_the_camera_stands_otherwise(still):
    """Gravity is sure where the camera stands as in the poses, unsure where it is tilted elsewhere."""
    recording, down, R_K_B = still
    up = -FROM_OPTICAL @ down
    free = np.zeros((6, 6))
    free[:3, :3] = np.radians(60) ** 2 * np.outer(up, up) + np.radians(0.1) ** 2 * np.eye(3)
    file = known_to(R_K_B, 0.1, 0.0)
    file.tables["camera_from_base"]["covariance"] = free.tolist()
    here = with_gravity(recording, file)
    assert np.degrees(here.gravity_sigma_rad) < 0.4
    tilted = Rotation.from_rotvec(np.radians(20) * np.cross(up, [0, 0, 1])).as_matrix()
    base = replace(recording.base_imu, acc=recording.base_imu.acc @ (R_K_B.T @ tilted @ R_K_B).T)
    assert np.degrees(with_gravity(replace(recording, base_imu=base), file).gravity_sigma_rad) > 5


def test_a_base_imu_that_cannot_be_used_is_told(still):
    recording, _, R_K_B = still
    file = known_to(R_K_B, 0.2, 0.0)
    assert with_gravity(recording, CalibrationFile()) is recording
    assert with_gravity(replace(recording, base_imu=None), file).gravity_sigma_rad is None
    odd = with_gravity(replace(recording, camera_frame=None), file)
    assert odd.gravity_sigma_rad is None and "are unknown" in odd.notes[-1]
    newer = file.with_table(
        "imu", {"base": {"accelerometer": {"offset": [0.1, 0, 0], "matrix": np.eye(3).tolist()}}}
    )
    assert "calibrate world" in with_gravity(recording, newer).notes[-1]
    file.tables["camera_from_base"]["rotation"] = [1, 1, 0, 0]
    with pytest.raises(Exception, match="unit quaternion"):
        with_gravity(recording, file)
