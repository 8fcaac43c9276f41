"""Importers of what phones log: small files in each layout, values to the printed digits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from imu_files import GRAVITY, motion, printed, rows
from imu_tables import ACC, COUNT, DEG, EPOCH, GYRO, NANOS, TIME, check, read, written

from smoother.errors import RecordingError
from smoother.io.devices.describe_table import guess_sensor
from smoother.io.devices.registry import recognise
from smoother.io.tables.protocol import read_head
from smoother.io.tables.text_table import read_sheet


@pytest.mark.parametrize("units", [True, False])
@pytest.mark.parametrize("source", ["raw", "motion", "both"])
def test_sensorlog_turns_gravity_to_specific_force(tmp_path: Path, units: bool, source: str):
    up = np.array([0.0, 0.0, 1.0])
    columns, names = [], []
    for name, unit, values, kind in (
        ("accelerometerAcceleration", "G", -ACC / GRAVITY, "raw"),
        ("gyroRotation", "rad/s", GYRO, "raw"),
        ("motionUserAcceleration", "G", up - ACC / GRAVITY, "motion"),
        ("motionGravity", "G", np.tile(-up, (COUNT, 1)), "motion"),
        ("motionRotationRate", "rad/s", GYRO + 0.25, "motion"),
    ):
        names += [f"{name}{a}({unit})" if units else f"{name}{a}" for a in "XYZ"]
        off = source not in (kind, "both")
        columns.append([",,"] * COUNT if off else rows(values))
    stamps = [f"2020-01-10 14:23:{5 + t:06.3f} +0100" for t in TIME]
    header = [
        "loggingTime(txt)",
        "accelerometerTimestamp_sinceReboot(s)",
        "motionTimestamp_sinceReboot(s)",
        *names,
    ]
    body = [
        ",".join((stamp, f"{7 + t:.6f}", f"{9 + t:.6f}", *cells))
        for stamp, t, *cells in zip(stamps, TIME, *columns, strict=True)
    ]
    (table,) = read(written(tmp_path, ",".join(header), *body), "sensorlog")
    assert np.allclose(table.acc, ACC, atol=3e-5)  # two numbers of six decimals in g
    np.testing.assert_allclose(table.gyro, printed(GYRO + 0.25 * (source == "motion")), atol=1e-12)
    assert table.t_s[0] == (9 if source == "motion" else 7)
    assert "gravity, which points down" in " ".join(table.notes)


def test_sensorlog_without_gyroscope(tmp_path: Path):
    header = ",".join(["loggingTime(txt)", *(f"accelerometerAcceleration{a}(G)" for a in "XYZ")])
    body = [f"2020-01-10 14:23:05.{k:03d} +0100,{row}" for k, row in enumerate(rows(ACC / GRAVITY))]
    with pytest.raises(RecordingError, match="Device Motion"):
        read(written(tmp_path, header, *body), "sensorlog")


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_phyphox(tmp_path: Path, separator: str):
    names = [
        "Time (s)",
        *(f"Acceleration {a} (m/s^2)" for a in "xyz"),
        *(f"Gyroscope {a} (rad/s)" for a in "xyz"),
    ]
    header = separator.join(f'"{name}"' for name in [*names, "Absolute (rad/s)"])
    body = rows(TIME, ACC, GYRO, np.ones(COUNT), separator=separator, form="{:.9E}")
    if separator != ",":
        body = [row.replace(".", ",") for row in body]
    (table,) = read(written(tmp_path, header, *body), "phyphox")
    check(table, ACC, GYRO, TIME)


def test_phyphox_in_two_files(tmp_path: Path):
    header = '"Time (s)","X (m/s^2)","Y (m/s^2)","Z (m/s^2)"'
    check(read(written(tmp_path, header, *rows(TIME, ACC)), "phyphox")[0], printed(ACC), None)
    turning = header.replace("m/s^2", "rad/s")
    check(read(written(tmp_path, turning, *rows(TIME, GYRO)), "phyphox")[0], None, printed(GYRO))
    linear = header.replace('"X', '"Linear Acceleration x').replace('"Y', '"Linear Acceleration y')
    for without in (header, linear.replace('"Z', '"Linear Acceleration z')):
        with pytest.raises(RecordingError, match="Acceleration with g"):
            read(written(tmp_path, without, *rows(TIME, np.full((COUNT, 3), 0.3))), "phyphox")


@pytest.mark.parametrize(
    "header, t, scale",
    [
        ("timestamp,x,y,z", NANOS, 1e-9),
        ("", NANOS, 1e-9),
        ("time_ms,X,Y,Z,accuracy", NANOS // 1_000_000, 1e-3),
        ("seconds_elapsed,acc_x,acc_y,acc_z", TIME, 1.0),
        ("Timestamp [us],Accel X,Accel Y,Accel Z", NANOS // 1000, 1e-6),
    ],
)
def test_android_accelerometer(tmp_path: Path, header: str, t: np.ndarray, scale: float):
    extra = [np.full(COUNT, 3)] if "accuracy" in header else []
    (table,) = read(written(tmp_path, *([header] if header else []), *rows(t, ACC, *extra)), "android")
    check(table, printed(ACC), None, t * scale)


def test_android_gyroscope_and_order_of_axes(tmp_path: Path):
    (table,) = read(
        written(tmp_path, "time,seconds_elapsed,z,y,x", *rows(NANOS, TIME, GYRO[:, ::-1])), "android"
    )
    check(table, None, printed(GYRO), NANOS * 1e-9)
    assert "a gyroscope in rad/s" in " ".join(table.notes)


@pytest.mark.parametrize("unit, factor", [("rad/s", 1.0), ("deg/s", 180 / np.pi)])
def test_both_sensors_without_units_are_settled_by_gravity(tmp_path: Path, unit: str, factor: float):
    slow = GYRO * factor  # 90 deg/s at most: too slow for its size to settle the unit of one in deg/s
    header = "timestamp,ax,ay,az,gx,gy,gz"
    (table,) = read(written(tmp_path, header, *rows(NANOS, ACC / GRAVITY, slow)), "android")
    check(table, printed(ACC / GRAVITY) * GRAVITY, printed(slow) / factor)
    assert table.units == f"g, {unit}"


def test_android_log_with_names_of_sensors(tmp_path: Path):
    body = [
        row
        for k in range(COUNT)
        for row in (
            f"{EPOCH[k]},{10 * k},accel_g,{rows(ACC[k : k + 1] / GRAVITY)[0]}",
            f"{EPOCH[k]},{10 * k},gyro_dps,{rows(DEG[k : k + 1])[0]}",
        )
    ]
    acc, gyro = read(written(tmp_path, "epoch_ms,elapsed_ms,sensor,x,y,z", *body), "android")
    check(acc, printed(ACC / GRAVITY) * GRAVITY, None, EPOCH * 1e-3)
    check(gyro, None, np.radians(printed(DEG)), EPOCH * 1e-3)


@pytest.mark.parametrize(
    "header, units",
    [
        ("Time,Accel-X (g),Accel-Y (g),Accel-Z (g),Gyro-X (d/s),Gyro-Y (d/s),Gyro-Z (d/s)", "g, d/s"),
        ("time_ns,acc_x_g,acc_y_g,acc_z_g,gyro_x_dps,gyro_y_dps,gyro_z_dps", "g, dps"),
        ("Timestamp;accX;accY;accZ;gyrX;gyrY;gyrZ", "g, deg/s"),
        ("timestamp,gyroscope_x,gyroscope_y,gyroscope_z,accelerometer_x,accelerometer_y,accelerometer_z", ""),
    ],
)
def test_other_plain_tables(tmp_path: Path, header: str, units: str):
    separator = ";" if ";" in header else ","
    first, second = (ACC / GRAVITY, DEG) if units else (GYRO, ACC)
    (table,) = read(written(tmp_path, header, *rows(NANOS, first, second, separator=separator)), "android")
    if units:
        check(table, printed(ACC / GRAVITY) * GRAVITY, np.radians(printed(DEG)), NANOS * 1e-9)
        assert table.units == units
    else:
        check(table, printed(ACC), printed(GYRO), NANOS * 1e-9)


def test_the_other_file_settles_an_assumed_unit(tmp_path: Path):
    from smoother.io.tables.imu_checks import paired

    slow = DEG / 4  # 21 deg/s at most: by its size it could be rad/s
    (gyro,) = read(written(tmp_path, "timestamp,x,y,z", *rows(NANOS, slow)), "android")
    assert gyro.gyro_unit_assumed and gyro.units == "rad/s"
    acc, _ = motion(seed=1, slower=4)
    (acc_table,) = read(written(tmp_path, "timestamp,x,y,z", *rows(NANOS, acc)), "android")
    table = paired([acc_table, gyro], "two files")
    np.testing.assert_allclose(table.gyro, np.radians(printed(slow)), atol=1e-12)
    assert "only if that is in deg/s" in " ".join(table.notes) and table.units == "m/s^2, deg/s"


@pytest.mark.parametrize(
    "values, said",
    [
        (45 * ACC / np.linalg.norm(ACC, axis=1, keepdims=True) + 0.3 * GYRO, "looks like a magnetometer"),
        (9.80665 * ACC / np.linalg.norm(ACC, axis=1, keepdims=True), "gravity as the system estimates it"),
    ],
)
def test_other_vectors_of_a_phone_are_no_imu(tmp_path: Path, values: np.ndarray, said: str):
    with pytest.raises(RecordingError, match=said):
        read(written(tmp_path, "timestamp,x,y,z", *rows(NANOS, values)), "android")


GERMAN = ("Gyroskop", "Drehrate", "Drehgeschwindigkeit", "Winkelgeschwindigkeit")


@pytest.mark.parametrize("units", [True, False])
@pytest.mark.parametrize("turning", GERMAN)
def test_german_headers(tmp_path: Path, turning: str, units: bool) -> None:
    """With units it is phyphox's table; without, a plain log. A description of it keeps its times."""
    rng = np.random.default_rng(3)
    gyro = rng.normal(0, 1, (300, 3))
    acc = np.array([0.0, 0.0, 9.81]) + rng.normal(0, 0.1, (300, 3))
    second, force, rate = (" (s)", " (m/s^2)", " (rad/s)") if units else ("", "", "")
    header = [f"Zeit{second}", *(f"Beschleunigung {a}{force}" for a in "xyz")]
    header += [f"{turning} {a}{rate}" for a in "xyz"]
    rows = [";".join(f"{v:.6f}" for v in (k / 100, *acc[k], *gyro[k])).replace(".", ",") for k in range(300)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([";".join(header), *rows, ""]), encoding="utf-8")
    importer = recognise(read_head(path))
    assert importer is not None and importer.key == ("phyphox" if units else "android")
    (table,) = importer.read(path)
    assert np.allclose(table.t_s, np.arange(300) / 100) and np.allclose(table.gyro, gyro, atol=1e-6)
    guess = guess_sensor(read_sheet(path))
    assert guess.columns["t"] == f"Zeit{second}" and guess.keys["time_unit"] == "s"
    assert guess.columns["gx"] == f"{turning} x{rate}"
