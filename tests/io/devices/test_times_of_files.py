"""What the times of files may be, in every reader of tables: units, names, clocks that stray, packets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imu_files import motion, rows

from smoother.errors import RecordingError
from smoother.io.recording.clean import clean_imu
from smoother.io.recording.streams import ImuSamples
from smoother.io.registry import FileReader
from smoother.io.tables.imu import ImuTable
from smoother.io.tables.times import repaired_imu, repaired_skeleton

ROWS = 400
ACC, GYRO = motion(ROWS)
UNIX_S = 1.7e9
FILETIME, DOTNET = 116_444_736_000_000_000, 621_355_968_000_000_000


def _read(path: Path, kind: str, names: list[str], columns: np.ndarray, stamps: list[str]) -> Any:
    """A file's one stream, its times corrected."""
    lines = [",".join(cells) for cells in zip(stamps, rows(columns, form="{:.5f}"), strict=True)]
    path.write_text("\n".join([",".join(names), *lines]) + "\n", encoding="utf-8")
    reader = FileReader()
    (one,) = reader.read(path, reader.format_of(path, kind))
    return repaired_imu(one, str(path)) if isinstance(one, ImuTable) else repaired_skeleton(one, str(path))


def imu(path: Path, stamps: list[str], name: str) -> Any:
    names = [f"{kind}_{axis}" for kind in ("acc", "gyr") for axis in "xyz"]
    return _read(path, "imu", [name, *names], np.hstack([ACC, GYRO]), stamps)


def skeleton(path: Path, stamps: list[str], name: str) -> Any:
    wave = 0.1 * np.sin(np.arange(len(stamps)) / 20.0)
    places = {"shoulder": 0.0, "elbow": -0.3, "wrist": -0.55}
    names = [f"right_{joint}_{axis}" for joint in places for axis in "xyz"]
    columns = [c for y in places.values() for c in (y * np.sin(wave), y * np.cos(wave), 2.0 + 0 * wave)]
    return _read(path, "skeleton", [name, *names], np.stack(columns, axis=1), stamps)


READERS = ((imu, 80.0), (skeleton, 30.0))


def counted(rate: float, per_s: float, start: int) -> list[str]:
    return [str(start + round(per_s * at / rate)) for at in range(ROWS)]


@pytest.mark.parametrize(("read", "rate"), READERS)
@pytest.mark.parametrize(
    ("per_s", "start"),
    [(1e7, round(UNIX_S * 1e7) + FILETIME), (1e7, round(UNIX_S * 1e7) + DOTNET)]
    + [(per_s, round(UNIX_S * per_s)) for per_s in (1e3, 1e6, 1e9)],
)
@pytest.mark.parametrize("name", ["timestamp", "TimeSpan", "hostTime", "captured_at", "epoch", "my_own_name"])
def test_units_by_rate_and_date(
    tmp_path: Path, read: Callable[..., Any], rate: float, per_s: float, start: int, name: str
) -> None:
    for one in (rate, 25.0):
        found = read(tmp_path / "a.csv", counted(one, per_s, start), name)
        assert 1 / np.diff(found.t_s).mean() == pytest.approx(one, rel=2e-3)
        assert found.t_s[0] == pytest.approx(UNIX_S, abs=0.1)
    if name == "my_own_name":
        assert "my_own_name was taken for the time" in " ".join(found.notes)


@pytest.mark.parametrize(
    ("read", "stamps"),
    [
        (imu, counted(80.0, 1e7, 0)),  # 8 Hz in us, or 80 in ticks
        (skeleton, counted(60.0, 1e7, 0)),
    ],
)
def test_what_is_not_certain_is_refused_by_name(
    tmp_path: Path, read: Callable[..., Any], stamps: list[str]
) -> None:
    with pytest.raises(RecordingError, match=r"column odd rises.*call it time_s"):
        read(tmp_path / "a.csv", stamps, "odd")
    # what the message names makes it readable
    assert np.diff(read(tmp_path / "a.csv", stamps, "time_ticks").t_s).mean() < 0.02


def test_a_counter_is_no_time(tmp_path: Path) -> None:
    found = skeleton(tmp_path / "a.csv", [str(at) for at in range(ROWS)], "packet_no")
    assert "packet_no counts rows" in " ".join(found.notes) and "assumed 30 frames" in " ".join(found.notes)
    with pytest.raises(RecordingError, match=r"no column of times.*packet_no"):
        imu(tmp_path / "a.csv", [str(at) for at in range(ROWS)], "packet_no")


@pytest.mark.parametrize(("read", "rate"), READERS)
@pytest.mark.parametrize(
    ("rows", "by_s", "says"),
    [
        (slice(100, 180), -1.42e9, "placed between"),
        (slice(100, 180), 7200.0, "placed between"),
        (slice(100, 180), 7.3, "placed between"),
        (slice(200, None), 3600.0, "it was set"),
        (slice(200, None), 5000.0, "taken for a pause"),
        (slice(None, 50), -1.7e9 + 40, "it was set"),
        (slice(300, None), 8e7, "left out"),
    ],
)
def test_clocks_that_stray_or_leap(
    tmp_path: Path, read: Callable[..., Any], rate: float, rows: slice, by_s: float, says: str
) -> None:
    t = np.arange(ROWS) / rate
    stamp = UNIX_S + t
    stamp[rows] += by_s
    found = read(tmp_path / "a.csv", [f"{one:.6f}" for one in stamp], "timestamp")
    assert says in " ".join(found.notes)
    if says == "left out":
        assert len(found.t_s) == 300
    elif "pause" not in says:
        np.testing.assert_allclose(found.t_s, UNIX_S + t, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("apart_s", [0.0, 1e-6, 1e-4])
@pytest.mark.parametrize("size", [2, 6, 12])
@pytest.mark.parametrize("kind", ["file", "recording"])
def test_packets_stamped_on_arrival(apart_s: float, size: int, kind: str) -> None:
    rate, count = 102.4, 2400
    t = np.arange(count) / rate
    late = 0.02 + np.random.default_rng(size).uniform(0, 0.3 * size / rate, count // size)
    stamp = np.repeat(t[size - 1 :: size] + late, size) + np.tile(np.arange(size) * apart_s, count // size)
    acc, gyro = motion(count)
    if kind == "file":
        found = repaired_imu(ImuTable("", stamp, acc, gyro), "a.csv").t_s
    else:
        nanos = np.rint(stamp * 1e9).astype(np.int64)
        found = clean_imu(ImuSamples("/imu/a", "a", nanos, acc, gyro, None), "a.mcap")[0].stamp_ns / 1e9
    assert found is not None and len(found) == count
    if size == 12 or not apart_s or kind == "file":  # shorter ones make no pauses
        assert np.diff(found).max() < 3 / rate and np.std(found - t) < 0.01
