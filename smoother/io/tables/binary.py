"""Files of sensors that are not text: APDM Opal's HDF5, Axivity's CWA (AX3, AX6), Xsens' MVNX."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import iterparse

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from ...errors import RecordingError
from ...runtime.inputs import crashes_in_subprocess
from ...runtime.packages import extra_module
from ...units import STANDARD_GRAVITY
from .imu import ImuTable, holds_gravity
from .table import Format, begins, read_bytes


def _read_apdm_hdf(path: Path) -> list[ImuTable]:
    """Each sensor one IMU: m/s^2, rad/s, time in us since 1970."""
    h5py = extra_module("h5py", "h5py", "apdm")

    def read(file: Path) -> list[ImuTable]:
        with h5py.File(file, "r") as opened:
            return _sensors(opened)

    if crashes_in_subprocess(path, read):  # of damaged lengths HDF5 takes all memory
        raise RecordingError(f"{path} is a damaged HDF5 file; export it again.")
    tables = read(path)
    if not tables:
        raise RecordingError(
            f"{path} has no raw sensors of an Opal; export 'raw data' as HDF5, or CSV, from the APDM program."
        )
    return tables


APDM_HDF = Format(
    "apdm-hdf5",
    "APDM Opal HDF5",
    "imu",
    "HDF5 with Sensors/<id>/Accelerometer or <id>/Calibrated/Accelerometers",
    begins(b"\x89HDF\r\n\x1a\n"),
    _read_apdm_hdf,
)


def _sensors(file: Any) -> list[ImuTable]:
    if "Sensors" in file:
        groups = [(name, group, group) for name, group in file["Sensors"].items()]
    else:
        groups = [
            (name, group["Calibrated"], group) for name, group in file.items() if _has(group, "Calibrated")
        ]
    # what the wearer's places are called ("Right Wrist"): by monitor in older versions
    listed = (np.ravel(file.attrs.get(key, [])) for key in ("CaseIdList", "MonitorLabelList"))
    labels = {_text(monitor): _text(label) for monitor, label in zip(*listed, strict=False)}
    tables = []
    for name, values, group in groups:
        acc, gyro, mag = (_vector(values, kind) for kind in ("Accelerometer", "Gyroscope", "Magnetometer"))
        if acc is None or gyro is None:
            continue
        time = np.asarray(group["Time"], dtype=float).ravel() if _has(group, "Time") else None
        count = min(len(values) for values in (acc, gyro, time) if values is not None)
        rate = group.attrs.get("SampleRate", file.attrs.get("SampleRate"))
        configured = group["Configuration"].attrs if _has(group, "Configuration") else {}
        label = _text(configured.get("Label 0", "") if configured else group.attrs.get("MonitorLabel", ""))
        tables.append(
            ImuTable(
                name=label or labels.get(name, "") or name,
                t_s=None if time is None else time[:count] * 1e-6,
                acc=acc[:count],
                gyro=gyro[:count],
                mag=None if mag is None or len(mag) < count else mag[:count],
                rate_hz=None if rate is None else float(np.ravel(rate)[0]),
                units="m/s^2, rad/s",
            )
        )
    return tables


def _has(group: Any, key: str) -> bool:
    return hasattr(group, "keys") and key in group


def _vector(group: Any, kind: str) -> FloatArray | None:
    """A sensor's samples (N, 3), whether its name has a plural s or not."""
    key = next((key for key in (kind, f"{kind}s") if _has(group, key)), None)
    if key is None:
        return None
    values = np.asarray(group[key], dtype=float)
    values = values.T if values.ndim == 2 and values.shape[0] == 3 != values.shape[1] else values
    return values if values.ndim == 2 and values.shape[1] == 3 else None


def _text(value: Any) -> str:
    return (value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)).strip("\0 ")


#: A data block: 512 bytes, little-endian (Open Movement, "AX3/AX6 technical documentation", CWA data blocks).
_FIELDS = (
    "S2 mark, <u2 length, <u2 fraction, <u4 session, <u4 sequence, <u4 time, <u2 light, <u2 temperature,"
    " u1 events, u1 battery, u1 rate, u1 axes, <i2 offset, <u2 count, 240<i2 data, <u2 checksum"
)
_BLOCK = np.dtype([(name, kind) for kind, name in map(str.split, _FIELDS.split(","))])
#: Gyroscope's range where the block states none, deg/s.
_USUAL_RANGE = 2000.0


