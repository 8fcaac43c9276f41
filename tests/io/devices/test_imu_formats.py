"""Importers of tables of sensors and phones: small files in each layout, values to the printed digits."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from importers import ACC, COUNT, DEG, EPOCH, GYRO, MICROS, NANOS, TIME, check, tables, written, xyz
from imu_files import GRAVITY, motion, printed, rows

from smoother.errors import RecordingError
from smoother.io import open_csv
from smoother.io.files import ImuFiles, import_files
from smoother.io.registry import FileReader, formats
from smoother.io.tables.imu import paired
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


META = "epoch (ms),time (-13:00),elapsed (s),x-axis ({u}),y-axis ({u}),z-axis ({u})"
META_TIMES = [EPOCH, np.array([f"2018-03-02T14.13.20.{e % 1000:03d}" for e in EPOCH]), TIME]


def three(*forms: str) -> str:
    """Names of a table with semicolons: a time, and x, y, z of each form."""
    return ";".join([forms[0], *(form.format(axis) for form in forms[1:] for axis in "xyz")])


def shimmer(*forms: str) -> str:
    """Names of a table of a Shimmer, its clock's ticks first."""
    return ",".join(["S_Timestamp_RAW", *(f"S_{form.format(axis)}" for form in forms for axis in "XYZ")])


