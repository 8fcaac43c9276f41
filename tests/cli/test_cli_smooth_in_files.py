"""`smooth` keeps what grows with the recording in temporary files: nothing of its outputs shows it."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

import smoother.runtime.disk_store
from calib.file import read_calibration
from calib.imu.sensor import corrected
from smoother.cli.run import run
from smoother.io import read_recording
from smoother.runtime.disk_store import DiskStore
from smoother.runtime.store import Store

DEMO = Path(__file__).parents[2] / "data" / "demo.mcap"


def test_where_the_columns_lie_does_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, limit in (("memory", 1 << 40), ("files", 1)):
        monkeypatch.setattr(smoother.runtime.disk_store, "_SMALL_BYTES", limit)
        outputs = ["-o", tmp_path / f"{name}.mcap", "--json", tmp_path / f"{name}.json"]
        arguments = ["smooth", DEMO, *outputs, "--report", tmp_path / f"{name}.html", "--processes", 1]
        assert run([str(argument) for argument in arguments]) == 0
    for ending in ("mcap", "json", "html"):
        memory, files = ((tmp_path / f"{name}.{ending}").read_bytes() for name in ("memory", "files"))
        assert memory == files


def test_no_room_for_temporary_files_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(smoother.runtime.disk_store, "_SMALL_BYTES", 1)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    assert run(["smooth", str(DEMO), "-o", str(tmp_path / "out.mcap"), "--processes", "1"]) != 0
    said = capsys.readouterr().err
    assert "TMPDIR" in said and "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("samples", [1000, 70])
def test_an_imu_is_corrected_part_by_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, samples: int
) -> None:
    recording = read_recording(DEMO)
    (tmp_path / "cal.toml").write_text(
        f'[imu."{recording.imu.name.removeprefix("/imu/")}".accelerometer]\n'
        "offset = [0.1, -0.2, 0.3]\nmatrix = [[1.01, 0.0, 0.0], [0.0, 0.99, 0.0], [0.0, 0.02, 1.0]]\n"
        f'[imu."{recording.imu.name.removeprefix("/imu/")}".gyroscope]\noffset = [0.01, 0.02, -0.03]\n'
    )
    calibration = read_calibration(tmp_path / "cal.toml")
    monkeypatch.setattr("calib.imu.sensor._SAMPLES", 10**9)
    whole = corrected(recording, calibration, Store())
    assert not np.array_equal(whole.imu.acc, recording.imu.acc)
    monkeypatch.setattr("calib.imu.sensor._SAMPLES", samples)
    with DiskStore(tmp_path) as store:
        parts = corrected(recording, calibration, store)
        for name in ("t_s", "acc", "gyro"):
            np.testing.assert_allclose(getattr(parts.imu, name), getattr(whole.imu, name), rtol=1e-14)
