"""The report's part on a comparison with motion capture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import LEVERS, make_recording, make_recovery, make_truth, path, turn

from smoother.evaluation.reference import ReferenceAlignment
from smoother.evaluation.validate import validate
from smoother.report import write_report
from smoother.report.truth_comparison import angle_curves, bland_altman, compared, error_over_time


@pytest.fixture(scope="module")
def pair():
    """A recovery with a gap and R_F_A, and a truth with joints."""
    recording = make_recording()
    hidden = (recording.arm.t_s > 8) & (recording.arm.t_s < 9.5)
    recovery = make_recovery(replace(recording, arm=recording.arm.hide(hidden)), error_m=0.004)
    recovery = replace(recovery, calibration=replace(recovery.calibration, R_F_A=np.eye(3)))
    t = np.arange(0, 20, 0.01)
    joints = {name: path(t) + turn(t).apply(lever) for name, lever in LEVERS.items()}
    joints["shoulder"] = np.tile([0.0, 0.3, 2.1], (len(t), 1))
    return recovery, replace(make_truth(t), joints=joints)


def test_sections_say_where_the_truth_was_aligned(pair, tmp_path):
    recovery, truth = pair
    found = validate(recovery, truth, ReferenceAlignment("solved"))
    titles = [title for title, *_ in compared(recovery, truth, found)]
    assert len(titles) == 4
    assert all("aligned: frame and clock" in title for title in titles)
    write_report(recovery, tmp_path / "r.html", validation=found, truth=truth)
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    # the four, and the table of errors; in no heading for a truth that came as it is
    assert text.count("aligned: frame and clock of the truth solved") >= 5
    write_report(recovery, tmp_path / "s.html", validation=validate(recovery, truth), truth=truth)
    assert "aligned: frame" not in (tmp_path / "s.html").read_text(encoding="utf-8")


def test_what_is_drawn_are_the_errors(pair):
    recovery, truth = pair
    figure = error_over_time(recovery, truth)
    drawn = {trace.name: np.asarray(trace.y, float) for trace in figure.data if trace.yaxis == "y"}
    error = 100 * np.linalg.norm(recovery.position - path(recovery.t_s), axis=1)
    seen = ~recovery.occluded
    inner = seen & np.roll(seen, 1) & np.roll(seen, -1)
    np.testing.assert_allclose(drawn["sensor, seen"][inner], error[inner], atol=0.01)
    assert np.isnan(drawn["sensor, recovered"][inner]).all()
    np.testing.assert_allclose(drawn["sensor, recovered"][~seen], error[~seen], atol=0.01)
    assert len(figure.layout.shapes) == 1


def test_angles_and_their_limits_are_drawn(pair):
    recovery, truth = pair
    found = validate(recovery, truth)
    curves = angle_curves(recovery, found.angles)
    assert sum(trace.name == "reference" for trace in curves.data) == len(found.angles.compared)
    dots = bland_altman(recovery, found.angles, found.angle_figures["all"])
    lines = sorted(shape.y0 for shape in dots.layout.shapes if shape.yref == "y")
    each = found.angle_figures["all"][found.angles.compared[0]]
    np.testing.assert_allclose(lines, [each.limits_low, each.bias, each.limits_high])


def test_table_one_stands_in_the_report(pair, tmp_path):
    recovery, truth = pair
    found = validate(recovery, truth)
    write_report(recovery, tmp_path / "r.html", validation=found, truth=truth)
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    row = next(row for row in found.table.rows if row.errors.startswith("Position"))
    assert f"<td>{row.answer:.5f}</td>" in text
    assert "Error reduction" in text