#: Of ROS: names of axes behind a prefix, of the raw acceleration too; a device's name; others' columns.
ROS, LINEAR = (
    "{0}x,{0}y,{0}z",
    "{0}linear_acceleration{1}x,{0}linear_acceleration{1}y,{0}linear_acceleration{1}z",
)
NAMED, ONE, EVERY = np.array(["WT901"] * COUNT), TWO[:, 0], np.ones((COUNT, 3)) / 2
WATCH = [*xyz("gravity", "{}{}"), *xyz("acceleration", "{}{}")]
DOT = ",".join([*xyz("Gyr"), "SampleTimeFine", *xyz("Acc")])
DATES = np.array([f"1970-01-01 00:00:{4 + k * 0.01:09.6f}" for k in range(COUNT)])
WHEN = np.array([f"2026-03-12 09:30:{t:09.6f}" for t in TIME])
WHEN_S = (1_773_307_800 + TIME, 1)
#: Of each layout key and header, its columns; what they are read as; what is said.
PLAIN = [
    ("nilspod", f"t,{G3},{A3},baro,analog_0", [TIME, DEG, ACC, TWO], {"gyro": (1, D), "acc": (2, 1)}, ""),
    (
        *("xsens-mt", f"PacketCounter,SampleTimeFine,{A3},{G3},Quat_q0"),
        [np.arange(COUNT), 10_000 + 100 * np.arange(COUNT), ACC, GYRO, TWO[:, 0]],
        *({"t_s": (1, 1e-4), "acc": (2, 1), "gyro": (3, 1)}, "m/s^2, rad/s"),
    ),
    (
        "nilspod",
        f"t_ms,{A3},gyro_x,gyro_y,gyro_z",
        [1000 * TIME, ACC / G, DEG],
        {**MS, "acc": (1, G), "gyro": (2, D)},
        "",
    ),
    *(
        ("metamotion", header, [*META_TIMES, values], MS | found, said)
        for values, unit, found, said in (
            (ACC / G, "g", {"acc": (3, G)}, ""),
            (DEG, "deg/s", {"gyro": (3, D)}, "deg/s"),
        )
        for header in (META.format(u=unit), "")
    ),
    (
        *("shimmer", shimmer("Accel_LN_{}_CAL", "Gyro_{}_CAL"), [MICROS, ACC / 2, DEG]),
        *({"t_s": (0, 1 / 32768), "acc": (1, 1), "gyro": (2, D)}, "clips at 2 g"),
    ),
    (
        "shimmer",
        shimmer("Accel_LN_{}_CAL", "Accel_WR_{}_CAL", "Gyro_{}_CAL"),
        [MICROS, ACC / 2, ACC, DEG],
        *({"t_s": (0, 1 / 32768), "acc": (2, 1), "gyro": (3, D)}, "wide-range one was taken"),
    ),
    ("xsens-dot", DOT, [DEG, DATES, ACC], {"gyro": (0, D), "acc": (2, 1), "t_s": (TIME + 4, 1)}, ""),
    ("phyphox", '"Time (s)","X (m/s^2)","Y (m/s^2)","Z (m/s^2)"', [TIME, ACC], FORCE, "stated"),
    ("phyphox", '"Time (s)","X (rad/s)","Y (rad/s)","Z (rad/s)"', [TIME, GYRO], TURN, "stated"),
    ("android", XYZ, [NANOS, ACC], NS | FORCE, "it reads 9.8 as a rule"),
    ("android", XYZ, [WHEN, ACC], FORCE | {"t_s": (1_773_307_800 + TIME, 1)}, ""),
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
    *(
        ("android", three(*names), [1000 * TIME, ACC / G, DEG], {**MS, "acc": (1, G), "gyro": (2, D)}, "")
        for names in (
            ("Zeitstempel (ms)", "Beschleunigung {} [g]", "Drehrate {} [°/s]"),
            ("Temps (ms)", "Accélération {} (g)", "Vitesse angulaire {} (deg/s)"),
            ("Tiempo (ms)", "Aceleración {} (g)", "Velocidad angular {} (°/s)"),
            ("Zeit [ms]", "Beschleunigungssensor {} [g]", "Gyroskop {} [deg/s]"),
        )
    ),
    (
        *("android", f"time,seconds_elapsed,gyro_z,gyro_y,gyro_x,mag_x,mag_y,mag_z,{A3}"),
        *([NANOS, TIME, GYRO[:, ::-1], 30 + ACC, ACC], NS | {"acc": (4, 1), "mag": (3, 1)}, ""),
    ),
    # Physics Toolbox, ROS (rostopic echo, PlotJuggler), WitMotion, Movesense, an AX6 without header
    (
        "android",
        "time,gFx,gFy,gFz,wx,wy,wz,TgF",
        [TIME, ACC / G, GYRO, ONE],
        {"acc": (1, G), "gyro": (2, 1)},
        "",
    ),
    (
        *(
            "android",
            f"%time,field.header.seq,{ROS.format('field.angular_velocity.')},{LINEAR.format('field.', '.')}",
        ),
        *([NANOS, np.arange(COUNT), GYRO, ACC], NS | {"gyro": (2, 1), "acc": (3, 1)}, ""),
    ),
    (
        "android",
        ",".join(
            [
                "__time",
                ROS.format("/a/angular_velocity/"),
                LINEAR.format("/a/", "/"),
                ROS.format("/a/orientation/"),
            ]
        ),
        *([TIME, GYRO, ACC, EVERY], {"gyro": (1, 1), "acc": (2, 1)}, ""),
    ),
    *(
        ("android", header, [WHEN, NAMED, ACC / G, DEG], {"acc": (2, G), "gyro": (3, D), "t_s": WHEN_S}, "")
        for header in (
            "time\tDeviceName\tAccX(g)\tAccY(g)\tAccZ(g)\tAsX(°/s)\tAsY(°/s)\tAsZ(°/s)",
            "时间\t设备名称\t加速度X(g)\t加速度Y(g)\t加速度Z(g)\t角速度X(°/s)\t角速度Y(°/s)\t角速度Z(°/s)",
        )
    ),
    ("android", "Timestamp (ms),X: (dps),Y: (dps),Z: (dps)", [1000 * TIME, DEG], MS | {"gyro": (1, D)}, ""),
    (
        "imu-table",
        "",
        [WHEN, ACC / G, DEG],
        {"acc": (1, G), "gyro": (2, D), "t_s": WHEN_S},
        "names no columns",
    ),
    (
        *(
            "android",
            "time,accelerometer_x,accelerometer_y,accelerometer_z,totalAcceleration_x,totalAcceleration_y,"
            f"totalAcceleration_z,{G3}",
        ),
        *([TIME, 0 * ACC, ACC, GYRO], {"acc": (2, 1), "gyro": (3, 1)}, ""),
    ),
    # Core Motion by apps of one's own, Sensor Logger's on a watch, and that in Android's units
    (
        *(
            "sensorlog",
            "t,acceleration.x,acceleration.y,acceleration.z,rotationRate.x,rotationRate.y,rotationRate.z",
        ),
        *([TIME, -ACC / G, GYRO], {"acc": (1, -G), "gyro": (2, 1)}, "turned to specific force"),
    ),
    *(
        (
            *("sensorlog", "time,seconds_elapsed," + ",".join(xyz("rotationRate", "{}{}") + WATCH)),
            *([NANOS, TIME, GYRO, -ACC / one, 0 * ACC], NS | {"gyro": (2, 1), "acc": (3, -one)}, said),
        )
        for one, said in ((G, "turned to specific force"), (-1, "m/s^2, rad/s"))
    ),
    # days of a spreadsheet and of MATLAB; minutes and seconds, as a spreadsheet shows them
    *(
        ("android", f"Time,{A3},{G3}", [times, ACC, GYRO], {"acc": (1, 1), "gyro": (2, 1), "t_s": found}, "")
        for times, found in (
            (np.array([f"{43367.5 + t / 86400:.12f}" for t in TIME]), (1_537_790_400 + TIME, 1)),
            (np.array([f"{737327.5 + t / 86400:.12f}" for t in TIME]), (1_537_790_400 + TIME, 1)),
            (
                np.array([f"{(59 + (58 + t) // 60) % 60:02.0f}:{(58 + t) % 60:05.2f}" for t in TIME]),
                (3598 + TIME, 1),
            ),
        )
    ),
]


