"""Files that devices wrote, against an independent reading of their columns."""

from __future__ import annotations

import csv
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from importers import tables
from numpy.testing import assert_allclose, assert_array_equal

from smoother.io.registry import format_named, recognise
from smoother.io.tables.joints import KINECT_V2
from smoother.io.tables.table import read_head
from smoother.recording import CameraFrame

pytestmark = pytest.mark.real

G, RAD = 9.80665, np.pi / 180
KINECT = "azure_kinect_mkv_walking.csv"


@pytest.fixture
def devices(datasets: Path) -> Path:
    return datasets / "devices"


def columns(path: Path, header: int = 0, first: int = 1, separator: str = ",") -> dict[str, list[str]]:
    """Cells by column name, with nothing but the csv module."""
    with path.open(newline="", encoding="utf-8") as file:
        lines = list(csv.reader(file, delimiter=separator))
    names = enumerate(lines[header])
    return {name.strip(): [row[at].strip() for row in lines[first:]] for at, name in names if name}


def numbers(cells: dict[str, list[str]], *names: str) -> np.ndarray:
    return np.array([[float(cell) for cell in cells[name]] for name in names]).T


def vector(cells: dict[str, list[str]], form: str, axes: str = "XYZ") -> np.ndarray:
    return numbers(cells, *(form.format(axis) for axis in axes))


def check(table: Any, acc: np.ndarray, gyro: np.ndarray, t_s: np.ndarray | None = None) -> None:
    assert not table.notes or any("wide-range" in note for note in table.notes)
    assert_allclose(table.acc, acc, rtol=1e-12)
    assert_allclose(table.gyro, gyro, rtol=1e-12)
    if t_s is not None:
        assert_allclose(table.t_s, t_s, rtol=1e-14, atol=1e-9)


def test_xsens_dot(devices: Path):
    path = devices / "xsens_dot_walking_RF.csv"
    (table,), cells = tables(path, "xsens-dot"), columns(path)
    dates = [datetime.fromisoformat(text).replace(tzinfo=UTC) for text in cells["SampleTimeFine"]]
    stamps = np.array([date.timestamp() for date in dates])
    check(table, vector(cells, "Acc_{}"), vector(cells, "Gyr_{}") * RAD, stamps)


def test_xsens_mtw(devices: Path):
    path = devices / "xsens_mtw.txt"
    (table,), values = tables(path, "xsens-mt"), np.loadtxt(path, skiprows=5)
    check(table, values[:, 1:4], values[:, 4:7])
    assert_array_equal(table.counter, values[:, 0])
    assert table.rate_hz == 50.0


def test_apdm(devices: Path):
    path = devices / "apdm_opal.csv"
    found, cells = tables(path, "apdm"), columns(path, 2, 4)
    assert [table.name for table in found] == ["Static", "Upper", "Middle", "Lower"]
    for table in found:
        acc, gyro = (f"{table.name}/{quantity}/{{}}" for quantity in ("Acceleration", "Angular Velocity"))
        check(table, vector(cells, acc), vector(cells, gyro), numbers(cells, "Time")[:, 0])


@pytest.mark.parametrize(
    ("name", "key", "rows", "acc", "gyro", "t"),
    [
        ("shimmer_consensys", "shimmer", (1, 3), ("Shimmer_952D_Accel_WR_{}_CAL", 1),
         ("Shimmer_952D_Gyro_{}_CAL", RAD), ("Shimmer_952D_Timestamp_Unix_CAL", 1e-3)),
        ("ngimu_sensors", "x-imu", (0, 1), ("Accelerometer {} (g)", G), ("Gyroscope {} (deg/s)", RAD),
         ("Time (s)", 1)),
        ("ximu3_inertial", "x-imu", (0, 1), ("Accelerometer {} (g)", G), ("Gyroscope {} (deg/s)", RAD),
         ("Timestamp (us)", 1e-6)),
        ("nilspod", "nilspod", (0, 1), ("acc_{}", 1), ("gyr_{}", RAD), ("t", 1)),
    ],
)  # fmt: skip
def test_plain_tables(devices: Path, name: str, key: str, rows: tuple, acc: tuple, gyro: tuple, t: tuple):
    path = devices / f"{name}.csv"
    (table,), cells = tables(path, key), columns(path, *rows)
    axes = "xyz" if key == "nilspod" else "XYZ"
    force, turn = (vector(cells, form, axes) * scale for form, scale in (acc, gyro))
    check(table, force, turn)
    rounding = 1e-6 if key == "shimmer" else 1e-9  # Unix times in seconds
    assert_allclose(table.t_s, numbers(cells, t[0])[:, 0] * t[1], rtol=1e-14, atol=rounding)


