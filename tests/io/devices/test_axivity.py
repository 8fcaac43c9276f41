"""Axivity's CWA against a second, slow reading of the same bytes."""

from __future__ import annotations

import struct
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from smoother.errors import RecordingError
from smoother.io.devices.registry import recognise
from smoother.io.tables.file_head import read_head


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


def read(path: Path):
    importer = recognise(read_head(path), ("imu",))
    assert importer is not None and importer.key == "axivity"
    (table,) = importer.read(path)
    return table


def compare(path: Path) -> None:
    table = read(path)
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
    table = read(path)
    assert len(table.acc) == 200 and np.allclose(np.diff(table.t_s), 0.01, atol=2e-6)
    assert abs(np.median(table.acc[:, 2]) / 9.80665 - 1) < 0.05
    assert not table.notes


def test_damaged_blocks_are_left_out_and_said(tmp_path: Path):
    raw = cwa()
    raw[1024 + 512 + 100] ^= 0xFF
    path = tmp_path / "a.cwa"
    path.write_bytes(raw[:-100])
    table = read(path)
    assert len(table.acc) == 120 and "1 damaged" in " ".join(table.notes)
    assert np.diff(table.t_s).max() == pytest.approx(0.41, abs=1e-4)  # the hole stays


def test_a_file_that_is_cut_off_within_a_block_says_so(tmp_path: Path):
    path = tmp_path / "cut.cwa"
    path.write_bytes(bytes(cwa())[:-200])
    table = read(path)
    assert any("cut off" in note for note in table.notes)


def test_without_gyroscope_or_blocks(tmp_path: Path):
    path = tmp_path / "a.cwa"
    path.write_bytes(cwa(axes=3))
    with pytest.raises(RecordingError, match="3 axes, no gyroscope"):
        read(path)
    path.write_bytes(cwa(blocks=0))
    with pytest.raises(RecordingError, match="no intact blocks"):
        read(path)


@pytest.mark.real
def test_a_real_file(datasets: Path):
    compare(datasets / "devices" / "axivity_ax6.cwa")
