"""APDM's HDF5, of new and of old versions; one sentence where h5py is absent."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from imu_files import motion
from library_files import write_opal

from smoother.errors import RecordingError
from smoother.io.devices.registry import recognise
from smoother.io.tables.file_head import read_head

ACC, GYRO = motion(200)


def read(path: Path):
    importer = recognise(read_head(path))
    assert importer is not None and importer.key == "apdm-hdf5"
    return importer.read(path)


def test_without_h5py_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.h5"
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(RecordingError, match=r"pip install h5py \(or export CSV"):
        read(path)


@pytest.mark.parametrize("version", [5, 3])
def test_each_sensor_is_one_imu(tmp_path: Path, version: int):
    pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    write_opal(path, version)
    micros = 1_600_000_000_000_000 + 7_812 * np.arange(200, dtype=np.uint64)
    first, second = read(path)
    assert (first.name, second.name, first.rate_hz) == ("Right Wrist", "Lumbar", 128.0)
    np.testing.assert_array_equal(second.acc, np.roll(ACC, 1, axis=1))
    np.testing.assert_array_equal(first.gyro, GYRO)
    np.testing.assert_allclose(first.t_s, micros * 1e-6, atol=1e-6)


def test_another_hdf5_or_a_broken_one(tmp_path: Path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["table"] = [1, 2, 3]
    with pytest.raises(RecordingError, match="no raw sensors of an Opal"):
        read(path)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(RecordingError, match="cannot be read as HDF5"):
        read(path)


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
        read(path)
