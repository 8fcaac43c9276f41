"""What is written reads back equal: recordings, results, exports, messages, of any values."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from made_results import assert_same, recovery

from smoother.io import open_recording, read_recovery, write_recording, write_recovery
from smoother.io.export.markers import write_c3d, write_trc
from smoother.io.export.prepare import METADATA_KEY, export_csv, export_parquet, file_columns
from smoother.io.mcap.merge import repair_container
from smoother.io.mcap.messages import nanoseconds
from smoother.io.recording.streams import ArmFrames, ImuSamples, RecordingFile
from smoother.io.tables.markers import read_markers
from smoother.result import Recovery

few = settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
#: What may be in a name: no surrogates, which are not text.
words = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
large = st.floats(-1e6, 1e6)


@st.composite
def files(draw: st.DrawFn) -> RecordingFile:
    """Streams of any values and rising stamps less than three hours apart."""
    count, frames = draw(st.integers(1, 12)), draw(st.integers(1, 8))
    steps = (arrays.arrays(np.int64, size, elements=st.integers(1, 10**13)) for size in (count, frames))
    samples, seen = (1_700_000_000 * 10**9 + np.cumsum(draw(each)) for each in steps)
    acc, gyro = (draw(arrays.arrays(np.float64, (count, 3), elements=large)) for _ in range(2))
    state = draw(arrays.arrays(np.int8, (frames, 5), elements=st.integers(0, 2)))
    state[:, 1] = 2  # an arm that is never there is not written
    position = draw(arrays.arrays(np.float64, (frames, 5, 3), elements=large))
    position[state == 0] = np.nan
    arm = ArmFrames("/skeleton", "camera", draw(st.integers(0, 9)), "right", seen, position, state)
    imu = ImuSamples("/imu/forearm_right", "forearm_right", samples, acc, gyro)
    return RecordingFile(Path("drawn"), imus=[imu], arms=[arm])


@few
@given(files())
def test_recordings(tmp_path: Path, file: RecordingFile):
    write_recording(file, tmp_path / "a.mcap", force=True)
    repair_container(tmp_path / "a.mcap", tmp_path / "b.mcap", force=True)
    for back in (open_recording(tmp_path / name) for name in ("a.mcap", "b.mcap")):
        (imu,), (arm,) = back.imus, back.arms
        assert not back.notes
        for name in ("stamp_ns", "acc", "gyro"):
            np.testing.assert_array_equal(getattr(imu, name), getattr(file.imus[0], name))
        for name in ("stamp_ns", "position", "state", "body", "side"):
            np.testing.assert_array_equal(getattr(arm, name), getattr(file.arms[0], name))


@pytest.mark.slow
@few
@given(
    arrays.arrays(np.float64, st.tuples(st.integers(2, 6), st.integers(1, 4), st.just(3)), elements=large),
    st.data(),
)
def test_markers(tmp_path: Path, position: np.ndarray, data: st.DataObject):
    position[abs(position).max(axis=2) < 1e-3] = 0.5  # the origin stands for a hidden marker
    position[data.draw(arrays.arrays(np.bool_, position.shape[:2]))] = np.nan
    names = [f"M{i}" for i in range(position.shape[1])]
    rate = data.draw(st.sampled_from([30.0, 100.0, 119.88]))
    write_c3d(tmp_path / "a.c3d", names, position, rate, force=True)
    write_trc(tmp_path / "a.trc", names, np.arange(len(position)) / rate, position, rate, force=True)
    # four bytes a number; nine decimals of a metre
    for suffix, errors in (("c3d", {"rtol": 2e-7, "atol": 1e-30}), ("trc", {"rtol": 1e-15, "atol": 0.51e-9})):
        back = read_markers(tmp_path / f"a.{suffix}")
        assert list(back.names) == names and abs(back.rate_hz - rate) < 1e-5
        np.testing.assert_allclose(back.position, position, **errors)


@st.composite
def recoveries(draw: st.DrawFn) -> Recovery:
    """A recovery with missing answers anywhere, names of any letters and any origin."""
    made = recovery(60, draw(st.integers(0, 9)), origin_ns=draw(st.integers(-(2**60), 2**60)))
    nothing = draw(arrays.arrays(np.bool_, 60))
    scale = draw(st.sampled_from([1e-12, 1.0, 1e9]))
    position, velocity = scale * made.position, made.velocity.copy()
    quaternion, covariance = made.quaternion.copy(), made.pose_covariance.copy()
    speed = made.velocity_covariance.copy()
    for values in (position, velocity, quaternion, covariance, speed):
        values[nothing] = np.nan
    return replace(
        made,
        position=position,
        velocity=velocity,
        quaternion=quaternion,
        pose_covariance=covariance,
        velocity_covariance=speed,
        name=draw(words),
        notes=tuple(draw(st.lists(words, max_size=3))),
        clock_offset_s=draw(large),
    )


@few
@given(recoveries())
def test_results(tmp_path: Path, made: Recovery):
    write_recovery(made, tmp_path / "a.mcap", force=True)
    (back,) = read_recovery(tmp_path / "a.mcap")
    assert_same(made, back)


@few
@given(recoveries())
def test_tables_of_results(tmp_path: Path, made: Recovery):
    from pyarrow import parquet

    export_csv(made, tmp_path / "a.csv", force=True)
    export_parquet(made, tmp_path / "a.parquet", force=True)
    stamp, numbers = nanoseconds(made.t_s, made.origin_ns), list(file_columns(made))
    names, values = [name for name, *_ in numbers], np.stack([each for _, each, _ in numbers], axis=1)
    with open(tmp_path / "a.csv", newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["t_s", "occluded", *names, "trusted", "usable"]
    cells = np.array([[float(cell or "nan") for cell in row[2:-2]] for row in rows])
    np.testing.assert_allclose(cells, values, atol=0.5e-9, rtol=1e-15)  # nine decimals
    assert [round(float(row[0].replace(".", ""))) for row in rows] == [round(float(n)) for n in stamp]
    table = parquet.read_table(tmp_path / "a.parquet")
    assert table["stamp_ns"].to_pylist() == stamp.tolist()
    for name, column in zip(names, values.T, strict=True):
        np.testing.assert_array_equal(table[name].to_numpy(), column)
    assert json.loads(table.schema.metadata[METADATA_KEY])["name"] == made.name
