"""What is written reads back equal: results, exports, messages, described tables, of any values."""

from __future__ import annotations

import csv
import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from made_results import assert_same, recovery

from smoother.cli.config import read_config, to_toml
from smoother.config import Config
from smoother.io import export_csv, read_recovery, write_recovery
from smoother.io.devices.describe_table import Guess, toml_of
from smoother.io.export.csv import csv_columns
from smoother.io.export.markers import C3dContent, write_c3d
from smoother.io.export.parquet import METADATA_KEY, export_parquet
from smoother.io.export.storage import MotTable, write_mot
from smoother.io.markers import read_c3d
from smoother.io.mcap.merge import Output, OutputStream
from smoother.io.mcap.messages import nanoseconds
from smoother.io.media.images import raw_image, read_images
from smoother.io.wire import protobuf_encode as wire
from smoother.io.wire.schemas import parsed
from smoother.result import Recovery
from smoother.runtime.outputs import writing

quick = settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
#: What may be in a name: no surrogates, which are not text.
words = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
numbers = st.floats(-1e6, 1e6)
any_number = st.floats(allow_nan=False, allow_infinity=False)


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
        clock_offset_s=draw(numbers),
    )


@quick
@given(recoveries())
def test_results(tmp_path: Path, made: Recovery):
    write_recovery(made, tmp_path / "a.mcap", force=True)
    (back,) = read_recovery(tmp_path / "a.mcap")
    assert_same(made, back)


@quick
@given(recoveries())
def test_tables_of_results(tmp_path: Path, made: Recovery):
    from pyarrow import parquet

    export_csv(made, tmp_path / "a.csv", force=True)
    export_parquet(made, tmp_path / "a.parquet", force=True)
    stamp, (names, values) = nanoseconds(made.t_s, made.origin_ns), csv_columns(made)
    with open(tmp_path / "a.csv", newline="") as file:
        header, *rows = csv.reader(file)
    assert header == [*names, "trusted", "usable"]
    cells = np.array([[float(cell or "nan") for cell in row[2:-2]] for row in rows])
    np.testing.assert_allclose(cells, values, atol=0.5e-9, rtol=1e-15)  # nine decimals
    assert [round(float(row[0].replace(".", ""))) for row in rows] == [round(float(n)) for n in stamp]
    table = parquet.read_table(tmp_path / "a.parquet")
    assert table["stamp_ns"].to_pylist() == stamp.tolist()
    for name, column in zip(names[2:], values.T, strict=True):
        np.testing.assert_array_equal(table[name].to_numpy(), column)
    assert json.loads(table.schema.metadata[METADATA_KEY])["name"] == made.name


@quick
@given(
    arrays.arrays(np.float64, st.tuples(st.integers(1, 6), st.integers(1, 4), st.just(3)), elements=numbers),
    st.data(),
)
def test_c3d(tmp_path: Path, position: np.ndarray, data: st.DataObject):
    position[abs(position).max(axis=2) < 1e-3] = 0.5  # the origin stands for a hidden marker
    hidden = data.draw(arrays.arrays(np.bool_, position.shape[:2]))
    position[hidden] = np.nan
    names = [f"M{i}" for i in range(position.shape[1])]
    rate = data.draw(st.sampled_from([30.0, 100.0, 119.88]))
    write_c3d(tmp_path / "a.c3d", C3dContent(names, position, rate), force=True)
    back = read_c3d(tmp_path / "a.c3d")
    assert list(back.names) == names and abs(back.rate_hz - rate) < 1e-5
    np.testing.assert_allclose(back.position, position, rtol=2e-7, atol=1e-30)  # four bytes a number


