"""What pages say and draw: references, axes, lengths, one measure in words, fewer points."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
from arms import LEVERS, make_recording, make_recovery, make_truth, path, turn
from made_measures import made_measure
from plotly.offline import get_plotlyjs

from smoother.angles import JOINT_ANGLES
from smoother.evaluation.validate import validate
from smoother.evaluation.words import measure_words
from smoother.measures.definitions import MEASURED_ANGLES, definitions
from smoother.report import write_report
from smoother.report.sheet import PLOTLY
from smoother.report.summary import summary
from smoother.report.traces import decimate
from smoother.result import Estimates


@pytest.fixture(scope="module")
def recovery():
    recording = make_recording()
    hidden = (recording.arm.t_s > 8) & (recording.arm.t_s < 9.5)
    return make_recovery(replace(recording, arm=recording.arm.hide(hidden)), error_m=0.004, sigma_m=0.004)


def joints_only(off_m: float = 0.0):
    """A reference without the sensor: markers at the joints alone."""
    t = np.arange(0, 20, 0.01)
    truth = make_truth(t)
    joints = {name: path(t) + turn(t).apply(lever) + off_m for name, lever in LEVERS.items()}
    nothing = np.full((len(t), 3), np.nan)
    return replace(truth, position=nothing, quaternion=np.full((len(t), 4), np.nan), joints=joints)


def test_joints_alone_are_compared_in_the_headline_and_leave_no_table_of_dashes(recovery, tmp_path):
    truth = joints_only()
    found = validate(recovery, truth)
    said = " ".join(summary(recovery, found))
    each = r"0\.\d cm at the \w+ \(95 % below \d\.\d cm\)"
    assert re.search(f"the error in the gaps is, root mean square, {each}, {each} and {each}", said)
    assert "no position to compare" not in said
    write_report(recovery, tmp_path / "r.html", validation=found, truth=truth)
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    rows = re.findall(r"<tr><td>[^<]*</td>(?:<td>–</td>)+</tr>", text)
    assert rows == []
    assert "The reference has joints only." in text


def test_errors_of_joints_beyond_their_sigma_are_said(recovery):
    said = summary(recovery, validate(recovery, joints_only(off_m=0.03)))
    assert any("times as large as the stated uncertainty allows" in text for text in said)
    assert not any("In 95 of 100 cases" in text for text in said)


def test_an_answer_that_the_camera_contradicts_is_doubted():
    recovery = replace(make_recovery(make_recording()), estimates=Estimates(camera_sigma_m={"wrist": 0.003}))
    text = " ".join(summary(recovery, None))
    assert "Result and camera disagree more than stated: of the wrist samples" in text
    assert "95 of 100 cases" not in text


def test_time_without_any_answer_outside_the_gaps_is_said(recovery):
    assert "without a result: 0.0 s" in summary(recovery, None)[0]
    away = (recovery.t_s > 12.0) & (recovery.t_s < 15.0)
    position = np.where(away[:, None], np.nan, recovery.position)
    (said,) = [text for text in summary(replace(recovery, position=position), None) if "lasts" in text]
    assert re.search(r": 1, 1\.\d s in all, .* without a result: [23]\.\d s\.$", said)


def test_the_bundle_is_of_the_locked_plotly():
    version = re.search(r"plotly\.js v([\d.]+)", get_plotlyjs()[:200])
    bundle = resources.files("smoother.report").joinpath("web", PLOTLY).read_text(encoding="utf-8")
    assert version is not None
    assert f"(basic - minified) v{version.group(1)}" in bundle[:200], (
        f"Plotly was updated: run `npm pack plotly.js-basic-dist-min@{version.group(1)}` and put"
        f" plotly-basic.min.js into smoother/report/web, its LICENSE beside it as plotly-basic.license.txt"
    )


def test_an_angle_has_one_name():
    for angle in JOINT_ANGLES:
        if angle.name in MEASURED_ANGLES:
            assert definitions()[f"{angle.name}_range_deg"].name == f"{angle.title}, range"
    assert definitions()["shoulder_plane_range_deg"].name == "plane of shoulder elevation, range"


RANGE = made_measure("elbow_flexion_range_deg", 62.0, 2.0)


def test_the_unit_stands_once_and_the_interval_only_where_there_is_one() -> None:
    text = measure_words(RANGE)
    assert text == "62.0° (58.1 to 65.9°)"
    alone = measure_words(replace(RANGE, low=math.nan, high=math.nan))
    assert alone == "62.0°"
    speed = replace(RANGE, unit="m/s", value=0.812, low=0.75, high=0.87)
    side = measure_words(made_measure("hand_path_length_m_symmetry_percent", 4.0, 3.0))
    assert side == "+4.0 (−1.9 to +9.9)\u00a0%", "positive: the right one has more"
    assert measure_words(speed).count("m/s") == 1 and " to " in measure_words(speed)


def test_long_lines_keep_ends_and_gaps():
    important = np.zeros(300_000, bool)
    important[1000:1200] = True
    important[200_000:200_400] = True
    index = decimate(important, 6000)
    assert len(index) <= 6000
    assert index[0] == 0
    assert index[-1] == 299_999
    assert set(np.flatnonzero(important)) <= set(index)
    assert (np.diff(index) > 0).all()