def test_skeletons_are_no_imus(devices: Path):
    for name in (KINECT, "keraal_kinect_v2.txt", "keraal_blazepose.json", "opencap_markers.trc"):
        importer = recognise(read_head(devices / name), ("imu",))
        assert importer is None or importer.kind != "imu"


def test_azure_kinect(devices: Path):
    (table,), cells = tables(devices / KINECT, "azure-kinect"), columns(devices / KINECT, separator=";")
    assert (table.frame, table.units) == (CameraFrame.OPTICAL, "mm")
    assert_array_equal(table.t_s, numbers(cells, next(iter(cells)))[:, 0] * 1e-6)
    for joint, position in table.position.items():
        assert_array_equal(position, vector(cells, f"{joint.upper()} ({{}})", "xyz") * 0.001)
        confidence = numbers(cells, f"{joint.upper()} (c)")[:, 0]
        assert_array_equal(table.state[joint], np.ones(len(position)) if "hand" in joint else confidence)


def test_azure_kinect_without_header(devices: Path, tmp_path: Path):
    cells = columns(devices / KINECT, separator=";")
    rows = zip(
        *(values for name, values in cells.items() if name.endswith(("(x)", "(y)", "(z)"))), strict=True
    )
    path = tmp_path / "a.txt"
    path.write_text("\n".join(",".join(row) for row in rows))
    (table,) = tables(path, "kinect-numbers")
    assert_array_equal(table.position["elbow_left"], vector(cells, "ELBOW_LEFT ({})", "xyz") * 0.001)


def test_kinect_v2_without_header(devices: Path):
    path = devices / "keraal_kinect_v2.txt"
    (table,) = tables(path, "kinect-numbers")
    rows = np.loadtxt(path).reshape(-1, 25, 7)
    assert (table.frame, table.units, table.rate_hz, table.t_s) == (CameraFrame.KINECT, "m", 30.0, None)
    for joint, position in table.position.items():
        name, _, side = joint.partition("_")
        at = KINECT_V2.index(f"{name.capitalize()}{side.capitalize()}")
        assert_array_equal(position, rows[:, at, :3])


@pytest.mark.parametrize(
    ("name", "metres", "markers"),
    [
        ("pose2sim_markers.trc", 1.0, {"wrist_left": ["LWrist"], "shoulder_right": ["RShoulder"]}),
        (
            "opencap_markers.trc",
            0.001,
            {"elbow_right": ["R_elbow_med", "R_elbow_lat"], "wrist_left": ["L_wrist_radius", "L_wrist_ulna"]},
        ),
    ],
)
def test_markers(devices: Path, name: str, metres: float, markers: dict[str, list[str]]):
    (table,) = tables(devices / name, "trc")
    lines = (devices / name).read_text().splitlines()
    names = [cell for cell in lines[3].split("\t")[2:] if cell]
    rows = np.array([[float(c) for c in line.split("\t") if c] for line in lines[5:] if line.strip()])
    for joint, taken in markers.items():
        wanted = np.mean([rows[:, 2 + 3 * names.index(one) :][:, :3] for one in taken], axis=0)
        assert_allclose(table.position[joint], wanted * metres, rtol=0, atol=1e-12)
    assert_array_equal(table.gravity_hint, [0, -1, 0])


def test_fifty_thousand_rows_take_seconds(devices: Path, tmp_path: Path):
    header, *rows = (devices / KINECT).read_text().splitlines()
    path = tmp_path / "long.csv"
    path.write_text("\n".join([header, *rows * 73]))
    start = time.process_time()
    (table,) = format_named("azure-kinect").read(path)
    # 60 MB: 1.4 s of one processor; five times as much on a machine that is busy
    assert time.process_time() - start < 7.0
    assert len(table.t_s) == 73 * len(rows)