@pytest.mark.parametrize(("key", "header", "columns", "found", "said"), PLAIN)
def test_a_plain_layout(
    tmp_path: Path, key: str, header: str, columns: list[np.ndarray], found: dict[str, tuple], said: str
):
    mark = next((mark for mark in ";\t" if mark in header), ",")
    parts = [each.tolist() if each.dtype.kind == "U" else rows(each, separator=mark) for each in columns]
    lines = [mark.join(cells) for cells in zip(*parts, strict=True)]
    (table,) = tables(written(tmp_path, *([header] if header else []), *lines), key)
    assert said in f"{table.units} {' '.join(table.notes)}"
    for part, (at, factor) in {"t_s": (0, 1.0), **found}.items():
        wanted = at if isinstance(at, np.ndarray) else columns[at] if part == "t_s" else printed(columns[at])
        np.testing.assert_allclose(getattr(table, part), wanted * factor, rtol=1e-12, atol=1e-9)
    if "gyro_z,gyro_y" in header:
        np.testing.assert_allclose(table.gyro, printed(GYRO), rtol=1e-12)
    elif not {"acc", "gyro"} <= found.keys():
        assert table.acc is None or table.gyro is None


NOTHING = np.full((COUNT, 3), np.nan)
EVEN = ACC / np.linalg.norm(ACC, axis=1, keepdims=True)
PHYPHOX = '"Time (s)","X (m/s^2)","Y (m/s^2)","Z (m/s^2)"'
KG, DG = ("K x [m/s^2],K y [m/s^2],K z [m/s^2]", "D x [rad/s],D y [rad/s],D z [rad/s]")
#: Tables that are refused, and what is to be done.
REFUSED = [
    (
        *("xsens-dot", "PacketCounter,SampleTimeFine,Quat_W,FreeAcc_X,FreeAcc_Y,FreeAcc_Z"),
        *([MICROS, MICROS, TWO[:, 0], ACC], "free acceleration is without gravity.*'Custom mode 5'"),
    ),
    ("xsens-mt", "Counter,SampleTimeFine,Mat[1][1],Mat[2][1]", [MICROS, MICROS, TWO], "calibrated data"),
    ("nilspod", f"t,{G3},{A3},baro,analog_0", [TIME, 16 * DEG, 2048 * ACC / 9.81, TWO], "uncalibrated"),
    ("nilspod", f"t,{G3},{A3},baro,analog_0", [TIME, 16 * DEG, 8192 * ACC / 9.81, TWO], "uncalibrated"),
    ("phyphox", PHYPHOX, [TIME, 0 * ACC + 0.3], "without gravity"),
    (
        *("phyphox", '"Time (s)",' + ",".join(f'"Linear Acceleration {axis} (m/s^2)"' for axis in "xyz")),
        *([TIME, 0 * ACC + 0.3], "acceleration is without gravity"),
    ),
    ("android", XYZ, [NANOS, NOTHING], "No three columns look like"),
    ("android", XYZ, [NANOS, 45 * EVEN + 0.3 * GYRO], "looks like a magnetometer"),
    ("android", XYZ, [NANOS, 9.80665 * EVEN], "gravity as the system estimates it"),
    (
        *("shimmer", shimmer("Accel_LN_{}_RAW", "Gyro_{}_RAW"), [MICROS, ACC, GYRO]),
        r"without a calibrated accelerometer and gyroscope.*_CAL",
    ),
    (
        "sensorlog",
        ",".join(["loggingTime(txt)", *xyz("accelerometerAcceleration", "{}{}(G)")]),
        [TIME, ACC],
        "Motion",
    ),
    ("metamotion", META.format(u="g"), [EPOCH, TIME, TIME, GYRO / 30], r"without gravity.*record the raw"),
    ("imu-table", f"{KG},{DG}", [ACC, GYRO], "no column of times"),
    ("android", f"t_s,{KG},{DG}", [TIME, 0.01 * ACC, GYRO], "without gravity"),
]


