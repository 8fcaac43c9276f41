"""A small file of every layout that `import files` knows, of one motion and of one body."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import skeleton_files as made
from imu_files import GRAVITY, motion, rows

from smoother.io.tables.joints import AZURE, BLAZEPOSE, KINECT_V2

COUNT, FRAMES = 80, 12
ACC, GYRO = motion(COUNT)
DEG = np.degrees(GYRO)
TIME = np.arange(COUNT) * 0.01
MICROS = (np.arange(COUNT) * 10_000 + 4_000_000).astype(np.int64)
NANOS = (np.arange(COUNT) * 10_000_000 + 123_456_789_000).astype(np.int64)


def _xyz(form: str) -> list[str]:
    return [form.format(axis) for axis in "XYZ"]


def _lines(path: Path, *lines: str) -> None:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _table(*lines: str, columns: tuple[np.ndarray, ...], **layout: str) -> Callable[[Path], None]:
    """Writes a plain table: the lines above the rows, the header last, and the columns."""
    return lambda path: _lines(path, *lines, *rows(*columns, **layout))


#: One of each plain table of an IMU; a new one is tested by being here.
xsens_dot = _table(
    *("sep=,", "DeviceTag:,left wrist", "OutputRate:,100Hz", ""),
    ",".join(["PacketCounter", "SampleTimeFine", *_xyz("Acc_{}"), *_xyz("Gyr_{}")]),
    columns=(np.arange(1, COUNT + 1), MICROS, ACC, DEG),
)
xsens_mt = _table(
    *("// Start Time: 0", "// Update Rate: 100.0Hz"),
    "\t".join(["Counter", *_xyz("Acc_{}"), *_xyz("Gyr_{}"), *_xyz("Mag_{}")]),
    columns=((65_500 + np.arange(COUNT)) % 65_536, ACC, GYRO, ACC),
    separator="\t",
    end="\t",
)
shimmer = _table(
    '"sep=,"',
    ",".join(["S_Timestamp_Unix_CAL", *_xyz("S_Accel_WR_{}_CAL"), *_xyz("S_Gyro_{}_CAL")]) + ",",
    ",".join(["ms", *["m/(s^2)"] * 3, *["deg/s"] * 3]) + ",",
    columns=(1.6294033377807312e12 + 10.0 * np.arange(COUNT), ACC, DEG),
    end=",",
)
ximu = _table(
    ",".join(["Timestamp (us)", *_xyz("Gyroscope {} (deg/s)"), *_xyz("Accelerometer {} (g)")]),
    columns=(MICROS, DEG, ACC / GRAVITY),
)
nilspod = _table(
    "t,gyr_x,gyr_y,gyr_z,acc_x,acc_y,acc_z,baro",
    columns=(TIME, DEG, ACC, np.ones(COUNT)),
)
phyphox = _table(
    ",".join(
        f'"{name}"' for name in ("Time (s)", *_xyz("Acceleration {} (m/s^2)"), *_xyz("Gyroscope {} (rad/s)"))
    ),
    columns=(TIME, ACC, GYRO),
    form="{:.9E}",
)
named = _table(
    ";".join(["Lauf [ms]", *_xyz("K1 {} [g]"), *_xyz("D1 {} [deg/s]")]),
    columns=(MICROS / 1e3, ACC / GRAVITY, DEG),
    separator=";",
)
android = _table("timestamp,ax,ay,az,gx,gy,gz", columns=(NANOS, ACC, GYRO))


def _of_sensors(form: str) -> list[str]:
    """A column of each axis and quantity of two sensors."""
    kinds = [
        (each, kind) for each in ("Right Wrist", "Sternum") for kind in ("Acceleration", "Angular Velocity")
    ]
    return [form.format(*each, axis) for each in kinds for axis in "XYZ"]


#: As Motion Studio exports it, two sensors.
apdm = _table(
    *("Test Name:,7", "Sample Rate:,100,Hz", ",".join(["Time", *_of_sensors("{}/{}/{}")])),
    ",".join(["s", *(["m/s^2"] * 3 + ["rad/s"] * 3) * 2]),
    columns=(TIME, ACC, GYRO, ACC, GYRO),
)


def metamotion(path: Path, values: np.ndarray = ACC / GRAVITY, unit: str = "g") -> None:
    """As MetaBase writes it: one of its two files."""
    header = f"epoch (ms),time (-13:00),elapsed (s),x-axis ({unit}),y-axis ({unit}),z-axis ({unit})"
    epoch = 1_520_000_000_000 + 10 * np.arange(COUNT)
    ends = rows(TIME, values)
    body = [f"{e},2018-03-02T14.13.20.{e % 1000:03d},{end}" for e, end in zip(epoch, ends, strict=True)]
    _lines(path, header, *body)


def sensorlog(path: Path) -> None:
    """As SensorLog on a phone writes it."""
    header = [
        *("loggingTime(txt)", "accelerometerTimestamp_sinceReboot(s)"),
        *_xyz("accelerometerAcceleration{}(G)"),
        *_xyz("gyroRotation{}(rad/s)"),
    ]
    stamps = [f"2020-01-10 14:23:{5 + t:06.3f} +0100" for t in TIME]
    body = rows(7 + TIME, -ACC / GRAVITY, GYRO)
    _lines(path, ",".join(header), *(f"{s},{row}" for s, row in zip(stamps, body, strict=True)))


def mvnx(
    path: Path,
    values: Sequence[tuple[str, np.ndarray]] = (("sensorAcceleration", ACC), ("sensorAngularVelocity", GYRO)),
    labels: Sequence[str] = ("RightForeArm",),
) -> None:
    """As MVN exports it with these sensors, of which values have 3 columns each."""
    frames = '<frame time="" type="identity"><orientation>1 0 0 0</orientation></frame>'
    for k in range(COUNT):
        cells = [f"<{name}>{' '.join(f'{v:.6f}' for v in row[k])}</{name}>" for name, row in values]
        frames += f'<frame time="{10 * k}" index="{k}" type="normal">{"".join(cells)}</frame>'
    named = "".join(f'<sensor label="{label}"/>' for label in labels)
    path.write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<mvnx xmlns="http://www.xsens.com/mvn/mvnx" version="4">\n'
        f'<subject label="A" frameRate="100"><sensors>{named}</sensors><frames>{frames}</frames>'
        "</subject></mvnx>"
    )


#: Numbers of an AX6 at 8 g and 1000 deg/s.
AX6 = np.hstack([DEG * 32768 / 1000, ACC / GRAVITY * 4096])


def axivity(path: Path, counts: np.ndarray = AX6, axes: int = 6) -> None:
    """As an AX6 writes these numbers of 16 bits at 100 Hz, 40 a block."""
    raw = bytearray(b"MD" + struct.pack("<H", 1020)) + bytes(1020)
    for k in range(len(counts) // 40):
        second, part = divmod(7 + 0.4 * k, 1)
        stamp = 21 << 26 | 8 << 22 | 20 << 17 | 20 << 12 | 21 << 6 | int(second)
        fraction = 0x8000 | int(part * 32768)
        # the firmware takes whole samples off the offset
        adjusted = -((((fraction & 0x7FFF) << 1) * 100) >> 16)
        light = 4 << 13 | 3 << 10 | 500
        numbers = (508, fraction, 1, k, stamp, light, 0, 0, 200, 0x6A, axes << 4 | 2, adjusted, 40)
        block = struct.pack("<2sHHIIIHHBBBBhH", b"AX", *numbers)
        block += np.rint(counts[40 * k : 40 * k + 40]).astype("<i2").tobytes()
        total = sum(struct.unpack("<255H", block)) & 0xFFFF
        raw += block + struct.pack("<H", -total & 0xFFFF)
    path.write_bytes(bytes(raw))


def _joints(first: str, names: Sequence[str], t: np.ndarray, points: np.ndarray) -> Callable[[Path], None]:
    """Writes a table of joints (F, J, 3), the frames' times or numbers first."""
    header = [first, *(f"{name}_{axis}" for name in names for axis in "xyz")]
    return _table(",".join(header), columns=(t, points.reshape(FRAMES, -1)))


