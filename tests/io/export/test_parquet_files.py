"""Parquet exports, read back by pyarrow and held against the CSV of the same result."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from results import made, without_answer

from smoother.io.export.prepare import prepare_export
from smoother.io.export.tables import export_csv
from smoother.result import Estimates

START_NS = 1_700_000_000_000_000_000


def export(recovery, path):
    prepare_export(recovery, "parquet", version="9.9").write(path, False)
    return pq.read_table(path)


@pytest.mark.parametrize("origin_ns", [0, START_NS])
def test_the_columns_of_the_csv(tmp_path, origin_ns):
    recovery = replace(without_answer(made(), 9.5, 10.5), origin_ns=origin_ns)
    table = export(recovery, tmp_path / "a.parquet")
    export_csv(recovery, tmp_path / "a.csv")
    with open(tmp_path / "a.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert table.column_names == [*rows[0], "stamp_ns"]
    assert len(rows) == table.num_rows == len(recovery)
    for name in rows[0]:
        written = [row[name] for row in rows]
        column = table[name]
        assert column.null_count == sum(text == "" for text in written), name
        if name == "trusted":
            assert column.null_count == len(rows)  # nobody judged
        elif name in ("occluded", "usable"):
            assert column.to_pylist() == [text == "1" for text in written]
        else:
            found = column.to_numpy()
            # The CSV has nine decimals; t_s as a double of a Unix time is good to 0.3 microseconds.
            limit = 3e-7 if name == "t_s" and origin_ns else 0.51e-9
            np.testing.assert_allclose(found, [float(text or "nan") for text in written], atol=limit)
    stamp = [int(row["t_s"].replace(".", "")) for row in rows]
    assert table["stamp_ns"].to_pylist() == stamp


def test_every_column_has_its_unit(tmp_path):
    schema = export(made(), tmp_path / "a.parquet").schema
    units = {field.name: field.metadata[b"unit"].decode() for field in schema}
    assert all(field.metadata[b"description"] for field in schema)
    for pattern, unit in (
        (r"(imu|elbow|wrist|shoulder|hand)_[xyz]", "m"),
        (r"(\w+_)?sigma_[xyz]", "m"),
        (r"sigma_deg", "deg"),
        (r"v[xyz]", "m/s"),
        (r"imu_q[wxyz]", ""),
        (r"t_s", "s"),
        (r"stamp_ns", "ns"),
    ):
        names = [name for name in units if re.fullmatch(pattern, name)]
        assert names
        assert {units[name] for name in names} == {unit}, pattern


def test_configuration_and_figures_go_along(tmp_path):
    recovery = replace(
        made("left"),
        config={"camera": {"noise_m": 0.008}},
        estimates=Estimates(further={"rms_m": float("nan"), "biases": np.array([1.0, 2.0])}),
        notes=("A note with “quotes”.",),
    )
    table = export(recovery, tmp_path / "a.parquet")
    # A strict reading: NaN is not JSON.
    kept = json.loads(table.schema.metadata[b"unocclude"], parse_constant=lambda text: pytest.fail(text))
    assert kept["config"] == {"camera": {"noise_m": 0.008}}
    assert kept["figures"] == {"rms_m": None, "biases": [1.0, 2.0]}
    assert kept["notes"] == ["A note with “quotes”."]
    assert (kept["method"], kept["side"], kept["version"]) == ("graph", "left", "9.9")
    assert len(kept["gaps"]) == len(recovery.gaps)
    assert kept["clock_offset_sigma_s"] == 0.002