@pytest.mark.parametrize(("key", "header", "columns", "said"), REFUSED)
def test_what_cannot_be_used_says_what_to_record(
    tmp_path: Path, key: str, header: str, columns: list[np.ndarray], said: str
):
    with pytest.raises(RecordingError, match=said):
        tables(written(tmp_path, header, *rows(*columns)), key)


@pytest.mark.parametrize("kind", ["dot", "mt"])
def test_increments_become_rates(tmp_path: Path, kind: str):
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_rotvec(GYRO / 100).as_quat()[:, [3, 0, 1, 2]]
    turns[::2] *= -1  # the same turns
    header = "PacketCounter,SampleTimeFine,dQ_W,dQ_X,dQ_Y,dQ_Z,dV[1],dV[2],dV[3],Quat_W,Quat_X"
    if kind == "mt":
        names = ("VelInc", "OriInc_q")
        header = ",".join(["Counter,A", *(f"OriInc_q{k}" for k in range(4)), *xyz(names[0]), "Quat_q0,B"])
    first = () if kind == "dot" else ("// Update Rate: 100.0Hz",)
    body = rows(np.arange(COUNT), MICROS, turns, ACC / 100, np.ones((COUNT, 2)), form="{:.9f}")
    (table,) = tables(written(tmp_path, *first, header, *body), f"xsens-{kind}")
    np.testing.assert_allclose(table.acc, ACC, atol=1e-6)
    np.testing.assert_allclose(table.gyro, GYRO, atol=1e-6)
    assert "increments" in " ".join(table.notes)


def test_mtw_with_empty_columns_and_without_a_rate(tmp_path: Path):
    names = ["PacketCounter", "SampleTimeFine", "Year", *xyz("Acc"), *xyz("Gyr"), "Mat[1][1]", "Mat[2][1]"]
    body = [f"{k:05d}\t\t\t{row}" for k, row in enumerate(rows(ACC, GYRO, TWO, separator="\t"))]
    lines = ("// Update Rate: 100.0Hz", "\t".join(names), *body)
    check(tables(written(tmp_path, *lines), "xsens-mt")[0], printed(ACC), printed(GYRO))
    for stated, rate_hz in (("62,5Hz", 62.5), ("1,000 Hz", None), ("100.0Hz", 100.0)):
        (table,) = tables(written(tmp_path, f"// Update Rate: {stated}", *lines[1:]), "xsens-mt")
        assert table.rate_hz == rate_hz
    (table,) = tables(written(tmp_path, "// General information:", *lines[1:]), "xsens-mt")
    with pytest.raises(RecordingError, match="neither times nor a rate"):
        repaired_imu(table, "a")


