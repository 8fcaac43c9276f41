"""Importers of tables of sensors and phones: small files in each layout, values to the printed digits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from importers import ACC, COUNT, DEG, EPOCH, GYRO, MICROS, NANOS, TIME, check, tables, written, xyz
from imu_files import GRAVITY, motion, printed, rows

from smoother.errors import RecordingError
from smoother.io.registry import FileReader, formats
from smoother.io.tables.imu import ImuTable
from smoother.io.tables.table import read_head
from smoother.io.tables.times import repaired_imu

#: Factors of g and of degrees, two columns of something else, and the names of three axes.
G, D, TWO = GRAVITY, np.pi / 180, np.ones((COUNT, 2))
A3, G3 = "acc_x,acc_y,acc_z", "gyr_x,gyr_y,gyr_z"
SLOW = np.degrees(GYRO)  # 90 deg/s at most: too slow for its size to settle the unit of one in deg/s
#: What columns are read as: which of them, times a factor.
FORCE, TURN = {"acc": (1, 1)}, {"gyro": (1, 1)}
NS, US, MS = ({"t_s": (0, unit)} for unit in (1e-9, 1e-6, 1e-3))
BOTH = {**NS, "acc": (1, G), "gyro": (2, D)}
XYZ, UNITLESS = "timestamp,x,y,z", "timestamp,ax,ay,az,gx,gy,gz"
#: Of each layout key and header, its columns; what they are read as; what is said.
PLAIN = [
    ("nilspod", f"t,{G3},{A3},baro,analog_0", [TIME, DEG, ACC, TWO], {"gyro": (1, D), "acc": (2, 1)}, ""),
    (
        *("xsens-mt", f"PacketCounter,SampleTimeFine,{A3},{G3},Quat_q0"),
        [np.arange(COUNT), 10_000 + 100 * np.arange(COUNT), ACC, GYRO, TWO[:, 0]],
        *({"t_s": (1, 1e-4), "acc": (2, 1), "gyro": (3, 1)}, "m/s^2, rad/s"),
    ),
    ("phyphox", '"Time (s)","X (m/s^2)","Y (m/s^2)","Z (m/s^2)"', [TIME, ACC], FORCE, "stated"),
    ("phyphox", '"Time (s)","X (rad/s)","Y (rad/s)","Z (rad/s)"', [TIME, GYRO], TURN, "stated"),
    ("android", XYZ, [NANOS, ACC], NS | FORCE, "it reads 9.8 as a rule"),
    ("android", "", [NANOS, ACC], NS | FORCE, ""),
    ("android", "time_ms,X,Y,Z,accuracy", [NANOS // 10**6, ACC, TWO[:, 0]], MS | FORCE, ""),
    ("android", f"seconds_elapsed,{A3}", [TIME, ACC], FORCE, ""),
    ("android", "Timestamp [us],Accel X,Accel Y,Accel Z", [NANOS // 1000, ACC], US | FORCE, ""),
    ("android", "time,x,y,z", [NANOS, GYRO], NS | TURN, "without gravity assumed a gyroscope"),
    ("android", UNITLESS, [NANOS, ACC / G, GYRO], BOTH | {"gyro": (2, 1)}, "g, rad/s"),
    ("android", UNITLESS, [NANOS, ACC / G, SLOW], BOTH, "g, deg/s"),
    (
        *("android", "Time,Accel-X (g),Accel-Y (g),Accel-Z (g),Gyro-X (d/s),Gyro-Y (d/s),Gyro-Z (d/s)"),
        *([NANOS, ACC / G, DEG], BOTH, "g, deg/s"),
    ),
    (
        *("android", "time_ns,acc_x_g,acc_y_g,acc_z_g,gyro_x_dps,gyro_y_dps,gyro_z_dps"),
        *([NANOS, ACC / G, DEG], BOTH, "g, deg/s"),
    ),
    ("android", "Timestamp;accX;accY;accZ;gyrX;gyrY;gyrZ", [NANOS, ACC / G, DEG], BOTH, "g, deg/s"),
    (
        *("android", f"time,seconds_elapsed,gyro_z,gyro_y,gyro_x,mag_x,mag_y,mag_z,{A3}"),
        *([NANOS, TIME, GYRO[:, ::-1], 30 + ACC, ACC], NS | {"acc": (4, 1), "mag": (3, 1)}, ""),
    ),
]


@pytest.mark.parametrize(("key", "header", "columns", "found", "said"), PLAIN)
def test_a_plain_layout(
    tmp_path: Path,
    key: str,
    header: str,
    columns: list[np.ndarray],
    found: dict[str, tuple[int, float]],
    said: str,
):
    lines = rows(*columns, separator=";" if ";" in header else ",")
    (table,) = tables(written(tmp_path, *([header] if header else []), *lines), key)
    assert said in f"{table.units} {' '.join(table.notes)}"
    for part, (at, factor) in {"t_s": (0, 1.0), **found}.items():
        wanted = columns[at] * factor if part == "t_s" else printed(columns[at]) * factor
        np.testing.assert_allclose(getattr(table, part), wanted, rtol=1e-12, atol=1e-9)
    if "gyro_z,gyro_y" in header:
        np.testing.assert_allclose(table.gyro, printed(GYRO), rtol=1e-12)
    elif not {"acc", "gyro"} <= found.keys():
        assert table.acc is None or table.gyro is None


NOTHING = np.full((COUNT, 3), np.nan)
EVEN = ACC / np.linalg.norm(ACC, axis=1, keepdims=True)
#: Tables that are refused, and what is to be done.
REFUSED = [
    (
        *("xsens-dot", "PacketCounter,SampleTimeFine,Quat_W,FreeAcc_X,FreeAcc_Y,FreeAcc_Z"),
        *([MICROS, MICROS, TWO[:, 0], ACC], "free acceleration is without gravity.*'Custom mode 5'"),
    ),
    ("xsens-mt", "Counter,SampleTimeFine,Mat[1][1],Mat[2][1]", [MICROS, MICROS, TWO], "calibrated data"),
    ("nilspod", f"t,{G3},{A3},baro,analog_0", [TIME, 16 * DEG, 2048 * ACC / 9.81, TWO], "uncalibrated"),
    ("phyphox", '"Time (s)","X (m/s^2)","Y (m/s^2)","Z (m/s^2)"', [TIME, 0 * ACC + 0.3], "without gravity"),
    (
        *("phyphox", '"Time (s)",' + ",".join(f'"Linear Acceleration {axis} (m/s^2)"' for axis in "xyz")),
        *([TIME, 0 * ACC + 0.3], "acceleration is without gravity"),
    ),
    ("android", XYZ, [NANOS, NOTHING], "No three columns look like"),
    ("android", XYZ, [NANOS, 45 * EVEN + 0.3 * GYRO], "looks like a magnetometer"),
    ("android", XYZ, [NANOS, 9.80665 * EVEN], "gravity as the system estimates it"),
]


@pytest.mark.parametrize(("key", "header", "columns", "said"), REFUSED)
def test_what_cannot_be_used_says_what_to_record(
    tmp_path: Path, key: str, header: str, columns: list[np.ndarray], said: str
):
    with pytest.raises(RecordingError, match=said):
        tables(written(tmp_path, header, *rows(*columns)), key)


# ---------------------------------------------------------------------------------------- Xsens DOT


def test_dot_with_dates_and_columns_in_another_order(tmp_path: Path):
    header = ",".join([*xyz("Gyr"), "SampleTimeFine", *xyz("Acc")[::-1]])
    stamps = [f"1970-01-01 00:00:{4 + k * 0.01:09.6f}" for k in range(COUNT)]
    left, right = rows(DEG), rows(ACC[:, ::-1])
    body = [f"{a},{stamp},{b}" for a, stamp, b in zip(left, stamps, right, strict=True)]
    (table,) = tables(written(tmp_path, header, *body), "xsens-dot")
    check(table, printed(ACC), np.radians(printed(DEG)), 4 + TIME)


def test_dot_increments_become_rates(tmp_path: Path):
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_rotvec(GYRO / 100).as_quat()[:, [3, 0, 1, 2]]
    turns[::2] *= -1  # the same turns
    header = "PacketCounter,SampleTimeFine,dQ_W,dQ_X,dQ_Y,dQ_Z,dV[1],dV[2],dV[3],Quat_W,Quat_X"
    body = rows(np.arange(COUNT), MICROS, turns, ACC / 100, np.ones((COUNT, 2)), form="{:.9f}")
    (table,) = tables(written(tmp_path, header, *body), "xsens-dot")
    np.testing.assert_allclose(table.acc, ACC, atol=1e-6)
    np.testing.assert_allclose(table.gyro, GYRO, atol=1e-6)
    assert "increments" in " ".join(table.notes)


# ---------------------------------------------------------------------------------------- Xsens MT


def test_mtw_with_empty_columns(tmp_path: Path):
    names = ["PacketCounter", "SampleTimeFine", "Year", *xyz("Acc"), *xyz("Gyr"), "Mat[1][1]", "Mat[2][1]"]
    body = [f"{k:05d}\t\t\t{row}" for k, row in enumerate(rows(ACC, GYRO, TWO, separator="\t"))]
    lines = ("// Update Rate: 100.0Hz", "\t".join(names), *body)
    check(tables(written(tmp_path, *lines), "xsens-mt")[0], printed(ACC), printed(GYRO))


def test_mt_manager_without_rate(tmp_path: Path):
    header = "\t".join(["PacketCounter", "SampleTimeFine", *xyz("Acc"), *xyz("Gyr"), "Roll"])
    body = [f"{k}\tNaN\t{row}" for k, row in enumerate(rows(ACC, GYRO, np.ones(COUNT), separator="\t"))]
    (table,) = tables(written(tmp_path, "// General information:", header, *body), "xsens-mt")
    with pytest.raises(RecordingError, match="neither times nor a rate"):
        repaired_imu(table, "a")


# ---------------------------------------------------------------------------------------- Shimmer
def shimmer(
    tmp_path: Path, *sensors: str, separator: str = ",", kind: str = "CAL", unit: str = "m/(s^2)"
) -> Path:
    names, units, columns = [], [], []
    for sensor in ("Shimmer_952D", "RWrist") if "two" in sensors else ("Shimmer_952D",):
        names.append(f"{sensor}_Timestamp_Unix_{kind}")
        units.append("ms")
        columns.append(1.6294033377807312e12 + 10.0 * np.arange(COUNT))
        for name, values in (("Accel_LN", ACC / 2), ("Accel_WR", ACC), ("Gyro", DEG), ("Mag", ACC)):
            if name not in sensors:
                names += [f"{sensor}_{name}_{axis}_{kind}" for axis in "XYZ"]
                units += [{"G": "deg/s", "M": "local_flux"}.get(name[0], unit)] * 3
                columns.append(values)
    body = rows(*columns, separator=separator, end=separator)
    header = [separator.join(cells) + separator for cells in (names, units)]
    return written(tmp_path, f'"sep={separator}"', *header, *body, newline="\r\n")


def test_shimmer_of_low_noise_and_of_two_sensors(tmp_path: Path):
    (table,) = tables(shimmer(tmp_path, "Accel_WR"), "shimmer")
    check(table, printed(ACC / 2), np.radians(printed(DEG)))
    assert "clips at 2 g" in " ".join(table.notes)
    both = tables(shimmer(tmp_path, "two"), "shimmer")
    assert [table.name for table in both] == ["Shimmer_952D", "RWrist"]


def test_shimmer_with_the_ticks_of_its_clock_alone(tmp_path: Path):
    path = shimmer(tmp_path)
    path.write_text(path.read_text().replace("Timestamp_Unix_CAL", "Timestamp_RAW"))
    (table,) = tables(path, "shimmer")
    np.testing.assert_allclose(table.t_s, (1.6294033377807312e12 + 1000 * TIME) / 32768, rtol=1e-12)


def test_shimmer_uncalibrated_or_without_gyroscope(tmp_path: Path):
    with pytest.raises(RecordingError, match=r"without a calibrated.*_CAL"):
        tables(shimmer(tmp_path, kind="RAW", unit="no_units"), "shimmer")
    with pytest.raises(RecordingError, match="calibrated accelerometer and gyroscope"):
        tables(shimmer(tmp_path, "Gyro"), "shimmer")


# ---------------------------------------------------------------------------------------- MetaMotion


def metamotion(values: np.ndarray, header: str) -> list[str]:
    ends = rows(TIME, values)
    body = [f"{e},2018-03-02T14.13.20.{e % 1000:03d},{end}" for e, end in zip(EPOCH, ends, strict=True)]
    return [*([header] if header else []), *body]


@pytest.mark.parametrize(
    "header", ["epoch (ms),time (-13:00),elapsed (s),x-axis ({u}),y-axis ({u}),z-axis ({u})", ""]
)
def test_metamotion(tmp_path: Path, header: str):
    acc_lines = metamotion(ACC / GRAVITY, header.format(u="g"))
    acc_lines[40] = ",".join([*acc_lines[40].split(",")[:5], "-124.874.1"])
    (acc,) = tables(written(tmp_path, *acc_lines), "metamotion")
    expected = printed(ACC / GRAVITY) * GRAVITY
    expected[39 if header else 40, 2] = np.nan
    check(acc, expected, None, EPOCH * 1e-3)
    assert "'-124.874.1' in line 41" in " ".join(acc.notes)
    (gyro,) = tables(written(tmp_path, *metamotion(DEG, header.format(u="deg/s"))), "metamotion")
    check(gyro, None, np.radians(printed(DEG)), EPOCH * 1e-3)
    assert gyro.units == "deg/s" and (bool(header) or "that of this device" in " ".join(gyro.notes))


def test_metamotion_of_fusion_says_what_to_record(tmp_path: Path):
    header = "epoch (ms),time (-13:00),elapsed (s),x-axis (g),y-axis (g),z-axis (g)"
    with pytest.raises(RecordingError, match=r"without gravity.*record the raw accelerometer"):
        tables(written(tmp_path, *metamotion(GYRO / 30, header)), "metamotion")


# ---------------------------------------------------------------------------------------- all
def test_a_wrong_unit_is_said(tmp_path: Path):
    def repaired(key: str, *lines: str) -> ImuTable:
        return repaired_imu(tables(written(tmp_path, *lines), key)[0], "a.csv")

    table = repaired("nilspod", "t,gyr_x,gyr_y,gyr_z,acc_x,acc_y,acc_z", *rows(TIME, GYRO, ACC))
    assert "only if that is in rad/s" in " ".join(table.notes)
    np.testing.assert_allclose(table.gyro, printed(GYRO), rtol=1e-12)
    dot = ",".join(["SampleTimeFine", *xyz("Acc"), *xyz("Gyr")])
    assert "probably rad/s" in " ".join(repaired("xsens-dot", dot, *rows(MICROS, ACC, GYRO)).notes)
    header = "\t".join(["Counter", *xyz("Acc"), *xyz("Gyr")])
    body = rows(np.arange(COUNT), ACC, DEG, separator="\t")
    table = repaired("xsens-mt", "// Update Rate: 100.0Hz", header, *body)
    assert "probably deg/s" in " ".join(table.notes)


def test_a_named_format_that_does_not_fit_says_so(tmp_path: Path):
    path = written(tmp_path, "a,b,c", *rows(TIME, TIME, TIME))
    for importer in formats():
        if importer.kind == "imu":
            assert not importer.recognises(read_head(path))
            with pytest.raises(RecordingError) as error:
                FileReader().read(path, importer)
            assert str(path) in str(error.value) and len(str(error.value)) < 500 + len(str(path))


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
    (table,) = tables(written(tmp_path, ",".join(header), *body), "sensorlog")
    assert np.allclose(table.acc, ACC, atol=3e-5)  # two numbers of six decimals in g
    np.testing.assert_allclose(table.gyro, printed(GYRO + 0.25 * (source == "motion")), atol=1e-12)
    assert table.t_s[0] == (9 if source == "motion" else 7)
    assert "gravity, which points down" in " ".join(table.notes)


def test_sensorlog_without_gyroscope(tmp_path: Path):
    header = ",".join(["loggingTime(txt)", *(f"accelerometerAcceleration{a}(G)" for a in "XYZ")])
    body = [f"2020-01-10 14:23:05.{k:03d} +0100,{row}" for k, row in enumerate(rows(ACC / GRAVITY))]
    with pytest.raises(RecordingError, match="Device Motion"):
        tables(written(tmp_path, header, *body), "sensorlog")


def test_android_with_dates(tmp_path: Path):
    dates = [f"2026-03-12 09:30:{t:09.6f}" for t in TIME]
    body = [f"{date},{row}" for date, row in zip(dates, rows(ACC), strict=True)]
    (table,) = tables(written(tmp_path, "timestamp,x,y,z", *body), "android")
    check(table, printed(ACC), None, 1_773_307_800 + TIME)


def test_android_log_with_names_of_sensors(tmp_path: Path):
    body = [
        row
        for k in range(COUNT)
        for row in (
            f"{EPOCH[k]},{10 * k},accel_g,{rows(ACC[k : k + 1] / GRAVITY)[0]}",
            f"{EPOCH[k]},{10 * k},gyro_dps,{rows(DEG[k : k + 1])[0]}",
        )
    ]
    acc, gyro = tables(written(tmp_path, "epoch_ms,elapsed_ms,sensor,x,y,z", *body), "android")
    check(acc, printed(ACC / GRAVITY) * GRAVITY, None, EPOCH * 1e-3)
    check(gyro, None, np.radians(printed(DEG)), EPOCH * 1e-3)


def test_the_other_file_settles_an_assumed_unit(tmp_path: Path):
    from smoother.io.tables.imu import paired

    slow = DEG / 4  # 21 deg/s at most: by its size it could be rad/s
    (gyro,) = tables(written(tmp_path, "timestamp,x,y,z", *rows(NANOS, slow)), "android")
    assert gyro.gyro_unit_assumed and gyro.units == "rad/s"
    acc, _ = motion(seed=1, slower=4)
    (acc_table,) = tables(written(tmp_path, "timestamp,x,y,z", *rows(NANOS, acc)), "android")
    table = paired([acc_table, gyro], "two files")
    np.testing.assert_allclose(table.gyro, np.radians(printed(slow)), atol=1e-12)
    assert "only if that is in deg/s" in " ".join(table.notes) and table.units == "m/s^2, deg/s"
