"""The calibration file: round trips, merging, every refusal; the form in which every calibration answers."""

from __future__ import annotations

import json
import os
import tomllib
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calib import CalibrationFile, read_calibration, write_calibration
from calib.clock import clock_answer
from calib.file import to_toml
from calib.imu import calibrate_imu, calibrate_magnetometer, imu_answer, magnetometer_answer
from calib.protocol import tables_of
from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.errors import CalibrationError
from smoother.runtime.printable import plain
from smoother.simulation.rig import SensorModel, broadcast, magnetometer_turns, rest_poses

HEAD = 'format = "unocclude calibration"\nversion = 1\n'

number = st.floats(-1.9, 1.9)  # metres
positive = st.floats(1e-9, 1.9)
vector = st.lists(number, min_size=3, max_size=3).map(np.array)
sigmas = st.lists(positive, min_size=3, max_size=3).map(np.array)
rotation = (
    st.lists(st.floats(-1, 1), min_size=4, max_size=4)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: Rotation.from_quat(q).as_matrix())
)
arms = st.builds(
    ArmCalibration,
    side=st.sampled_from(["right", "left", ""]),
    lever_arms=st.dictionaries(
        st.sampled_from(["elbow", "wrist", "hand"]), st.builds(LeverArm, vector, sigmas), max_size=3
    ),
    upper_arm=st.none() | st.builds(Length, positive, positive),
    R_F_A=st.none() | rotation,
    accelerometer_bias=st.none() | vector,
    gyroscope_bias=st.none() | vector,
)
plain_values = st.recursive(
    st.booleans() | st.integers(-(2**62), 2**62) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


def same(a: ArmCalibration, b: ArmCalibration) -> None:
    left, right = asdict(a), asdict(b)
    turns = [np.asarray(each.pop("R_F_A"), float) for each in (left, right)]
    np.testing.assert_equal(left, right)
    np.testing.assert_allclose(*turns, rtol=0, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(arms, arms)
def test_what_is_written_is_read(
    tmp_path_factory: pytest.TempPathFactory, one: ArmCalibration, two: ArmCalibration
):
    path = tmp_path_factory.mktemp("calibration") / "cal.toml"
    write_calibration(path, CalibrationFile().with_arm(one).with_arm(two))
    back = read_calibration(path)
    same(back.arms[two.side or "any"], two)
    if one.side != two.side:
        same(back.arms[one.side or "any"], one)


@settings(max_examples=80, deadline=None)
@given(st.dictionaries(st.text(), plain_values, max_size=4))
def test_toml_of_any_plain_values(table: dict):
    assert tomllib.loads(to_toml({"x": table})) == {"x": table}


COMMENTED = """# Anna's rig, measured on Monday
[arm.right]   # the weak one
# by ruler
upper_arm_m = 0.3      # shoulder to elbow
upper_arm_sigma_m = 0.01
R_F_A = [1, 0, 0, 0]

[hers]        # of another program
limits = [1, 2]  # degrees
"""


def test_comments_and_unknown_tables_survive(tmp_path: Path):
    path = tmp_path / "cal.toml"
    path.write_text(COMMENTED)
    wrist = LeverArm(np.array([0.0, 0.05, 0.0]), np.full(3, 0.002))
    arm = ArmCalibration("right", {"wrist": wrist}, Length(0.31, 0.002))
    write_calibration(path, CalibrationFile().with_arm(arm))
    assert path.read_text() == (
        "# Anna's rig, measured on Monday\n"
        + HEAD
        + "\n"
        + COMMENTED.partition("\n")[2]
        .replace("0.3  ", "0.31  ")
        .replace("0.01\n", "0.002\n")
        .replace(
            "0]\n\n",
            "0]\n\n[arm.right.lever_arm.wrist]\nposition_m = [0.0, 0.05, 0.0]\n"
            "sigma_m = [0.002, 0.002, 0.002]\n",
        )
    )


@pytest.mark.parametrize(
    "text",
    [
        "arm.left.upper_arm_m = 0.2\narm.left.upper_arm_sigma_m = 0.1\nclock.links = []\n",
        "arm = {left = {upper_arm_m = 0.2, upper_arm_sigma_m = 0.1}}\nclock = {links = [{a = 1}]}\n",
        "[arm.left]\nupper_arm_m = 0.2\nupper_arm_sigma_m = 0.1\n[clock]\n[arm.any]\n[clock.links]\n"
        "[arm.left.lever_arm.elbow]\nposition_m = [1, 2, 3]\nsigma_m = [1, 2, 3]\n",
        "[[clock.links]]\na = 1\n[[clock.links]]\na = 2\n[arm]\n[imu.left.gyroscope]\noffset = [1, 2, 3]\n",
    ],
)
def test_merging_into_every_way_to_write_tables(tmp_path: Path, text: str):
    path = tmp_path / "cal.toml"
    path.write_text(text)
    before = read_calibration(path)
    wrist = LeverArm(np.array([0.0, 0.05, 0.0]), np.full(3, 0.002))
    new = CalibrationFile().with_arm(ArmCalibration("left", {"wrist": wrist}, Length(0.31, 0.002)))
    new = new.with_table("clock", {"session": "b", "links": [{"a": 2.5, "b": [1]}, {"a": 3}]})
    write_calibration(path, new.with_table("imu", {"left": {"gyroscope": {"noise_density": 0.1}}}))
    back = read_calibration(path)
    assert back.arm("left").upper_arm == Length(0.31, 0.002)
    levers = before.arms["left"].lever_arms if "left" in before.arms else {}
    assert set(back.arm("left").lever_arms) == {*levers, "wrist"}
    assert back.tables["clock"] == new.tables["clock"]
    held = before.tables.get("imu", {"left": {"gyroscope": {}}})["left"]["gyroscope"]
    assert back.tables["imu"]["left"]["gyroscope"] == {**held, "noise_density": 0.1}


def test_sides():
    right, left, both = (ArmCalibration(side) for side in ("right", "left", ""))
    one = CalibrationFile().with_arm(right)
    assert one.arm("right").side == "right"
    assert one.arm("").side == "right"
    with pytest.raises(CalibrationError, match="is for the right arm only"):
        one.arm("left")
    assert one.with_arm(both).arm("left").side == ""
    assert one.with_arm(both).arm("").side == ""
    with pytest.raises(CalibrationError, match="does not show which"):
        one.with_arm(left).arm("")
    with pytest.raises(CalibrationError, match="has no arm"):
        CalibrationFile().arm("right")
    with pytest.raises(CalibrationError, match="'up'"):
        one.arm("up")


def test_what_is_no_calibration_is_not_written_over(tmp_path: Path):
    (tmp_path / "thesis.toml").write_text("mine = true\n")
    with pytest.raises(CalibrationError, match="is not a calibration"):
        write_calibration(tmp_path / "thesis.toml", CalibrationFile())
    assert (tmp_path / "thesis.toml").read_text() == "mine = true\n"


def test_a_failed_write_leaves_the_file_alone(tmp_path: Path):
    path = tmp_path / "cal.toml"
    good = CalibrationFile().with_arm(ArmCalibration("right", upper_arm=Length(0.3, 0.01)))
    write_calibration(path, good)
    before = path.read_bytes()
    for bad in (
        good.with_arm(ArmCalibration("right", upper_arm=Length(0.3, -1.0))),
        good.with_arm(ArmCalibration("right", R_F_A=2 * np.eye(3))),
        good.with_arm(ArmCalibration("right", R_F_A=np.full((3, 3), np.nan))),
        good.with_arm(ArmCalibration("right", gyroscope_bias=np.array([0, np.nan, 0]))),
        good.with_arm(ArmCalibration("up")),
        good.with_table("arm", {}),
        good.with_table("odd", {"value": object()}),
    ):
        with pytest.raises(CalibrationError):
            write_calibration(path, bad)
        assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["cal.toml"]


def test_a_file_written_by_hand_may_lack_format_and_version(tmp_path: Path):
    path = tmp_path / "rig.toml"
    path.write_text("[camera_from_mocap]\nrotation = [1, 0, 0, 0]\ntranslation = [0.5, 0, 2]\n")
    assert read_calibration(path).tables["camera_from_mocap"]["translation"] == [0.5, 0, 2]
    write_calibration(path, CalibrationFile().with_arm(ArmCalibration("left", upper_arm=Length(0.3, 0.01))))
    text = path.read_text()
    assert text.startswith(HEAD.strip()) and "[camera_from_mocap]" in text and "[arm.left]" in text
    path.write_text("[markers]\nwrist = ['RAD']\n")  # a map is none, nor is a table of another program
    with pytest.raises(CalibrationError, match="is not a calibration"):
        read_calibration(path)
    path.write_text("version = 2\n[arm.right]\n")
    with pytest.raises(CalibrationError, match="has version 2"):
        read_calibration(path)


def test_one_form(tmp_path: Path):
    path = tmp_path / "cal.toml"
    model = SensorModel(offset=np.array([0.1, -0.2, 0.05]), matrix=np.diag([1.01, 0.99, 1.0]))
    stream, _ = rest_poses(model, 12, seed=3)
    magnetometer = calibrate_magnetometer(magnetometer_turns(model, 3000, noise=0.01, seed=3))
    for answer in (
        imu_answer(calibrate_imu(stream)),
        magnetometer_answer(magnetometer, stream.name),
        clock_answer("Monday", [broadcast(2, nodes=2)[1]]),
    ):
        assert answer.grade in ("good", "usable", "not good enough") and answer.sentence
        written = plain(answer.to_dict())
        json.dumps(written, allow_nan=False)
        assert {row["sentence"] for row in written["findings"] if not row["good"]} >= {*answer.open_questions}
        write_calibration(path, answer.table)
    tables = read_calibration(path).tables
    (held,) = tables["imu"].values()
    assert (
        held.keys() == {"accelerometer", "gyroscope", "magnetometer"}
        and tables["clock"]["session"] == "Monday"
    )
    assert "residual" not in held["accelerometer"]


def test_figures_are_written_to_two_digits_of_their_sigma():
    figures = {"place_m": [0.12345, 1.0], "place_sigma_m": [0.0042, 0.0], "grade": "good", "tilt_rad": 0.1}
    figures |= {"of_joints": {"elbow": {"offset_s": 0.5, "sigma_s": 0.012}}, "noise_m": {"wrist": 0.01}}
    single, rows, noise = tables_of(figures)
    assert single.rows == [("place", "123.5 +- 4.2, 1000", "mm"), ("tilt", "5.7296", "deg")]
    assert rows.title == "Of joints" and rows.columns == ["of", "offset, s"]
    assert rows.rows == [["elbow", "0.500 +- 0.012"]] and noise.rows == [("wrist", "10", "mm")]
