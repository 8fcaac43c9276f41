"""`Recovery.plot` and `Recovery.export`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from measured_arms import simulated, with_draws

from smoother.cli.run import run
from smoother.errors import UnoccludeError
from smoother.io import read_recovery, write_recovery
from smoother.measures import measure
from smoother.result import Recovery


@pytest.fixture(scope="module")
def recovery() -> Recovery:
    return simulated(0, protocol="random", duration_s=8.0, occlusion_lengths_s=(0.8,))


def test_a_figure_has_curves_bands_and_shaded_gaps(recovery: Recovery, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    figure = recovery.plot(["elbow_flexion", "wrist"], width_cm=8.5)
    flexion, wrist = figure.axes
    assert figure.get_size_inches()[0] == pytest.approx(8.5 / 2.54)
    assert flexion.get_ylabel() == "elbow flexion, deg" and len(wrist.lines) == 3
    drawn = flexion.lines[0].get_ydata()
    np.testing.assert_allclose(drawn, recovery.angles().values["elbow_flexion"], atol=1e-9)
    starts = np.flatnonzero(np.diff(recovery.occluded.astype(int), prepend=0) == 1)
    assert len(flexion.patches) == len(starts) > 0
    figure.savefig(tmp_path / "figure.pdf")
    assert (tmp_path / "figure.pdf").stat().st_size > 5000
    part = recovery.plot(["wrist"], from_s=2.0, to_s=4.0)
    assert part.axes[0].get_xlim() == pytest.approx((2.0, 4.0), abs=0.02)


def test_what_cannot_be_drawn_says_why(recovery: Recovery) -> None:
    pytest.importorskip("matplotlib")
    with pytest.raises(UnoccludeError, match="nose cannot be drawn: the recovery has elbow_flexion"):
        recovery.plot(["nose"])
    with pytest.raises(UnoccludeError, match="no sample to draw between 100"):
        recovery.plot(from_s=100.0)


@pytest.mark.parametrize("ending", ["csv", "trc", "mot"])
def test_an_export_is_that_of_the_command(recovery: Recovery, tmp_path: Path, ending: str) -> None:
    write_recovery(recovery, tmp_path / "a.mcap")
    [read] = read_recovery(tmp_path / "a.mcap")
    command = ["export", str(tmp_path / "a.mcap"), "--format", ending, "-o", str(tmp_path / f"b.{ending}")]
    assert run(command) == 0
    read.export(tmp_path / f"c.{ending}")
    ours, theirs = ((tmp_path / f"{name}.{ending}").read_text() for name in "cb")
    assert ours.replace(f"c.{ending}", "") == theirs.replace(f"b.{ending}", "")
    with pytest.raises(UnoccludeError, match="exists"):
        read.export(tmp_path / f"c.{ending}")


def test_an_ending_that_is_no_format_lists_those_that_are(recovery: Recovery, tmp_path: Path) -> None:
    with pytest.raises(UnoccludeError, match=r"its ending names no format; endings: \.mcap, \.csv"):
        recovery.export(tmp_path / "a.docx")


def test_measures_as_a_dataframe(recovery: Recovery) -> None:
    pandas = pytest.importorskip("pandas")
    found = measure(with_draws(recovery, count=20))
    frame = found.to_dataframe()
    assert isinstance(frame, pandas.DataFrame) and list(frame.columns) == found.to_table().column_names
    row = frame[(frame["key"] == "elbow_flexion_range_deg") & (frame["scope"] == "session")].iloc[0]
    assert row["value"] == found.by_key["elbow_flexion_range_deg"].value
