"""Faults done to the content of sound containers: values, stamps, rates, names, calibrations."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from smoother.recording import FOREARM_JOINTS, ImuStream, Recording

Rng = np.random.Generator
Edit = Callable[[Recording, Rng], Recording]


def _imu(recording: Recording, **columns: Any) -> Recording:
    return replace(recording, imu=replace(recording.imu, **columns))


def _some(count: int, share: float, rng: Rng) -> np.ndarray:
    return rng.choice(count, max(round(share * count), 1), replace=False)


def imu_values(value: float, share: float = 0.01, sensors: str = "ag") -> Edit:
    """Samples of a value in accelerometer, gyroscope or either."""

    def edit(recording: Recording, rng: Rng) -> Recording:
        acc, gyro = recording.imu.acc.copy(), recording.imu.gyro.copy()
        rows = _some(len(acc), share, rng)
        target = acc if rng.choice(list(sensors)) == "a" else gyro
        target[rows, int(rng.integers(3))] = value
        return _imu(recording, acc=acc, gyro=gyro)

    return edit


def spikes(share: float) -> Edit:
    """Wrong samples of the gyroscope within its range."""

    def edit(recording: Recording, rng: Rng) -> Recording:
        gyro = recording.imu.gyro.copy()
        gyro[_some(len(gyro), share, rng), int(rng.integers(3))] = 20.0 + 10 * rng.random()
        return _imu(recording, gyro=gyro)

    return edit


def lasting(what: str, share: float) -> Edit:
    """A time in which the IMU gives nothing, or the same again."""

    def edit(recording: Recording, rng: Rng) -> Recording:
        acc, gyro = recording.imu.acc.copy(), recording.imu.gyro.copy()
        count = len(acc)
        size = max(round(share * count), 1)
        start = int(rng.integers(0, count - size + 1))
        rows = slice(start, start + size)
        if what == "zero":
            acc[rows], gyro[rows] = 0.0, 0.0
        elif what == "frozen":
            acc[rows], gyro[rows] = acc[start], gyro[start]
        elif what == "clipped":
            low = np.quantile(abs(gyro), 0.97)
            gyro = np.clip(3 * gyro, -3 * low, 3 * low)
        else:
            keep = np.ones(count, bool)
            keep[rows] = False
            return replace(recording, imu=recording.imu.select(keep))
        return _imu(recording, acc=acc, gyro=gyro)

    return edit


def joints(value: float, share: float = 0.01) -> Edit:
    """Positions of joints of a value."""

    def edit(recording: Recording, rng: Rng) -> Recording:
        position = recording.arm.position.copy()
        rows = _some(len(position), share, rng)
        position[rows, int(rng.integers(3)), int(rng.integers(3))] = value
        return replace(recording, arm=replace(recording.arm, position=position))

    return edit


def in_one_point(recording: Recording, rng: Rng) -> Recording:
    """All joints in one point, in some frames or in all."""
    position = recording.arm.position.copy()
    rows = slice(None) if rng.random() < 0.5 else slice(0, int(rng.integers(2, len(position))))
    position[rows] = position[rows, 2:3]
    return replace(recording, arm=replace(recording.arm, position=position))


def stamps(kind: str, stream: str) -> Edit:
    """Stamps of the IMU or the camera that are wrong."""

    def edit(recording: Recording, rng: Rng) -> Recording:
        of = recording.imu if stream == "imu" else recording.arm
        t = of.t_s.copy()
        row = int(rng.choice([0, 1, len(t) // 2, len(t) - 1, int(rng.integers(len(t)))]))
        if kind == "back":
            t[row] -= 1.0
        elif kind == "repeated":
            t[max(row, 1)] = t[max(row, 1) - 1]
        elif kind == "2554":
            t[row] = 584 * 365.25 * 86_400 - recording.origin_ns / 1e9 - 2e10 / 3
        elif kind == "zero":
            t[row] = -recording.origin_ns / 1e9
        elif kind == "10 days":
            t[row] += 864_000.0 * rng.choice([-1, 1])
        elif kind == "10 days for good":
            t[row:] += 864_000.0
        elif kind == "a year":
            t[row] += 31_557_600.0
        elif kind == "all equal":
            t[:] = t[0]
        elif kind == "2^63":
            t[row] = 9.2e9 - recording.origin_ns / 1e9
        changed = replace(of, t_s=t)
        return replace(recording, **{"imu" if stream == "imu" else "arm": changed})

    return edit


def few(imu: int | None, frames: int | None) -> Edit:
    """A number of samples or frames."""

    def edit(recording: Recording, rng: Rng) -> Recording:
        start = int(rng.integers(10))
        if imu is not None:
            recording = replace(recording, imu=recording.imu.select(slice(start, start + imu)))
        if frames is not None:
            recording = replace(recording, arm=recording.arm.select(slice(start, start + frames)))
        return recording

    return edit


def rate(imu_hz: float | None, camera_hz: float | None) -> Edit:
    """Streams at another rate."""

    def edit(recording: Recording, rng: Rng) -> Recording:
        imu, arm = recording.imu, recording.arm
        if imu_hz is not None:
            t = np.arange(imu.t_s[0], imu.t_s[-1], 1 / imu_hz)
            acc, gyro = (
                np.stack([np.interp(t, imu.t_s, column) for column in values.T], axis=1)
                for values in (imu.acc, imu.gyro)
            )
            imu = ImuStream(imu.name, t, acc, gyro)
        if camera_hz is not None:
            t = np.arange(arm.t_s[0], arm.t_s[-1], 1 / camera_hz)
            rows = np.searchsorted(arm.t_s, t).clip(0, len(arm.t_s) - 1)
            arm = replace(arm, t_s=t, position=arm.position[rows], state=arm.state[rows])
        return replace(recording, imu=imu, arm=arm)

    return edit


def gravity(value: tuple[float, float, float]) -> Edit:
    """A hint of gravity that is none."""
    return lambda recording, rng: replace(recording, gravity_hint=np.array(value))


def hidden(recording: Recording, rng: Rng) -> Recording:
    """The camera sees the forearm in the first second alone."""
    late = recording.arm.t_s > recording.arm.t_s[0] + 1
    return replace(recording, arm=recording.arm.hide(late, FOREARM_JOINTS))


def an_hour_blind(recording: Recording, rng: Rng) -> Recording:
    """The camera ends after some seconds and the IMU continues for an hour, moving or at rest."""
    imu = recording.imu
    step = float(np.median(np.diff(imu.t_s)))
    count = round(3600 / step)
    rows = np.arange(count) % len(imu.t_s) if rng.random() < 0.5 else np.zeros(count, int)
    noise = rng.normal(size=(2, count, 3)) * [[[0.02]], [[0.002]]]
    t_s = np.concatenate([imu.t_s, imu.t_s[-1] + step * np.arange(1, count + 1)])
    acc, gyro = (
        np.concatenate([values, values[rows] + more])
        for values, more in zip((imu.acc, imu.gyro), noise, strict=True)
    )
    return replace(recording, imu=ImuStream(imu.name, t_s, acc, gyro))


RECORDING: dict[str, tuple[Edit, int]] = {
    "IMU nan": (imu_values(np.nan), 6),
    "IMU inf": (imu_values(np.inf), 6),
    "IMU 1e300": (imu_values(1e300), 6),
    "IMU 1e6": (imu_values(1e6), 4),
    "IMU 1e300 everywhere": (imu_values(1e300, 1.0), 2),
    "IMU 1e6 everywhere": (imu_values(1e6, 1.0), 2),
    "IMU denormal": (imu_values(4.9e-324, 0.002), 4),
    "a spike of one sample": (spikes(1e-9), 8),
    "spikes of 1 %": (spikes(0.01), 4),
    "IMU all zero for 3 %": (lasting("zero", 0.03), 4),
    "IMU all zero for half": (lasting("zero", 0.5), 3),
    "IMU frozen for 4 %": (lasting("frozen", 0.04), 6),
    "IMU frozen for half": (lasting("frozen", 0.5), 3),
    "IMU at the end of its range": (lasting("clipped", 0.0), 3),
    "IMU missing for half": (lasting("missing", 0.5), 4),
    "joints nan": (joints(np.nan), 4),
    "joints 1e300": (joints(1e300), 4),
    "joints 50 m away": (joints(50.0), 4),
    "joints 15 m away": (joints(15.0), 4),
    "joints 1e-300": (joints(1e-300), 4),
    "joints in one point": (in_one_point, 4),
    **{
        f"{stream} stamp {kind}": (stamps(kind, stream), 5)
        for stream in ("imu", "camera")
        for kind in (
            "back",
            "repeated",
            "2554",
            "zero",
            "10 days",
            "10 days for good",
            "a year",
            "all equal",
            "2^63",
        )
    },
    "one IMU sample": (few(1, None), 2),
    "two IMU samples": (few(2, None), 2),
    "one frame": (few(None, 1), 2),
    "two frames": (few(None, 2), 3),
    "three frames": (few(None, 3), 3),
    "IMU at 1 Hz": (rate(1, None), 2),
    "IMU at 10 Hz": (rate(10, None), 2),
    "IMU at 1 kHz": (rate(1000, None), 2),
    "IMU at 10 kHz": (rate(10_000, None), 1),
    "camera at 1 Hz": (rate(None, 1), 2),
    "camera at 5 Hz": (rate(None, 5), 2),
    "camera at 240 Hz": (rate(None, 240), 2),
    "gravity zero": (gravity((0, 0, 0)), 2),
    "gravity nan": (gravity((np.nan, 0, 0)), 2),
    "gravity 1e300": (gravity((1e300, 0, 0)), 2),
    "no camera after a second": (hidden, 3),
    "an hour without the camera": (an_hour_blind, 1),
}
#: Faults that take more of the processor's time than usual, s: minutes of one gap are solved.
LONG = {"an hour without the camera": 600}


def _log(value: int) -> Callable[[list[Any], Rng], list[Any]]:
    def edit(rows: list[Any], rng: Rng) -> list[Any]:
        for row in rng.choice(len(rows), 3, replace=False).tolist():
            rows[row][2].log_time = value
        return rows

    return edit


def _topic(name: str) -> Callable[[list[Any], Rng], list[Any]]:
    def edit(rows: list[Any], rng: Rng) -> list[Any]:
        topic = rng.choice(sorted({channel.topic for _, channel, _ in rows}))
        for _, channel, _ in rows:
            if channel.topic == topic:
                channel.topic = name + topic[-12:]
        return rows

    return edit


def _payload(edit_one: Callable[[bytes, Rng], bytes], share: float) -> Callable[[list[Any], Rng], list[Any]]:
    def edit(rows: list[Any], rng: Rng) -> list[Any]:
        mine = [row for row in rows if row[0].name in ("unocclude.Imu", "unocclude.Skeleton")]
        for row in rng.choice(len(mine), max(round(share * len(mine)), 1), replace=False).tolist():
            message = mine[row][2]
            message.data = edit_one(message.data, rng)
        return rows

    return edit


MESSAGES: dict[str, Callable[[list[Any], Rng], list[Any]]] = {
    "log time 2^63": _log(2**63),
    "log time 2^64 - 1": _log(2**64 - 1),
    "log time zero": _log(0),
    "a long topic": _topic("/" + "x" * 5000),
    "control characters in a topic": _topic("/\x1b[2J\x07\n\r\0"),
    "payloads cut": _payload(lambda data, rng: data[: int(rng.integers(len(data)))], 0.01),
    "payloads empty": _payload(lambda data, rng: b"", 0.01),
    "payloads of random bytes": _payload(lambda data, rng: rng.bytes(len(data)), 0.01),
    "all payloads of random bytes": _payload(lambda data, rng: rng.bytes(len(data)), 1.0),
    "varints without end": _payload(lambda data, rng: b"\xff" * 200, 0.01),
    "a deep message": _payload(lambda data, rng: b"\x0a\x7f" * 2000, 0.01),
}


def _key(old: str, new: str) -> Callable[[bytes, Rng], bytes]:
    """A value of a key replaced."""

    def edit(data: bytes, rng: Rng) -> bytes:
        lines = data.decode().split("\n")
        rows = [i for i, line in enumerate(lines) if line.startswith(old)]
        row = int(rng.choice(rows))
        lines[row] = f"{lines[row].partition(' = ')[0]} = {new}"
        return "\n".join(lines).encode()

    return edit


CALIBRATION: dict[str, Callable[[bytes, Rng], bytes]] = {
    "a lever arm in mm": _key("position_m", "[30.0, -210.0, 5.0]"),
    "a lever arm of 1e300": _key("position_m", "[1e300, 0.0, 0.0]"),
    "a lever arm nan": _key("position_m", "[nan, 0.0, 0.0]"),
    "a sigma of zero": _key("sigma_m", "[0.0, 0.0, 0.0]"),
    "a sigma of 1e-300": _key("sigma_m", "[1e-300, 1e-300, 1e-300]"),
    "a sigma of 1e300": _key("sigma_m", "[1e300, 1e300, 1e300]"),
    "an upper arm in mm": _key("upper_arm_m", "301.0"),
    "an upper arm of zero": _key("upper_arm_m", "0.0"),
    "a list for a number": _key("upper_arm_m", "[1.0]"),
    "a word": _key("position_m", '"word"'),
    "digits without end": _key("upper_arm_m", "1" * 5000),
    "a list without end": lambda data, rng: b"a = " + b"[" * 5000 + b"]" * 5000 + b"\n" + data,
    "NUL in a name": lambda data, rng: data + b'["a\\u0000b"]\nx = 1\n',
    "random bytes": lambda data, rng: data[:40] + rng.bytes(30) + data[40:],
    "cut off": lambda data, rng: data[: int(rng.integers(1, len(data)))],
    "binary": lambda data, rng: struct.pack("<d", 1.0) * 10,
}


def _value(text: str) -> Callable[[dict[str, str], Rng], dict[str, str]]:
    def edit(values: dict[str, str], rng: Rng) -> dict[str, str]:
        values[str(rng.choice(sorted(values)))] = text
        return values

    return edit


METADATA: dict[str, Callable[[dict[str, str], Rng], dict[str, str]]] = {
    "metadata nan": _value("NaN"),
    "metadata 1e400": _value("1e400"),
    "metadata of another type": _value('{"a": [1, "b", null]}'),
    "metadata cut": _value("[1, 2"),
    "metadata deep": _value("[" * 50_000),
    "metadata of many digits": _value("1" * 5000),
    "metadata huge": _value("[" + "1," * 100_000 + "1]"),
}