def _read_axivity(path: Path) -> list[ImuTable]:
    """Gyroscope in deg/s and accelerometer in g, 16 bits, in blocks with a time stamp each."""
    raw = read_bytes(path)
    blocks = np.frombuffer(raw, _BLOCK, count=len(raw) // _BLOCK.itemsize)
    data = blocks[(blocks["mark"] == b"AX") & (blocks["length"] == 508)]
    whole = (
        (data["axes"] & 15 == 2) & (data["axes"] >> 4 == 6) & (data["count"] * 6 <= 240) & (data["count"] > 0)
    )
    words = np.ascontiguousarray(data).view("<u2").reshape(len(data), 256)
    usable = data[
        whole & (words.sum(axis=1, dtype=np.uint64).astype(np.uint16) == 0)
    ]  # the checksum is right
    if not len(usable):
        axes = int(data["axes"][0] >> 4) if len(data) else 0
        what = f"has {axes} axes, no gyroscope" if axes == 3 else "has no intact blocks of samples"
        raise RecordingError(
            f"{path} is an {AXIVITY.title} that {what}; set up an AX6 with its gyroscope on."
        )
    cut = len(raw) % _BLOCK.itemsize != 0
    return [_samples(usable, len(data) - len(usable), cut)]


AXIVITY = Format(
    "axivity",
    "Axivity AX6 (CWA)",
    "imu",
    "a binary header that begins with MD, and blocks that begin with AX",
    begins(b"MD\xfc\x03", b"AX\xfc\x01"),
    _read_axivity,
)


def _samples(blocks: NDArray[np.void], left_out: int, cut: bool) -> ImuTable:
    """Samples of intact blocks with six axes."""
    # A sample is in the rows of its block that are filled.
    filled = np.arange(40) < blocks["count"][:, None]
    values = blocks["data"].reshape(-1, 40, 6).astype(float)
    light = blocks["light"].astype(int)
    per_g = (1 << (8 + (light >> 13))).astype(float)
    code = (light >> 10) & 7
    full_scale = np.where(code > 0, 8000.0 / (1 << code), _USUAL_RANGE)
    gyro = values[:, :, :3] * (full_scale / 32768 * np.pi / 180)[:, None, None]
    acc = values[:, :, 3:] * (STANDARD_GRAVITY / per_g)[:, None, None]
    rate = 3200.0 / (1 << (15 - (blocks["rate"] & 15).astype(int)))
    t_s = _starts(blocks, rate)[:, None] + np.arange(40) / rate[:, None]
    notes = [f"Damaged blocks, left out: {left_out}."] if left_out else []
    if cut:  # a file is a whole number of blocks
        notes.append("The file is cut off within a block; what follows is lost. Download it again.")
    t_s = _even(t_s, blocks)[filled]
    return ImuTable("", t_s, acc[filled], gyro[filled], units="g, deg/s", notes=notes)


def _starts(blocks: NDArray[np.void], rate: FloatArray) -> FloatArray:
    """Time of each block's first sample, s since 1970 on the device's clock."""
    stamp = blocks["time"].astype(np.int64)
    year, month, day = 2000 + (stamp >> 26), (stamp >> 22) & 15, (stamp >> 17) & 31
    hour, minute, second = (stamp >> 12) & 31, (stamp >> 6) & 63, stamp & 63
    months = (year - 1970) * 12 + np.clip(month, 1, 12) - 1
    days = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64) + day - 1
    whole = days * 86_400 + hour * 3600 + minute * 60 + second
    # A fraction is there where its top bit is set; the offset then counts the fraction's whole samples too.
    fractional = np.where(blocks["fraction"] & 0x8000, (blocks["fraction"].astype(np.int64) & 0x7FFF) << 1, 0)
    offset = blocks["offset"] + ((fractional * rate.astype(np.int64)) >> 16)
    return whole + fractional / 65536 - offset / rate