@quick
@given(st.integers(1, 8), words, st.data())
def test_motion_files(tmp_path: Path, count: int, name: str, data: st.DataObject):
    columns = arrays.arrays(np.float64, count, elements=numbers)
    angles = {key: data.draw(columns) for key in ("elbow_flexion", "pro_sup")}
    flags = [data.draw(arrays.arrays(np.bool_, count)) for _ in range(2)]
    table = MotTable(np.arange(count) / 100, 100.0, angles, *flags, notes=())
    write_mot(table, tmp_path / "a.mot", replace(recovery(60), name=name), force=True)
    text = (tmp_path / "a.mot").read_bytes().decode()
    assert text.split("\n")[1:4] == ["version=1", f"nRows={count}", "nColumns=5"]
    _, _, body = text.partition("endheader\n")
    header, *rows = [line.split("\t") for line in body.splitlines()]
    assert header == ["time", *angles, "occluded", "answered"]
    wanted = np.column_stack([table.t_s, *angles.values(), *flags])
    np.testing.assert_allclose(np.array(rows, float), wanted, atol=0.5e-9, rtol=1e-15)


@quick
@given(words, st.dictionaries(st.sampled_from(["ax", "ay", "t_s"]), words | st.integers(1, 99)), words)
@example("\x7f.csv", {"ax": "a\x7f\x85"}, "\n[imu]")
def test_described_tables(file: str, columns: dict[str, object], unit: str):
    """Names that a stranger gave to columns are text of the recording.toml, and nothing else."""
    file = file.replace("/", "").replace("\0", "") or "a"
    guess = Guess("imu", columns, {"accelerometer_unit": unit}, {"accelerometer_unit": "the size says so"})
    section = tomllib.loads(toml_of(Path(file), guess, "forearm"))["imu"]["forearm"]
    assert section == {"file": file, "accelerometer_unit": unit, "columns": columns}


@quick
@given(st.floats(1e-4, 1.0), st.booleans(), st.integers(1, 64))
def test_settings(tmp_path: Path, sigma: float, shared: bool, processes: int):
    config = Config.model_validate({"camera": {"joint_sigma_m": sigma}, "windows": {"processes": processes}})
    (tmp_path / "a.toml").write_text(to_toml(config), encoding="utf-8")
    assert read_config(tmp_path / "a.toml") == config


@quick
@given(
    arrays.arrays(np.float64, st.tuples(st.integers(1, 5), st.just(3)), elements=any_number),
    st.lists(st.integers(-(2**62), 2**62), min_size=5, max_size=5),
    words,
    st.integers(0, 2**32 - 1),
)
def test_messages_that_are_encoded_together(acc: np.ndarray, stamps: list[int], frame: str, body: int):
    stamp_ns = np.array(stamps[: len(acc)], np.int64)
    imu = wire.join(
        wire.timestamp(1, "stamp"), wire.text(2, frame), wire.vector(3, "acc"), wire.vector(4, "acc")
    )
    rows = imu.encode(len(acc), {"acc": acc, **wire.stamps("stamp", stamp_ns)})
    for row, vector, stamp in zip(rows, acc, stamp_ns.tolist(), strict=True):
        message = parsed("unocclude.Imu", row[wire.HEAD_BYTES :].tobytes())
        names = [field.name for field in message.DESCRIPTOR.fields]
        assert message.timestamp.seconds * 10**9 + message.timestamp.nanos == stamp
        assert getattr(message, names[1]) == frame
        for name in names[2:4]:
            got = getattr(message, name)
            np.testing.assert_array_equal([got.x, got.y, got.z], vector)
    skeleton = wire.join(wire.number(3, body)).encode(1, {})
    assert parsed("unocclude.Skeleton", skeleton[0, wire.HEAD_BYTES :].tobytes()).body == body


@quick
@given(
    arrays.arrays(np.uint16, st.tuples(st.integers(1, 5), st.integers(1, 5))),
    st.integers(1, 2**62),
    words,
)
def test_images(tmp_path: Path, depth: np.ndarray, stamp: int, frame: str):
    path, data = tmp_path / "a.mcap", raw_image(frame, "16UC1", depth, stamp)
    with writing(path, True) as temporary, Output(temporary) as output:
        channel = output.channel("/depth", "foxglove.RawImage")
        output.write([OutputStream(channel, np.array([stamp]), lambda part: [data])])
    (image,) = read_images(path)
    assert (image.stamp_ns, image.frame_id) == (stamp, frame)
    np.testing.assert_array_equal(image.pixels(), depth)
