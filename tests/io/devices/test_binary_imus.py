"""Importers of IMU files that are no tables: Axivity's CWA, APDM's HDF5, Xsens' MVNX."""

from __future__ import annotations

import struct
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from importers import tables
from imu_files import motion
from library_files import write_opal

from smoother.errors import RecordingError, UnoccludeError


def slow_reading(raw: bytes) -> tuple[list[float], list[list[float]]]:
    """Block by block and value by value: start of each block, and g and deg/s of each sample."""
    starts, samples = [], []
    for at in range(0, len(raw) - 511, 512):
        block = raw[at : at + 512]
        if block[:2] != b"AX" or sum(struct.unpack("<256H", block)) & 0xFFFF:
            continue
        fraction, stamp, light = struct.unpack_from("<H8xIH", block, 4)
        code, axes, offset, count = struct.unpack_from("<BBhH", block, 24)
        rate = 3200 / 2 ** (15 - (code & 15))
        whole = datetime(
            2000 + (stamp >> 26 & 63), stamp >> 22 & 15, stamp >> 17 & 31,
            stamp >> 12 & 31, stamp >> 6 & 63, stamp & 63, tzinfo=UTC,
        )  # fmt: skip
        part = (fraction & 0x7FFF) << 1 if fraction & 0x8000 else 0
        offset += int(part * int(rate)) >> 16
        starts.append(whole.timestamp() + part / 65536 - offset / rate)
        assert axes == 0x62
        gyro_range = 8000 / 2 ** (light >> 10 & 7) if light >> 10 & 7 else 2000
        for k in range(count):
            values = struct.unpack_from("<6h", block, 30 + 12 * k)
            turning = [v * gyro_range / 32768 for v in values[:3]]
            samples.append(turning + [v / 2 ** (8 + (light >> 13)) for v in values[3:]])
    return starts, samples


def cwa(blocks: int = 5, axes: int = 6, seed: int = 3) -> bytearray:
    """A file of our own: 100 Hz, 8 g, 1000 deg/s."""
    rng = np.random.default_rng(seed)
    raw = bytearray(b"MD" + struct.pack("<H", 1020)) + bytes(1020)
    for k in range(blocks):
        second, part = divmod(7 + 0.4 * k, 1)
        stamp = 21 << 26 | 8 << 22 | 20 << 17 | 20 << 12 | 21 << 6 | int(second)
        fraction = 0x8000 | int(part * 32768)
        adjusted = -(
            (((fraction & 0x7FFF) << 1) * 100) >> 16
        )  # the firmware takes whole samples off the offset
        light = 4 << 13 | 3 << 10 | 500
        numbers = (508, fraction, 1, k, stamp, light, 0, 0, 200, 0x6A, axes << 4 | 2, adjusted, 40)
        head = struct.pack("<2sHHIIIHHBBBBhH", b"AX", *numbers)
        data = rng.integers(-500, 500, (40, 6)) + np.array([0, 0, 0, 0, 0, 4096])
        block = head + data.astype("<i2").tobytes()
        total = sum(struct.unpack("<255H", block)) & 0xFFFF
        raw += block + struct.pack("<H", -total & 0xFFFF)
    return raw


def compare(path: Path) -> None:
    (table,) = tables(path, "axivity")
    starts, samples = slow_reading(path.read_bytes())
    gyro, acc = np.hsplit(np.array(samples), 2)
    np.testing.assert_allclose(table.gyro, np.radians(gyro), rtol=1e-12)
    np.testing.assert_allclose(table.acc, acc * 9.80665, rtol=1e-12)
    np.testing.assert_allclose(table.t_s[::40][: len(starts)], starts, rtol=0, atol=1e-6)
    assert (np.diff(table.t_s) > 0).all()


def test_our_own_file(tmp_path: Path):
    path = tmp_path / "a.bin"
    path.write_bytes(cwa())
    compare(path)
    (table,) = tables(path, "axivity")
    assert len(table.acc) == 200 and np.allclose(np.diff(table.t_s), 0.01, atol=2e-6)
    assert abs(np.median(table.acc[:, 2]) / 9.80665 - 1) < 0.05
    assert not table.notes


