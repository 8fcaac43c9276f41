"""What a Parquet export says of its columns and of the result."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from results import made

from smoother.io.export.prepare import prepare_export
from smoother.result import Estimates


def export(recovery, path):
    prepare_export(recovery, "parquet", version="9.9").write(path, False)
    return pq.read_table(path)


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