SIX = [f"{side}_{joint}" for side in ("left", "right") for joint in ("shoulder", "elbow", "wrist")]
AZURE_MM = 1000 * made.optical(made.parts(AZURE, FRAMES))
kinect_v2 = _joints("time_ms", KINECT_V2, 33.333 * np.arange(FRAMES), made.kinect_v2(FRAMES))
#: World landmarks.
mediapipe = _joints("frame", BLAZEPOSE, np.arange(FRAMES), made.landmarks(FRAMES))
joint_table = _joints("time", SIX, np.arange(FRAMES) / 30, made.parts(SIX, FRAMES))
#: 32 joints without a header, mm.
bare_kinect = _table(columns=(AZURE_MM.reshape(FRAMES, -1),))


def joint_rows(path: Path) -> None:
    """One row per joint."""
    body = [
        f"{k / 30:.6f},{name},{','.join(f'{v:.6f}' for v in made.part(name, FRAMES)[k])}"
        for k in range(FRAMES)
        for name in ("LShoulder", "LElbow", "LWrist", "RShoulder", "RElbow", "RWrist", "midhip", "head")
    ]
    _lines(path, "time,joint,x,y,z", *body)


def trc(path: Path) -> None:
    """Markers of Pose2Sim."""
    names = ("RShoulder", "RElbow", "RWrist", "LShoulder", "LElbow", "LWrist", "Head", "RHip", "LHip")
    made.trc(path, {name: made.part(name, FRAMES) for name in names})


