"""Files that devices wrote, against an independent reading of their columns."""

from __future__ import annotations

import csv
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from smoother.errors import RecordingError
from smoother.io.devices.registry import recognise
from smoother.io.tables.protocol import read_head

pytestmark = pytest.mark.real

G, RAD = 9.80665, np.pi / 180


def columns(path: Path, header: int, first: int, separator: str = ",") -> dict[str, list[str]]:
    """Cells by column name, with nothing but the csv module."""
    with path.open(newline="", encoding="utf-8") as file:
        lines = list(csv.reader(file, delimiter=separator))
    return {
        name.strip(): [row[at].strip() for row in lines[first:]]
        for at, name in enumerate(lines[header])
        if name
    }


def vector(table: dict[str, list[str]], form: str, axes: str = "XYZ") -> np.ndarray:
    return np.array([[float(cell) for cell in table[form.format(axis)]] for axis in axes]).T


def read(path: Path, key: str):
    importer = recognise(read_head(path), ("imu",))
    assert importer is not None and importer.key == key
    tables = importer.read(path)
    assert all(not table.notes for table in tables) or key == "shimmer"
    return tables


def check(table, acc: np.ndarray, gyro: np.ndarray) -> None:
    np.testing.assert_allclose(table.acc, acc, rtol=1e-12)
    np.testing.assert_allclose(table.gyro, gyro, rtol=1e-12)


def test_xsens_dot(datasets: Path):
    path = datasets / "devices" / "xsens_dot_walking_RF.csv"
    (table,), cells = read(path, "xsens-dot"), columns(path, 0, 1)
    check(table, vector(cells, "Acc_{}"), vector(cells, "Gyr_{}") * RAD)
    stamps = [
        datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp() for text in cells["SampleTimeFine"]
    ]
    np.testing.assert_allclose(table.t_s, stamps, rtol=0, atol=1e-9)


def test_xsens_dot_of_fusion_only(datasets: Path):
    with pytest.raises(RecordingError, match="Custom mode 5"):
        read(datasets / "devices" / "xsens_dot_fusion_only.csv", "xsens-dot")


def test_xsens_mtw(datasets: Path):
    path = datasets / "devices" / "xsens_mtw.txt"
    (table,), values = read(path, "xsens-mt"), np.loadtxt(path, skiprows=5)
    check(table, values[:, 1:4], values[:, 4:7])
    np.testing.assert_array_equal(table.counter, values[:, 0])
    assert table.rate_hz == 50.0


def test_shimmer(datasets: Path):
    path = datasets / "devices" / "shimmer_consensys.csv"
    (table,), cells = read(path, "shimmer"), columns(path, 1, 3)
    check(
        table, vector(cells, "Shimmer_952D_Accel_WR_{}_CAL"), vector(cells, "Shimmer_952D_Gyro_{}_CAL") * RAD
    )
    stamps = np.array([float(cell) for cell in cells["Shimmer_952D_Timestamp_Unix_CAL"]])
    np.testing.assert_allclose(table.t_s, stamps / 1000, rtol=0, atol=1e-6)


def test_apdm(datasets: Path):
    path = datasets / "devices" / "apdm_opal.csv"
    tables, cells = read(path, "apdm"), columns(path, 2, 4)
    assert [table.name for table in tables] == ["Static", "Upper", "Middle", "Lower"]
    for table in tables:
        check(
            table,
            vector(cells, table.name + "/Acceleration/{}"),
            vector(cells, table.name + "/Angular Velocity/{}"),
        )
        np.testing.assert_array_equal(table.t_s, [float(cell) for cell in cells["Time"]])


@pytest.mark.parametrize(
    "name, time, unit", [("ngimu_sensors", "Time (s)", 1), ("ximu3_inertial", "Timestamp (us)", 1e-6)]
)
def test_ximu(datasets: Path, name: str, time: str, unit: float):
    path = datasets / "devices" / f"{name}.csv"
    (table,), cells = read(path, "x-imu"), columns(path, 0, 1)
    check(table, vector(cells, "Accelerometer {} (g)") * G, vector(cells, "Gyroscope {} (deg/s)") * RAD)
    np.testing.assert_allclose(table.t_s, np.array([float(cell) for cell in cells[time]]) * unit, rtol=1e-14)


def test_nilspod(datasets: Path):
    path = datasets / "devices" / "nilspod.csv"
    (table,), cells = read(path, "nilspod"), columns(path, 0, 1)
    check(table, vector(cells, "acc_{}", "xyz"), vector(cells, "gyr_{}", "xyz") * RAD)
    np.testing.assert_array_equal(table.t_s, [float(cell) for cell in cells["t"]])


def test_skeletons_are_no_imus(datasets: Path):
    for name in (
        "azure_kinect_mkv_walking.csv",
        "keraal_kinect_v2.txt",
        "keraal_blazepose.json",
        "opencap_markers.trc",
    ):
        importer = recognise(read_head(datasets / "devices" / name), ("imu",))
        assert importer is None or importer.kind != "imu"
