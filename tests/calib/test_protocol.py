"""Every calibration answers in one form, which a notebook can read and write."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calib import read_calibration, write_calibration
from calib.clock.clock_calibration import calibrate_clocks, clock_answer
from calib.clock.links import beep_receptions, buzzer_node
from calib.imu.imu_summary import imu_answer, magnetometer_answer
from calib.imu.magnetometer import calibrate_magnetometer
from calib.imu.sensor_calibration import calibrate_imu
from calib.protocol import Answer
from smoother.errors import CalibrationError
from smoother.runtime.printable import plain
from smoother.simulation.clocks import broadcast
from smoother.simulation.poses import SensorModel, magnetometer_turns, rest_poses


def answers() -> list[Answer]:
    model = SensorModel(offset=np.array([0.1, -0.2, 0.05]), matrix=np.diag([1.01, 0.99, 1.0]))
    stream, _ = rest_poses(model, 12, seed=3)
    _, receptions = broadcast(2, nodes=2)
    magnetometer = calibrate_magnetometer(magnetometer_turns(model, 3000, noise=0.01, seed=3))
    return [
        imu_answer(calibrate_imu(stream)),
        magnetometer_answer(magnetometer, stream.name),
        clock_answer(calibrate_clocks("Monday", [receptions])),
    ]


def test_one_form(tmp_path: Path):
    path = tmp_path / "cal.toml"
    for answer in answers():
        assert set(answer.sigma) <= set(answer.estimate) and answer.estimate
        for name, sigma in answer.sigma.items():
            assert np.all(np.asarray(sigma) > 0) and np.shape(sigma) == np.shape(answer.estimate[name])
        assert answer.verdict.grade in ("good", "usable", "not good enough") and answer.verdict.sentence
        json.dumps(plain(answer.figures), allow_nan=False)
        write_calibration(path, answer.table)
    tables = read_calibration(path).tables
    (held,) = tables["imu"].values()
    assert (
        set(held) == {"accelerometer", "gyroscope", "magnetometer"}
        and "residual" not in held["accelerometer"]
    )
    assert tables["clock"]["session"] == "Monday"


def test_as_many_beeps_as_event_times():
    with pytest.raises(CalibrationError, match=r"beeps that end in it: 0 \(\), event times given: 1"):
        beep_receptions([], [1.0])


def test_the_buzzer_is_the_one_node_called_base():
    assert buzzer_node(["arm", "Base-2", "arm"]) == "Base-2"
    assert buzzer_node(["base1", "base2"]) == "base"
