"""Tables of inertial sensors: written in a layout, read by its importer, held to the motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from imu_files import motion

from smoother.io.devices.registry import recognise
from smoother.io.tables.protocol import ImuTable, read_head

ACC, GYRO = motion()
COUNT = len(ACC)
DEG = np.degrees(GYRO)
TIME = np.arange(COUNT) * 0.01
MICROS = (np.arange(COUNT) * 10_000 + 4_000_000).astype(np.int64)
EPOCH = 1_520_000_000_000 + 10 * np.arange(COUNT)
NANOS = (np.arange(COUNT) * 10_000_000 + 123_456_789_000).astype(np.int64)


def written(tmp_path: Path, *lines: str, newline: str = "\n") -> Path:
    path = tmp_path / "anything.dat"
    path.write_text(newline.join(lines) + newline, encoding="utf-8")
    return path


def read(path: Path, key: str) -> list[ImuTable]:
    importer = recognise(read_head(path), ("imu",))
    assert importer is not None and importer.key == key
    return importer.read(path)


def check(
    table: ImuTable, acc: np.ndarray | None, gyro: np.ndarray | None, t_s: np.ndarray | None = None
) -> None:
    for values, expected in ((table.acc, acc), (table.gyro, gyro)):
        if expected is None:
            assert values is None
        else:
            np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)
    if t_s is not None:
        np.testing.assert_allclose(table.t_s, t_s, rtol=0, atol=1e-6)


def xyz(name: str, form: str = "{}_{}") -> list[str]:
    return [form.format(name, axis) for axis in "XYZ"]
