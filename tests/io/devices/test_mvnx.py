"""MVNX of Xsens suits: XML with raw sensors, and without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from imu_files import motion

from smoother.errors import RecordingError
from smoother.io.devices.registry import recognise
from smoother.io.tables.file_head import read_head

ACC, GYRO = motion(120)


def mvnx(tmp_path: Path, *values: str, factor: float = 1.0, sensors: int = 2) -> Path:
    """A file of two sensors, the second's axes shifted by one."""
    frames = ['<frame time="" type="identity"><orientation>1 0 0 0</orientation></frame>']
    for k in range(len(ACC)):
        parts = []
        for name in values:
            source = GYRO if "Angular" in name else ACC * factor
            numbers = np.concatenate([np.roll(source[k], s) for s in range(sensors)])
            parts.append(f"<{name}>{' '.join(f'{v:.6f}' for v in numbers)}</{name}>")
        frames.append(
            f'<frame time="{round(1000 * k / 60)}" index="{k}" type="normal">{"".join(parts)}</frame>'
        )
    labels = "".join(f'<sensor label="{name}"/>' for name in ("RightForeArm", "Pelvis")[:sensors])
    path = tmp_path / "suit.xml"
    path.write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<mvnx xmlns="http://www.xsens.com/mvn/mvnx" version="4">\n'
        f'<subject label="A" frameRate="60"><sensors>{labels}</sensors><frames>{"".join(frames)}</frames>'
        "</subject></mvnx>"
    )
    return path


def read(path: Path):
    importer = recognise(read_head(path))
    assert importer is not None and importer.key == "mvnx"
    return importer.read(path)


def test_every_sensor_is_one_imu(tmp_path: Path):
    tables = read(mvnx(tmp_path, "sensorAcceleration", "sensorAngularVelocity", "sensorMagneticField"))
    assert [table.name for table in tables] == ["RightForeArm", "Pelvis"]
    for shift, table in enumerate(tables):
        np.testing.assert_array_equal(table.acc, np.roll(ACC, shift, axis=1))
        np.testing.assert_array_equal(table.gyro, np.roll(GYRO, shift, axis=1))
        assert table.rate_hz == 60 and table.t_s[60] == 1.0 and table.mag is not None


@pytest.mark.parametrize(
    "values, factor, said",
    [
        (("sensorFreeAcceleration", "sensorOrientation"), 1.0, "free acceleration and orientation only"),
        (("orientation", "position"), 1.0, "no raw sensors"),
        (("sensorAcceleration", "sensorAngularVelocity"), 0.01, "without gravity"),
    ],
)
def test_what_holds_no_raw_sensors_says_what_to_export(
    tmp_path: Path, values: tuple, factor: float, said: str
):
    with pytest.raises(RecordingError, match=f"{said}.*export it again with sensor data"):
        read(mvnx(tmp_path, *values, factor=factor))


def test_a_broken_file_is_one_sentence(tmp_path: Path):
    path = mvnx(tmp_path, "sensorAcceleration", "sensorAngularVelocity")
    text = path.read_text()
    path.write_text(text[: len(text) // 2])
    with pytest.raises(RecordingError, match="no sound MVNX"):
        read(path)
    path.write_text(text.replace("0.0", "zero", 3))
    with pytest.raises(RecordingError, match="not three numbers a sensor"):
        read(path)