def _even(t_s: FloatArray, blocks: NDArray[np.void]) -> FloatArray:
    """Times (blocks, 40); samples are spread up to the next block where it follows at once."""
    count = blocks["count"].astype(int)
    starts, tick = t_s[:, 0], t_s[:, 1] - t_s[:, 0]
    follows = np.zeros(len(blocks), bool)
    length = np.diff(starts)
    # The crystal differs from its nominal rate by a few percent at most; a longer step is a pause.
    follows[:-1] = (np.diff(blocks["sequence"].astype(np.int64)) == 1) & (
        np.abs(length / (count[:-1] * tick[:-1]) - 1) < 0.1
    )
    tick[:-1] = np.where(follows[:-1], length / count[:-1], tick[:-1])
    return starts[:, None] + np.arange(40) * tick[:, None]


_ACC, _GYRO, _MAG = "sensorAcceleration", "sensorAngularVelocity", "sensorMagneticField"
_EXPORT = "export it again with sensor data 'acceleration' and 'angular velocity' (calibrated sensor data) on"


_ROOT = re.compile(r"\s*(<\?xml.*?\?>\s*)?(<!--.*?-->\s*)*<mvnx\b", re.DOTALL)


def _read_mvnx(path: Path) -> list[ImuTable]:
    """Sensors of a suit, each one IMU: m/s^2 and rad/s in the sensor's axes."""
    rows: dict[str, list[str]] = {_ACC: [], _GYRO: [], _MAG: []}
    names: list[str] = []
    times: list[float] = []
    rate, is_free = None, False
    for event, element in iterparse(path, events=("start", "end")):
        tag = element.tag.rpartition("}")[2]
        if event == "start":
            if tag == "subject":
                rate = _number(element.get("frameRate"))
            elif tag == "sensor":
                names.append(element.get("label", ""))
        elif tag == "frame":
            if element.get("type", "normal") == "normal":
                times.append(_number(element.get("time")) or 0.0)
                for child in element:
                    tag = child.tag.rpartition("}")[2]
                    is_free |= tag == "sensorFreeAcceleration"
                    if tag in rows:
                        rows[tag].append(child.text or "")
            element.clear()
    if not rows[_ACC] or not rows[_GYRO]:
        has = "free acceleration and orientation only" if is_free else "no raw sensors"
        raise RecordingError(f"{path} is an {MVNX.title} that contains {has}; {_EXPORT}.")
    for key in (_ACC, _GYRO):
        if len(rows[key]) != len(times):
            raise RecordingError(f"{path} has {key} in {len(rows[key])} of {len(times)} frames; {_EXPORT}.")
    acc, gyro = _vectors(path, _ACC, rows[_ACC]), _vectors(path, _GYRO, rows[_GYRO])
    mag = _vectors(path, _MAG, rows[_MAG]) if len(rows[_MAG]) == len(times) else None
    count = acc.shape[1]
    if gyro.shape[1] != count:
        raise RecordingError(f"{path} has {count} accelerometers and {gyro.shape[1]} gyroscopes; {_EXPORT}.")
    if not holds_gravity(acc.reshape(-1, 3)):
        raise RecordingError(f"{path} contains acceleration without gravity; {_EXPORT}.")
    stamps = np.array(times) * 1e-3
    stamped = bool((np.diff(stamps) > 0).any())
    names += [f"sensor {at + 1}" for at in range(len(names), count)]
    return [
        ImuTable(
            names[at],
            stamps.copy() if stamped else None,
            acc[:, at],
            gyro[:, at],
            None if mag is None or mag.shape[1] != count else mag[:, at],
            rate,
            units="m/s^2, rad/s",
        )
        for at in range(count)
    ]


MVNX = Format(
    "mvnx",
    "Xsens MVNX",
    "imu",
    "XML whose root is mvnx",
    lambda head: bool(_ROOT.match(head.text[:4000])),
    _read_mvnx,
)


def _vectors(path: Path, key: str, texts: list[str]) -> FloatArray:
    """Vectors of all sensors, shape (frames, sensors, 3)."""
    counts = {len(text.split()) for text in texts}
    try:
        if len(counts) == 1:
            return np.array(" ".join(texts).split(), dtype=float).reshape(len(texts), -1, 3)
    except ValueError:
        pass
    raise RecordingError(
        f"{path}: {key} is not three numbers per sensor, as many in every frame; export it again."
    )


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if np.isfinite(value) else None
