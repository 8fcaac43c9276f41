"""What is written reads back equal: recordings, results, exports, messages, of any values."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from made_results import assert_same, recovery

from smoother.io import read_recovery, write_recovery
from smoother.io.export.prepare import METADATA_KEY, export_csv, export_parquet, file_columns
from smoother.io.mcap.messages import nanoseconds
from smoother.result import Recovery

quick = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
START = 1_700_000_000 * 10**9
numbers = st.floats(-1e3, 1e3, allow_subnormal=True)
places = st.floats(-10, 10).map(lambda value: round(value, 6))


few = settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
#: What may be in a name: no surrogates, which are not text.
words = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
large = st.floats(-1e6, 1e6)


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