@pytest.mark.parametrize(
    ("key", "header", "columns", "said"),
    [
        ("nilspod", f"t,{G3},{A3}", [TIME, GYRO, ACC], "rad/s"),
        ("xsens-dot", f"SampleTimeFine,{A3},{G3}", [MICROS, ACC, GYRO], "rad/s"),
        ("xsens-mt", f"// Update Rate: 100.0Hz\nCounter,{A3},{G3}", [MICROS, ACC, DEG], "deg/s"),
    ],
)
def test_a_wrong_unit_is_said(tmp_path: Path, key: str, header: str, columns: list[np.ndarray], said: str):
    table = repaired_imu(tables(written(tmp_path, header, *rows(*columns)), key)[0], "a.csv")
    assert f"The gyroscope is in {said}, as the motion shows" in " ".join(table.notes)
    np.testing.assert_allclose(table.gyro, printed(GYRO), rtol=0, atol=1e-5)


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
    names, columns = (
        ["loggingTime(txt)", *(f"{w}Timestamp_sinceReboot(s)" for w in ("accelerometer", "motion"))],
        [],
    )
    for name, unit, values, kind in (
        ("accelerometerAcceleration", "G", -ACC / GRAVITY, "raw"),
        ("gyroRotation", "rad/s", GYRO, "raw"),
        ("motionUserAcceleration", "G", up - ACC / GRAVITY, "motion"),
        ("motionGravity", "G", np.tile(-up, (COUNT, 1)), "motion"),
        ("motionRotationRate", "rad/s", GYRO + 0.25, "motion"),
    ):
        names += [f"{name}{a}({unit})" if units else f"{name}{a}" for a in "XYZ"]
        columns.append([",,"] * COUNT if source not in (kind, "both") else rows(values))
    body = [
        ",".join((f"2020-01-10 14:23:{5 + t:06.3f} +0100", f"{7 + t:.6f}", f"{9 + t:.6f}", *cells))
        for t, *cells in zip(TIME, *columns, strict=True)
    ]
    (table,) = tables(written(tmp_path, ",".join(names), *body), "sensorlog")
    assert np.allclose(table.acc, ACC, atol=3e-5)  # two numbers of six decimals in g
    np.testing.assert_allclose(table.gyro, printed(GYRO + 0.25 * (source == "motion")), atol=1e-12)
    assert table.t_s[0] == (9 if source == "motion" else 7)
    assert "gravity, which points down" in " ".join(table.notes)


NEXUS = (
    "Devices",
    "100",
    ",,Wrist - Acc,,,Wrist - Gyro,,",
    "Frame,Sub Frame,X,Y,Z,X,Y,Z",
    ",,g,g,g,rad/s,rad/s,rad/s",
)
ROW = np.arange(COUNT)
DELSYS = [f"{name} {axis}{end}" for name, unit in (("ACC", "(G)"), ("GYRO", "(deg/s)")) for axis in "XYZ"
          for end in (" Time Series (s)", f" {unit}")]  # fmt: skip
OWN = [values for three in (ACC / G, DEG) for values in three.T]
TIMED = [each for values in OWN for each in (TIME, values)]
BY_ROWS = ("DeviceName,time_s," + A3 + "," + G3,)
TWICE, LEFT = np.repeat(TIME, 2), np.tile(["wrist", "belt"], COUNT)
#: Lines above the rows and columns of tables of several sensors, or with words above the names.
ABOVE = {
    "nexus": (NEXUS, [ROW, 0 * ROW, ACC / G, GYRO]),
    "delsys": (("Application:,Trigno Discover", ",".join(DELSYS), ",100.0 Hz" * 6, ",0.01 s" * 6), TIMED),
    "two of delsys": (
        (",".join(["wrist", *[""] * 11, "belt", *[""] * 11]), ",".join(DELSYS * 2), ",100.0 Hz" * 12),
        [*TIMED, *(values[::-1] if values is not TIME else TIME for values in TIMED)],
    ),
    "noraxon": (
        (
            "time,"
            + ",".join(f"{one} Accel Sensor {axis} RT (mG)" for one in ("Belt", "Wrist") for axis in "XYZ")
            + "".join(f",Noraxon MyoMotion-Segments-{place} RT-Gyroscope-{axis} (deg/s)"
                      for place in ("Wrist", "Belt") for axis in "xyz"),
        ),
        [TIME, 1000 * ACC[::-1] / G, 1000 * ACC / G, DEG, DEG[::-1]],
    ),
    "rows by device": (BY_ROWS, [LEFT, TWICE, np.repeat(ACC / G, 2, axis=0), np.repeat(DEG, 2, axis=0)]),
    "a device in some rows": (BY_ROWS, [np.resize(["wrist", ""], COUNT), TIME, ACC / G, DEG]),
    "a rate in words": (("Low-pass: 20 Hz", "GT9X v1.7 at 100 Hz", "---", f"{A3},{G3}"), [ACC / G, DEG]),
}  # fmt: skip


