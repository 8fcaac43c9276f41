"""Importers of IMU files that are no tables: Axivity's CWA, APDM's HDF5, Xsens' MVNX."""

from __future__ import annotations

import struct
import sys
from datetime import UTC, datetime
from pathlib import Path

import device_files as made
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


def cwa(path: Path, blocks: int = 5, axes: int = 6) -> Path:
    """A file of our own, about level."""
    numbers = np.random.default_rng(3).integers(-500, 500, (40 * blocks, 6)) + np.array([0] * 5 + [4096])
    made.axivity(path, numbers, axes)
    return path


def compare(path: Path) -> None:
    (table,) = tables(path, "axivity")
    starts, samples = slow_reading(path.read_bytes())
    gyro, acc = np.hsplit(np.array(samples), 2)
    np.testing.assert_allclose(table.gyro, np.radians(gyro), rtol=1e-12)
    np.testing.assert_allclose(table.acc, acc * 9.80665, rtol=1e-12)
    np.testing.assert_allclose(table.t_s[::40][: len(starts)], starts, rtol=0, atol=1e-6)
    assert (np.diff(table.t_s) > 0).all()


def test_our_own_file(tmp_path: Path):
    path = cwa(tmp_path / "a.bin")
    compare(path)
    (table,) = tables(path, "axivity")
    assert len(table.acc) == 200 and np.allclose(np.diff(table.t_s), 0.01, atol=2e-6) and not table.notes
    raw = bytearray(path.read_bytes())
    raw[1024 + 512 + 100] ^= 0xFF
    path.write_bytes(raw[:-100])
    (table,) = tables(path, "axivity")
    assert len(table.acc) == 120 and "Damaged blocks, left out: 1." in " ".join(table.notes)
    assert any("cut off" in note for note in table.notes)
    assert np.diff(table.t_s).max() == pytest.approx(0.41, abs=1e-4)  # the hole stays
    for more, said in (({"axes": 3}, "3 axes, no gyroscope"), ({"blocks": 0}, "no intact blocks")):
        with pytest.raises(RecordingError, match=said):
            tables(cwa(path, **more), "axivity")


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
    assert (first.topic, second.topic, first.rate_hz) == ("Right Wrist", "Lumbar", 128.0)
    np.testing.assert_array_equal(second.acc, np.roll(OPAL_ACC, 1, axis=1))
    np.testing.assert_array_equal(first.gyro, OPAL_GYRO)
    np.testing.assert_allclose(first.t_s, micros * 1e-6, atol=1e-6)


def test_another_hdf5(tmp_path: Path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["table"] = [1, 2, 3]
    with pytest.raises(RecordingError, match="no raw sensors of an Opal"):
        tables(tmp_path / "a.h5", "apdm-hdf5")


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


#: Two sensors, the second's axes shifted by one.
FORCE, TURN = (np.hstack([each, np.roll(each, 1, axis=1)]) for each in (made.ACC, made.GYRO))
BOTH = [("sensorAcceleration", FORCE), ("sensorAngularVelocity", TURN)]


def suit(path: Path, values: list[tuple[str, np.ndarray]]) -> Path:
    made.mvnx(path, values, ("RightForeArm", "Pelvis"))
    return path


def test_every_sensor_is_one_imu(tmp_path: Path):
    found = tables(suit(tmp_path / "a.xml", [*BOTH, ("sensorMagneticField", FORCE)]), "mvnx")
    assert [table.topic for table in found] == ["RightForeArm", "Pelvis"]
    for shift, table in enumerate(found):
        np.testing.assert_array_equal(table.acc, np.roll(made.ACC, shift, axis=1))
        np.testing.assert_array_equal(table.gyro, np.roll(made.GYRO, shift, axis=1))
        assert table.rate_hz == 100 and table.t_s[50] == 0.5 and table.mag is not None


@pytest.mark.parametrize(
    "values, said",
    [
        (
            [("sensorFreeAcceleration", FORCE), ("sensorOrientation", TURN)],
            "free acceleration and orientation",
        ),
        ([("orientation", FORCE), ("position", TURN)], "no raw sensors"),
        ([("sensorAcceleration", 0.01 * FORCE), ("sensorAngularVelocity", TURN)], "without gravity"),
    ],
)
def test_what_holds_no_raw_sensors_says_what_to_export(tmp_path: Path, values: list, said: str):
    with pytest.raises(RecordingError, match=f"{said}.*export it again with sensor data"):
        tables(suit(tmp_path / "a.xml", values), "mvnx")


def test_a_broken_file_is_one_sentence(tmp_path: Path):
    path = suit(tmp_path / "a.xml", BOTH)
    text = path.read_text()
    for broken, said in (
        (text[: len(text) // 2], "Xsens MVNX, but is damaged"),
        (text.replace("0.0", "zero", 3), "not three numbers per sensor"),
    ):
        path.write_text(broken)
        with pytest.raises(RecordingError, match=said):
            tables(path, "mvnx")
