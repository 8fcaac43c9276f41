"""The link of `[clock]` that is meant, in the direction that recovering needs; such a file needs no arm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.clock.links import measured_clock
from calib.file import CalibrationFile, write_calibration
from smoother.cli.load import SetUp
from smoother.errors import CalibrationError
from smoother.io import write_recording
from smoother.io.recording.read import read_arm
from smoother.recording import Recording
from smoother.simulation import ArmSimulation, simulate_arm


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate_arm(ArmSimulation(repetitions=1), 1).recording


def link(**changes: object) -> dict:
    return {
        "from": "camera",
        "to": "wrist",
        "offset_s": 1.5,
        "sigma_s": 0.002,
        "skew_ppm": 100.0,
        "skew_sigma_ppm": 0.0,
        "at_s": 10.0,
    } | changes


def file_of(*links: dict) -> CalibrationFile:
    return CalibrationFile().with_table("clock", {"session": "morning", "links": list(links)})


def test_from_camera_to_imu(recording: Recording) -> None:
    clock = measured_clock(file_of(link()), recording)
    assert clock is not None and clock.sigma_s == pytest.approx(0.002)
    np.testing.assert_allclose(clock.at(np.array([10.0, 20.0])), [1.5, 1.501])


def test_from_imu_to_camera_is_turned_round(recording: Recording) -> None:
    turned = link(**{"from": "wrist", "to": "kinect"})
    clock = measured_clock(file_of(turned), recording)
    assert clock is not None
    t_imu = np.array([10.0, 30.0])
    t_camera = t_imu + 1.5 + 1e-4 * (t_imu - 10.0)
    np.testing.assert_allclose(t_camera + clock.at(t_camera), t_imu, atol=1e-6)


def test_an_unmeasured_skew_widens(recording: Recording) -> None:
    clock = measured_clock(file_of(link(skew_ppm=0.0, skew_sigma_ppm=500.0, at_s=-1000.0)), recording)
    assert clock is not None and clock.skew == 0.0
    assert 0.05 < clock.sigma_s < 0.06


def test_the_link_of_this_imu(recording: Recording) -> None:
    named = replace(recording, imu=replace(recording.imu, name="/imu/wrist"))
    links = (link(offset_s=9.0, to="chest"), link(), link(**{"from": "wrist", "to": "chest"}))
    clock = measured_clock(file_of(*links), named)
    assert clock is not None and clock.mean_s == 1.5
    with pytest.raises(CalibrationError, match="links the camera with chest, wrist"):
        measured_clock(file_of(*links), recording)


def test_none_and_nonsense(recording: Recording) -> None:
    assert measured_clock(CalibrationFile(), recording) is None
    assert measured_clock(file_of(link(**{"from": "chest"})), recording) is None
    for wrong in ({"offset_s": "late"}, {"sigma_s": -1.0}, {"sigma_s": float("nan")}):
        with pytest.raises(CalibrationError, match=r"\[clock\]"):
            measured_clock(file_of(link(**wrong)), recording)


def test_a_file_of_clocks_needs_no_arm(recording: Recording, tmp_path: Path) -> None:
    path, file = tmp_path / "arm.mcap", tmp_path / "clock.toml"
    write_recording(recording, path)
    write_calibration(file, file_of(link()))
    read, arm = read_arm(path, file)
    assert arm is None
    clock = SetUp().clock(file, read)
    assert clock is not None and clock.mean_s == 1.5
    typed = SetUp(clock_offset=0.3, clock_sigma=0.01).clock(file, read)  # what is typed counts
    assert typed is not None and (typed.mean_s, typed.sigma_s) == (0.3, 0.01)
    assert SetUp().clock(None, read) is None