def kinect_json(path: Path) -> None:
    """As the Azure Kinect's offline processor writes it."""
    frames = [
        {
            "frame_id": k,
            "timestamp_usec": 200_000 + 33_333 * k,
            "num_bodies": 1,
            "bodies": [{"body_id": 1, "joint_positions": points}],
        }
        for k, points in enumerate(AZURE_MM.tolist())
    ]
    path.write_text(json.dumps({"joint_names": list(AZURE), "frames": frames}))


def array(path: Path) -> None:
    """FreeMoCap's array of landmarks, mm."""
    with path.open("wb") as stream:
        np.save(stream, 1000 * made.parts(BLAZEPOSE, FRAMES))


def c3d(path: Path) -> None:
    """Model markers."""
    from smoother.io.export.markers import write_c3d

    names = ("RShoulder", "RElbow", "RWrist", "LShoulder", "LElbow", "LWrist")
    write_c3d(path, names, made.parts(names, FRAMES), 30.0, True)


def xdf(path: Path) -> None:
    """One stream of an IMU."""
    labels = ["acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z"]
    channels = list(zip(labels, ["m/s^2"] * 3 + ["rad/s"] * 3, strict=True))
    stream = {"name": "Wrist", "type": "IMU", "rate": 100, "channels": channels}
    made.xdf(path, [{**stream, "t_s": 50 + TIME, "values": np.hstack([ACC, GYRO])}])


def mcap(path: Path) -> None:
    """Our own recording."""
    from smoother.io import write_recording
    from smoother.io.recording.streams import ImuSamples, RecordingFile

    stamp = np.rint(TIME * 1e9).astype(np.int64)
    file = RecordingFile(path, imus=[ImuSamples("/imu/wrist", "wrist", stamp, ACC, GYRO)])
    write_recording(file, path, force=True)


#: By the importer's key.
IMUS: dict[str, Callable[[Path], None]] = {
    "xsens-dot": xsens_dot,
    "xsens-mt": xsens_mt,
    "shimmer": shimmer,
    "apdm": apdm,
    "x-imu": ximu,
    "nilspod": nilspod,
    "metamotion": metamotion,
    "sensorlog": sensorlog,
    "phyphox": phyphox,
    "android": android,
    "mvnx": mvnx,
    "axivity": axivity,
    "imu-table": named,
}
SKELETONS: dict[str, Callable[[Path], None]] = {
    "azure-kinect": lambda path: made.azure_csv(path, FRAMES),
    "kinect-v2": kinect_v2,
    "kinect-numbers": bare_kinect,
    "mediapipe": mediapipe,
    "joint-rows": joint_rows,
    "joint-table": joint_table,
    "trc": trc,
    "azure-kinect-json": kinect_json,
    "joint-array": array,
    "c3d": c3d,
}
RECORDINGS: dict[str, Callable[[Path], None]] = {"xdf": xdf, "mcap": mcap}
EXAMPLES = {**IMUS, **SKELETONS, **RECORDINGS}
#: Layouts that need a library beside the product's own to be written.
MADE_ELSEWHERE = {"rosbag1", "apdm-hdf5", "pose-json"}