def test_damaged_blocks_are_left_out_and_said(tmp_path: Path):
    raw = cwa()
    raw[1024 + 512 + 100] ^= 0xFF
    path = tmp_path / "a.cwa"
    path.write_bytes(raw[:-100])
    (table,) = tables(path, "axivity")
    assert len(table.acc) == 120 and "Damaged blocks, left out: 1." in " ".join(table.notes)
    assert any("cut off" in note for note in table.notes)
    assert np.diff(table.t_s).max() == pytest.approx(0.41, abs=1e-4)  # the hole stays


def test_without_gyroscope_or_blocks(tmp_path: Path):
    path = tmp_path / "a.cwa"
    path.write_bytes(cwa(axes=3))
    with pytest.raises(RecordingError, match="3 axes, no gyroscope"):
        tables(path, "axivity")
    path.write_bytes(cwa(blocks=0))
    with pytest.raises(RecordingError, match="no intact blocks"):
        tables(path, "axivity")


@pytest.mark.real
def test_a_real_file(datasets: Path):
    compare(datasets / "devices" / "axivity_ax6.cwa")


OPAL_ACC, OPAL_GYRO = motion(200)


def test_without_h5py_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.h5"
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(UnoccludeError, match=r"pip install '.\[apdm\]'"):
        tables(path, "apdm-hdf5")


@pytest.mark.parametrize("version", [5, 3])
def test_each_sensor_is_one_imu(tmp_path: Path, version: int):
    pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    write_opal(path, version)
    micros = 1_600_000_000_000_000 + 7_812 * np.arange(200, dtype=np.uint64)
    first, second = tables(path, "apdm-hdf5")
    assert (first.name, second.name, first.rate_hz) == ("Right Wrist", "Lumbar", 128.0)
    np.testing.assert_array_equal(second.acc, np.roll(OPAL_ACC, 1, axis=1))
    np.testing.assert_array_equal(first.gyro, OPAL_GYRO)
    np.testing.assert_allclose(first.t_s, micros * 1e-6, atol=1e-6)


def test_another_hdf5_or_a_broken_one(tmp_path: Path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["table"] = [1, 2, 3]
    with pytest.raises(RecordingError, match="no raw sensors of an Opal"):
        tables(path, "apdm-hdf5")
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(RecordingError, match="APDM Opal HDF5, but is damaged"):
        tables(path, "apdm-hdf5")


def test_a_file_on_which_hdf5_never_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """One wrong length among the texts of the attributes."""
    pytest.importorskip("h5py")
    monkeypatch.setattr("smoother.runtime.inputs._LONGEST_S", 1)
    path = tmp_path / "a.h5"
    write_opal(path, count=12)
    data = bytearray(path.read_bytes())
    data[data.index(b"GCOL") + 24] = 50  # of the first text, 11 letters
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"a\.h5 is a damaged HDF5 file"):
        tables(path, "apdm-hdf5")


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


def test_every_sensor_is_one_imu(tmp_path: Path):
    path = mvnx(tmp_path, "sensorAcceleration", "sensorAngularVelocity", "sensorMagneticField")
    found = tables(path, "mvnx")
    assert [table.name for table in found] == ["RightForeArm", "Pelvis"]
    for shift, table in enumerate(found):
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
        tables(mvnx(tmp_path, *values, factor=factor), "mvnx")


def test_a_broken_file_is_one_sentence(tmp_path: Path):
    path = mvnx(tmp_path, "sensorAcceleration", "sensorAngularVelocity")
    text = path.read_text()
    path.write_text(text[: len(text) // 2])
    with pytest.raises(RecordingError, match="Xsens MVNX, but is damaged"):
        tables(path, "mvnx")
    path.write_text(text.replace("0.0", "zero", 3))
    with pytest.raises(RecordingError, match="not three numbers per sensor"):
        tables(path, "mvnx")
