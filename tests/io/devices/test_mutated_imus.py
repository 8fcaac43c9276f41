"""Damaged files of inertial sensors: a recording or one sentence, never a traceback or another unit."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from imu_files import GRAVITY, motion, rows

from smoother.errors import RecordingError
from smoother.io.devices.registry import recognise
from smoother.io.tables.file_head import read_head

ACC, GYRO = motion(240)
TIME = np.arange(240) * 0.01
NANOS = (np.arange(240) * 10_000_000 + 123_456_789_000).astype(np.int64)


def named(form: str, *stems: str) -> str:
    return ",".join(form.format(stem, axis) for stem in stems for axis in "XYZ")


FILES = {
    "dot": [
        "sep=,",
        "OutputRate:,100Hz",
        "PacketCounter,SampleTimeFine," + named("{}_{}", "Acc", "Gyr"),
        *rows(np.arange(240), NANOS // 1000, ACC, np.degrees(GYRO)),
    ],
    "mtw": [
        "// Update Rate: 100.0Hz",
        "Counter," + named("{}_{}", "Acc", "Gyr"),
        *rows(np.arange(240), ACC, GYRO),
    ],
    "shimmer": [
        '"sep=,"',
        "Shimmer_1_Timestamp_Unix_CAL," + named("Shimmer_1_{}_{}_CAL", "Accel_WR", "Gyro") + ",",
        "ms" + ",m/(s^2)" * 3 + ",deg/s" * 3 + ",",
        *rows(1.6e12 + 1000 * TIME, ACC, np.degrees(GYRO), end=","),
    ],
    "ximu": [
        "Timestamp (us)," + named("Gyroscope {1} (deg/s)", "") + "," + named("Accelerometer {1} (g)", ""),
        *rows(NANOS // 1000, np.degrees(GYRO), ACC / GRAVITY),
    ],
    "phyphox": [
        "Time (s)," + named("Acceleration {1} (m/s^2)", "") + "," + named("Gyroscope {1} (rad/s)", ""),
        *rows(TIME, ACC, GYRO),
    ],
    "nilspod": ["t," + named("{}_{}", "gyr", "acc").lower(), *rows(TIME, np.degrees(GYRO), ACC)],
    "android": ["timestamp," + named("{}{}", "a", "g"), *rows(NANOS, ACC, GYRO)],
    "metamotion": ["epoch (ms),time (-13:00),elapsed (s)," + named("{1}-axis (g)", "")]
    + [
        f"{1_520_000_000_000 + 10 * k},2018-03-02T14.13.20,{row}"
        for k, row in enumerate(rows(TIME, ACC / GRAVITY))
    ],
}
WEIRD = (
    "",
    "abc",
    "nan",
    "inf",
    "1e400",
    "-",
    "9" * 400,
    '"',
    "\x00",
    "1,2,3",
    '"a\nb"',
    "1.2.3",
    "\x1b[31m",
)


def mutated(text: str, rng: random.Random) -> bytes:
    """A file that something happened to."""
    lines, kind = text.split("\n"), rng.randrange(9)
    if kind == 0:
        return text[: rng.randrange(1, len(text))].encode()
    if kind == 1:
        raw = bytearray(text.encode())
        for _ in range(rng.randrange(1, 30)):
            raw[rng.randrange(len(raw))] = rng.randrange(256)
        return bytes(raw)
    if kind == 2:
        start = rng.randrange(len(text))
        return (text[:start] + text[start + rng.randrange(1, 4000) :]).encode()
    if kind == 3:
        return text.replace(",", rng.choice([";", "\t", " ", "|"])).encode(rng.choice(["utf-8", "utf-16"]))
    if kind == 4:
        gone = rng.randrange(8)
        return "\n".join(
            ",".join(c for k, c in enumerate(line.split(",")) if k != gone) for line in lines
        ).encode()
    if kind == 5:
        del lines[rng.randrange(4)]
    elif kind == 6:
        rng.shuffle(lines)
    elif kind == 7:
        for _ in range(rng.randrange(1, 20)):
            at = rng.randrange(len(lines))
            cells = lines[at].split(",")
            cells[rng.randrange(len(cells))] = rng.choice(WEIRD)
            lines[at] = ",".join(cells)
    else:
        return text.replace(",", ";").replace(".", ",").encode()
    return "\n".join(lines).encode()


@pytest.mark.parametrize("name", FILES)
def test_damaged_files(tmp_path: Path, name: str):
    rng = random.Random(name)
    path = tmp_path / "a.csv"
    for _ in range(60):
        path.write_bytes(mutated("\n".join(FILES[name]) + "\n", rng))
        importer = recognise(read_head(path), ("imu",))
        if importer is None or importer.kind != "imu":
            continue
        try:
            tables = importer.read(path)
        except RecordingError as error:
            assert str(error).isprintable() and len(str(error)) < 600 + len(str(path))
            continue
        for table in tables:
            for values, whole in ((table.acc, ACC), (table.gyro, GYRO)):
                if values is None:
                    continue
                assert values.shape[1] == 3 and not np.isinf(values).any()
                finite = values[np.isfinite(values).all(axis=1)]
                if len(finite) > 60:
                    size = np.median(np.linalg.norm(finite, axis=1)) / np.median(
                        np.linalg.norm(whole, axis=1)
                    )
                    assert 0.3 < size < 3 or table.notes


def rewritten(lines: list[str], order: list[int], separator: str, comma: bool) -> str:
    """The table with its columns in another order and another separator; lines above it as they are."""
    body = []
    for line in lines:
        cells = line.split(",")
        if len(cells) < 6:  # above the header
            body.append(line)
            continue
        cells = [cells[at] for at in order]
        body.append(separator.join(cell.replace(".", ",") if comma else cell for cell in cells))
    return "\n".join(body) + "\n"


@pytest.mark.parametrize("name", FILES)
def test_columns_in_any_order_and_any_separator(tmp_path: Path, name: str):
    rng, path = random.Random(name), tmp_path / "a.csv"
    path.write_text("\n".join(FILES[name]) + "\n")
    importer = recognise(read_head(path), ("imu",))
    assert importer is not None
    expected = importer.read(path)[0]
    width = len(FILES[name][-1].split(","))
    for separator, comma in ((",", False), (";", False), (";", True), ("\t", True), ("|", True)):
        order = rng.sample(range(width), width)
        if name == "shimmer":  # its last cell, behind the last separator, is none
            order = [*rng.sample(range(width - 1), width - 1), width - 1]
        path.write_text(
            rewritten(FILES[name], order, separator, comma), encoding="utf-16" if comma else "utf-8"
        )
        again = recognise(read_head(path), ("imu",))
        assert again is not None and again.key == importer.key
        table = again.read(path)[0]
        for part in ("acc", "gyro", "t_s"):
            values = getattr(expected, part)
            if values is None:
                assert getattr(table, part) is None
            else:
                np.testing.assert_array_equal(getattr(table, part), values)