@pytest.mark.parametrize("case", ABOVE)
def test_tables_of_several_sensors_and_words_above_the_names(tmp_path: Path, case: str):
    above, columns = ABOVE[case]
    parts = [each.tolist() if each.dtype.kind == "U" else rows(each) for each in columns]
    path = written(tmp_path, *above, *(",".join(cells) for cells in zip(*parts, strict=True)))
    file = None
    if case in ("two of delsys", "noraxon", "rows by device"):
        with pytest.raises(RecordingError, match=r"2 sensors.*choose one for forearm_right.*#(wrist|belt)"):
            import_files([], [ImuFiles((path,), "forearm_right")])
        name = "wrist_rt" if case == "noraxon" else "wrist"
        file, _ = import_files([], [ImuFiles((path,), "forearm_right", name)])
    (imu,) = (file or import_files([], [ImuFiles((path,), "forearm_right")])[0]).imus
    np.testing.assert_allclose(imu.acc, ACC, atol=1e-4)
    np.testing.assert_allclose(imu.gyro, GYRO, atol=1e-4)
    np.testing.assert_allclose((imu.stamp_ns - imu.stamp_ns[0]) / 1e9, TIME, atol=1e-6)


def test_channels_at_different_rates_and_a_second_table(tmp_path: Path):
    columns = [*TIMED[:6], *(np.where(each is TIME, 2, 1) * each for each in TIMED[6:])]
    with pytest.raises(RecordingError, match="channels have different times; export each sensor at one rate"):
        tables(written(tmp_path, ",".join(DELSYS), *rows(*columns)), "imu-table")
    path = written(
        tmp_path, *NEXUS, *rows(ROW, 0 * ROW, ACC / G, GYRO), "", *NEXUS[:-1], *rows(ROW, ROW, DEG, DEG)
    )
    (imu,) = tables(path, "imu-table")
    assert len(imu) == COUNT and f"second table begins in line {COUNT + 7} ('Devices')" in " ".join(imu.notes)


def test_android_log_with_names_of_sensors(tmp_path: Path):
    pairs = zip(EPOCH, rows(ACC / GRAVITY), rows(DEG), strict=True)
    body = [f"{e},0,{name},{row}" for e, a, g in pairs for name, row in (("accel_g", a), ("gyro_dps", g))]
    acc, gyro = tables(written(tmp_path, "epoch_ms,elapsed_ms,sensor,x,y,z", *body), "android")
    check(acc, printed(ACC / GRAVITY) * GRAVITY, None, EPOCH * 1e-3)
    check(gyro, None, np.radians(printed(DEG)), EPOCH * 1e-3)


def test_rows_that_hold_the_one_sensor_or_the_other(tmp_path: Path):
    acc = [f"{t:.4f},{a},,," for t, a in zip(TIME, rows(ACC), strict=True)]
    gyro = [f"{t + 0.003:.4f},,,,{g}" for t, g in zip(TIME, rows(GYRO), strict=True)]
    body = [row for pair in zip(acc, gyro, strict=True) for row in pair]
    file, _ = import_files([], [ImuFiles((written(tmp_path, f"time,{A3},{G3}", *body),), "forearm_right")])
    (imu,) = file.imus
    assert len(imu.gyro) == COUNT - 1 and any("interpolated to the gyroscope's" in n for n in file.notes)
    np.testing.assert_allclose(imu.gyro, printed(GYRO)[:-1], atol=1e-9)
    # of a log with names of sensors the total acceleration is taken
    logs = {"Accelerometer": 0 * ACC, "TotalAcceleration": ACC, "Gyroscope": GYRO}
    lines = [
        f"{t:.4f},{name},{row}"
        for name, values in logs.items()
        for t, row in zip(TIME, rows(values), strict=True)
    ]
    first, second = tables(written(tmp_path, "time,sensor,x,y,z", *lines), "android")
    check(first, printed(ACC), None)
    check(second, None, printed(GYRO))


def test_the_other_file_settles_an_assumed_unit(tmp_path: Path):
    slow = DEG / 4  # 21 deg/s at most: by its size it could be rad/s
    (gyro,) = tables(written(tmp_path, "timestamp,x,y,z", *rows(NANOS, slow)), "android")
    assert gyro.units == "rad/s"
    acc, _ = motion(seed=1, slower=4)
    (acc_table,) = tables(written(tmp_path, "timestamp,x,y,z", *rows(NANOS, acc)), "android")
    table = paired([acc_table, gyro], "two files")
    np.testing.assert_allclose(table.gyro, np.radians(printed(slow)), atol=1e-12)
    assert "is in deg/s, as the motion shows" in " ".join(table.notes) and table.units == "m/s^2, deg/s"


@pytest.mark.parametrize(("faster", "told"), [(200.0, True), (1.5, False)])
def test_of_two_files_of_a_shaken_wrist_the_one_about_1_g_is_the_accelerometer(
    tmp_path: Path, faster: float, told: bool
):
    """Neither shows gravity by itself; where both may be it, the remedy of the message works."""
    size = np.random.default_rng(4).choice([0.4, 0.6, 1.02, 1.1, 1.5, 2.2], COUNT)
    force = size[:, None] * ACC / np.linalg.norm(ACC, axis=1, keepdims=True)
    fast = faster * force[::-1]
    for name, values in (("acc.csv", force), ("gyro.csv", fast)):
        lines = [f"{when},{row}" for when, row in zip(WHEN, rows(values), strict=True)]
        (tmp_path / name).write_text("\n".join([*lines, ""]))
    pair = ImuFiles((tmp_path / "gyro.csv", tmp_path / "acc.csv"), "forearm_right")
    if told:
        file, _ = import_files([], [pair])
        assert any("reads about 1 g as a rule" in note for note in file.notes)
    else:
        with pytest.raises(RecordingError, match=r"name its columns and unit in a recording\.toml"):
            import_files([], [pair])
        (tmp_path / "recording.toml").write_text(
            '[imu.forearm_right]\nfile = ["acc.csv", "gyro.csv"]\ntime_unit="iso"\naccelerometer_unit = "g"\n'
            "columns = [{t = 1, ax = 2, ay = 3, az = 4}, {t = 1, gx = 2, gy = 3, gz = 4}]\n"
        )
        file = open_csv(tmp_path)
    (imu,) = file.imus
    np.testing.assert_allclose(np.linalg.norm(imu.acc, axis=1), size * G, atol=1e-3)
    np.testing.assert_allclose(imu.gyro, (np.radians(fast) if told else fast), atol=1e-4)


def test_dates_and_three_numbers_in_two_files_that_start_apart(tmp_path: Path):
    """`date,x,y,z` as a watch writes it: no header, some stamps repeat or go back."""
    acc, gyro = motion(400)
    t_s = np.arange(400) * 0.01
    stamps = 1_773_300_000_000 + (1000 * t_s).astype(int)
    stamps[50], stamps[120], stamps[300] = stamps[49], stamps[119] - 5, stamps[299]
    dates = [f"{datetime.fromtimestamp(stamp / 1e3, UTC):%Y-%m-%d %H:%M:%S.%f}" for stamp in stamps]
    for name, values, late in (("a.csv", acc, 0), ("g.csv", np.degrees(gyro), 70)):
        lines = zip(dates[late:], rows(values)[late:], strict=True)
        (tmp_path / name).write_text("".join(f"{date},{row}\n" for date, row in lines))
    pair = ImuFiles((tmp_path / "a.csv", tmp_path / "g.csv"), "forearm_right")
    file, (first, second) = import_files([], [pair])
    since = (file.imus[0].stamp_ns - 1_773_300_000_000_000_000) / 1e9
    assert since[0] == pytest.approx(0.7, abs=0.02)
    at = np.searchsorted(t_s, since - 0.004)
    assert np.median(np.abs(file.imus[0].acc - acc[at])) < 1e-3
    assert np.median(np.abs(file.imus[0].gyro - gyro[at])) < 1e-3
    said = " ".join([*first.notes, *second.notes])
    assert "assumed a gyroscope" in said and "repeat or go back" in said
